"""Small disks, each mounted in its own namespace, visible only to programs that run inside."""

import contextlib
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.requirements import missing

MIB = 1024 * 1024
_APART = ("unshare", "--mount", "--propagation", "private")


@dataclass(frozen=True)
class SmallDisk:
    """A disk at `folder`, for programs that run inside."""

    folder: Path
    pid: int

    @property
    def inside(self) -> tuple[str, ...]:
        """The beginning of the command line of a program that sees the disk."""
        return ("nsenter", f"--target={self.pid}", "--mount")

    def path(self, name: str) -> Path:
        """Return the path of a file on it, for programs outside the namespace."""
        return Path(f"/proc/{self.pid}/root{self.folder}/{name}")

    def fill(self) -> None:
        """Fill the disk completely."""
        with self.path("ballast").open("wb", buffering=0) as out:
            for piece in (MIB, 4096, 1):
                with contextlib.suppress(OSError):
                    while True:
                        out.write(bytes(piece))

    def make_room(self) -> None:
        """Free the space that `fill` used."""
        self.path("ballast").unlink()


@contextmanager
def small_disk(folder: Path, size_bytes: int) -> Iterator[SmallDisk]:
    """Mount a disk at `folder`, with what is in it now.

    Programs with open files keep seeing it until they end.
    """
    here = shlex.quote(str(folder))
    copy = f'd=$(mktemp -d) && mount -t tmpfs -o size={size_bytes},mode=700 small "$d" && cp -a {here}/. "$d"'
    script = f'{copy} && mount --move "$d" {here} && rmdir "$d" && echo ready && exec sleep infinity'
    with subprocess.Popen([*_APART, "sh", "-c", script], stdout=subprocess.PIPE, text=True) as keeper:
        try:
            assert keeper.stdout is not None
            assert keeper.stdout.readline() == "ready\n"
            yield SmallDisk(folder, keeper.pid)
        finally:
            keeper.kill()


def need_small_disks() -> None:
    """Skip, or fail if all requirements are mandatory, if small disks cannot be mounted."""
    trial = subprocess.run(
        [*_APART, "mount", "-t", "tmpfs", "small", "/mnt"], check=False, capture_output=True, text=True
    )
    if trial.returncode != 0:
        missing(f"a small disk needs a mount namespace, which is not allowed here: {trial.stderr}")
