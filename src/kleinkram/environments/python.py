"""The Python that scripts run with: which wheels it takes."""

from typing import Annotated, NamedTuple

from packaging.markers import default_environment
from pydantic import BaseModel, Field, ValidationError

# Run by that Python, which need not have this library: prints what `parse_python` reads.
PROBE = """\
import json, os, platform, sys, sysconfig
print(json.dumps({
    "implementation": sys.implementation.name,
    "version": "%d.%d.%d" % sys.version_info[:3],
    "machine": platform.machine(),
    "system": sys.platform,
    "libc": platform.libc_ver()[0],
    "libc_version": platform.libc_ver()[1],
    "free_threaded": bool(sysconfig.get_config_var("Py_GIL_DISABLED")),
}))
"""
# The versions of glibc that uv knows as platforms, in ascending order.
_GLIBC_MINORS = (17, 28, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40)
_MACHINES = {"x86_64", "aarch64"}


class _Facts(BaseModel):
    """What `PROBE` prints. An image can print anything in its place."""

    implementation: Annotated[str, Field(pattern=r"^[a-z0-9_]{1,32}$")]
    version: Annotated[str, Field(pattern=r"^3\.[0-9]{1,3}\.[0-9]{1,3}$")]
    machine: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]{1,32}$")]
    system: Annotated[str, Field(max_length=32)]
    libc: Annotated[str, Field(max_length=32)]
    libc_version: Annotated[str, Field(pattern=r"^[0-9A-Za-z.-]{0,32}$")]
    free_threaded: bool


class PythonUnknown(Exception):
    """No environment can be made for a Python. The text is a sentence."""


class Python(NamedTuple):
    """A Python: its full version, such as `3.12.4`, and the platform of its wheels, as uv names it."""

    version: str
    platform: str

    @property
    def short_version(self) -> str:
        """The version that wheels are made for, such as `3.12`."""
        return ".".join(self.version.split(".")[:2])

    def markers(self) -> dict[str, str]:
        """Return its environment of markers; for all patch releases the same, since they share environments."""
        environment = {name: str(value) for name, value in default_environment().items()}
        first = f"{self.short_version}.0"
        of_python = {"python_version": self.short_version, "python_full_version": first}
        of_python |= {"implementation_version": first, "platform_machine": self.platform.partition("-")[0]}
        return environment | of_python


def parse_python(output: str) -> Python:
    """Return the Python that printed this output of `PROBE`.

    Raises:
        PythonUnknown: there are no wheels for it.
    """
    try:
        facts = _Facts.model_validate_json(output.strip().splitlines()[-1])
    except (IndexError, ValidationError):
        raise PythonUnknown("It has no python3.") from None
    is_usual = facts.implementation == "cpython" and facts.system == "linux" and not facts.free_threaded
    if not is_usual or facts.machine not in _MACHINES:
        raise PythonUnknown(f"Packages cannot be installed for {facts.implementation} on {facts.machine}.")
    if facts.libc != "glibc":
        return Python(facts.version, f"{facts.machine}-unknown-linux-musl")
    minor = facts.libc_version.partition(".")[2]
    known = [number for number in _GLIBC_MINORS if minor.isdigit() and number <= int(minor)]
    if not known:
        raise PythonUnknown(f"Its C library (glibc {facts.libc_version}) is older than 2.17.")
    return Python(facts.version, f"{facts.machine}-manylinux_2_{known[-1]}")
