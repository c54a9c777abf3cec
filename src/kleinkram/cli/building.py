"""Building an action's image before it is tried out on this machine, with whichever engine's command is here."""

import shutil
import subprocess
import sys
from pathlib import Path

from kleinkram.cli.render import note
from kleinkram.client.errors import InvalidInput

DOCKERFILE = "Dockerfile"


def build(folder: Path, image: str) -> None:
    """Build the image of a folder with a Dockerfile, and show how on stderr; a folder without one has it elsewhere.

    Raises:
        InvalidInput: it cannot be built; what the engine says of it stands on stderr.
    """
    if not (folder / DOCKERFILE).is_file():
        return
    engine = shutil.which("docker") or shutil.which("podman")
    if engine is None:
        note(f"Neither docker nor podman is here to build {image}: it is taken as it is.")
        return
    note(f"Building {image} of {folder}; --no-build takes it as it is.")
    done = subprocess.run([engine, "build", "--tag", image, str(folder)], stdout=sys.stderr, check=False)
    if done.returncode != 0:
        raise InvalidInput(what=f"The folder {str(folder)!r}", reason="no image can be built of it")
