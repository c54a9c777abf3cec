"""What a sandbox needs for NVIDIA GPUs: their devices, and the libraries and programs of the driver of this machine.

Imports only the standard library, since jobs wait for it.
"""

import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

VISIBLE = "CUDA_VISIBLE_DEVICES"
_IDS_ON_NODE = "SLURM_JOB_GPUS"
# What Slurm sets for jobs without GPUs.
NONE_VISIBLE = "NoDevFiles"
# Where a job sees them.
LIBRARIES = "/.nvidia/lib"
PROGRAMS = "/.nvidia/bin"
_DEVICES = Path("/dev")
# Of all GPUs together; `nvidia0` and so on are those of one.
_SHARED_DEVICES = ("nvidiactl", "nvidia-modeset", "nvidia-uvm", "nvidia-uvm-tools", "nvidia-caps/*")
_LIBRARY = re.compile(r"lib(cuda|cudadebugger|nv[a-z]+|nvidia-[a-z0-9-]+|GLX_nvidia|EGL_nvidia)\.so")
_LDCONFIG_LINE = re.compile(r"^\s*(\S+) \(([^)]*)\) => (/\S+)$", re.MULTILINE)
_PROGRAMS = ("nvidia-smi", "nvidia-debugdump", "nvidia-persistenced", "nvidia-cuda-mps-control")


def devices(visible: str, folder: Path | None = None) -> list[Path]:
    """Return the devices for the visible GPUs; of all where they are not named by their numbers."""
    is_numbered = _is_numbered(visible)
    own = [f"nvidia{number}" for number in visible.split(",")] if is_numbered else ["nvidia[0-9]*"]
    patterns = [*_SHARED_DEVICES, *own]
    return [path for pattern in patterns for path in sorted((folder or _DEVICES).glob(pattern))]


def assigned_by_slurm(variables: Mapping[str, str]) -> str:
    """Return the GPUs that a cluster gave to a job, as its node counts them; empty without any.

    Where control groups limit the devices of jobs (`ConstrainDevices`), `CUDA_VISIBLE_DEVICES` counts from 0 in each.
    """
    visible = variables.get(VISIBLE, "")
    if visible in ("", NONE_VISIBLE):
        return ""
    of_node = variables.get(_IDS_ON_NODE, "")
    is_same = _is_numbered(visible) and _is_numbered(of_node) and visible.count(",") == of_node.count(",")
    return of_node if is_same else visible


def visible_among(gpus: str, nodes: Sequence[Path]) -> str | None:
    """Return how a job chooses these GPUs that has no other devices: CUDA counts those that it can open.

    None where the devices do not tell.
    """
    own = {node.name for node in nodes}
    if not _is_numbered(gpus) or not all(f"nvidia{number}" in own for number in gpus.split(",")):
        return None
    return ",".join(str(number) for number, _ in enumerate(gpus.split(",")))


def _is_numbered(gpus: str) -> bool:
    return all(word.isdigit() for word in gpus.split(","))


def libraries() -> list[Path]:
    """Return the libraries of the driver, as the linker of this machine finds them."""
    linker = shutil.which("ldconfig", path=f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin")
    if linker is None:
        return []
    output = subprocess.run([linker, "-p"], capture_output=True, text=True, check=False).stdout
    return [Path(path) for path in parse_libraries(output)]


def parse_libraries(output: str) -> list[str]:
    """Return the libraries of the driver in the output of `ldconfig -p`: the first of each name, of 64 bits."""
    paths: dict[str, str] = {}
    for name, kind, path in _LDCONFIG_LINE.findall(output):
        if _LIBRARY.match(name) and ("64" in kind or "aarch64" in kind.lower()):
            paths.setdefault(name, path)
    return list(paths.values())


def programs() -> list[Path]:
    """Return the programs of the driver."""
    return [Path(path) for name in _PROGRAMS if (path := shutil.which(name))]
