"""Apptainer, for machines whose kernel allows ordinary users no namespaces: it has a set-user-ID program for them.

Where the kernel allows namespaces, sandboxes of Kleinkram's own isolate more, and need no program at all.
"""

import os
import re
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from kleinkram.contract.actions import Network
from kleinkram.runner.images.names import ImageName, credentials_for
from kleinkram.runner.images.registry import RegistryClient, RegistryImage, is_loopback
from kleinkram.runner.images.store import (
    BuildSpace,
    ImageBuilder,
    ImageFailure,
    ImageRun,
    check_space,
    run_of,
    too_large,
)

# Variables of what runs inside begin with this outside; so none of a token is in the list of processes.
VARIABLE = "APPTAINERENV_"
_BUILD_TIMEOUT_S = 3600.0
_CHECK_EVERY_S = 0.2
_LOG = "apptainer.log"
# Apptainer decides HOME itself, and reports a missing command like any other failure; of a shell, `execution_error`
# recognises that.
_WITH_HOME = ("/bin/sh", "-c", 'HOME=/tmp; export HOME; exec "$@"', "kleinkram")
_SEPARATORS = re.compile(r"[:,]")


def find_apptainer() -> str | None:
    """Return the path of Apptainer, if it is installed."""
    return shutil.which("apptainer")


class Apptainer(ImageBuilder):
    """Builds SIF files, and starts commands in them."""

    content = "image.sif"

    def __init__(self, program: str) -> None:
        self.program = program

    def build(self, name: ImageName, image: RegistryImage, space: BuildSpace, client: RegistryClient) -> ImageRun:
        """Have Apptainer fetch the layers, by digest, and pack them into one file."""
        registry = name.repository.partition("/")[0]
        target = space.folder / self.content
        command = [self.program, "build", "--disable-cache", *(["--no-https"] if is_loopback(registry) else [])]
        command += [str(target), f"docker://{name.repository}@{image.manifest_digest}"]
        self._run(command, space, registry)
        size_bytes = target.stat().st_size
        if size_bytes > space.limit_bytes:
            raise too_large(size_bytes, space.limit_bytes)
        directories = [image.config.directory or "/", *(image.config.volumes or ())]
        return run_of(image.config, size_bytes, directories)

    def _run(self, command: Sequence[str], space: BuildSpace, registry: str) -> None:
        temporary = space.folder / "tmp"
        temporary.mkdir()
        environment = {"PATH": os.environ.get("PATH", os.defpath), "HOME": str(temporary)}
        environment["APPTAINER_TMPDIR"] = environment["APPTAINER_CACHEDIR"] = str(temporary)
        environment |= {key: os.environ[key] for key in ("HTTPS_PROXY", "https_proxy", "NO_PROXY") if key in os.environ}
        known = credentials_for(registry) or {}
        if "username" in known:
            environment["APPTAINER_DOCKER_USERNAME"] = known["username"]
            environment["APPTAINER_DOCKER_PASSWORD"] = known["password"]
        log = space.folder / _LOG
        with log.open("wb") as output:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment, pass_fds=[space.lock]
            )
        until_s = time.monotonic() + _BUILD_TIMEOUT_S
        try:
            while process.poll() is None:
                check_space(space.folder)
                if time.monotonic() > until_s:
                    raise ImageFailure(f"Apptainer did not build the image within {_BUILD_TIMEOUT_S:.0f} s.")
                time.sleep(_CHECK_EVERY_S)
        finally:
            process.kill()
            process.wait()
        if process.returncode != 0:
            lines = log.read_text(errors="replace").strip().splitlines()
            raise ImageFailure(f"Apptainer cannot build the image: {lines[-1] if lines else process.returncode}.")
        shutil.rmtree(temporary)
        log.unlink()

    def command(
        self,
        image: Path,
        command: Sequence[str],
        *,
        directories: Mapping[str, tuple[Path, bool]],
        working_directory: str,
        network: Network,
        has_gpus: bool,
    ) -> list[str]:
        """Return the command line that runs a command in an image. `directories`: inside, outside, read-only or not.

        Raises:
            ValueError: the path of a directory cannot be written on a command line.
        """
        options = ["--containall", "--no-home", "--cleanenv", "--uts", "--pwd", working_directory]
        for inside, (outside, is_read_only) in directories.items():
            if _SEPARATORS.search(f"{outside}{inside}"):
                raise ValueError(f"the path {outside} has a colon or a comma, which Apptainer does not take")
            options += ["--bind", f"{outside}:{inside}{':ro' if is_read_only else ''}"]
        if network is Network.none:
            options += ["--net", "--network", "none"]
        if has_gpus:
            options.append("--nv")
        return [self.program, "exec", *options, str(image), *_WITH_HOME, *command]
