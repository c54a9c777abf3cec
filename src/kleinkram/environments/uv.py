"""Runs `uv`, which resolves and installs packages: without the configuration, credentials and caches of this user."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

OFF = "off"
PYPI = "pypi"
"""The index that `uv` uses by default."""
INDEX_VARIABLE = "KLEINKRAM_PACKAGE_INDEX"

_CHECK_EVERY_S = 0.1
# Of the environment, what is needed to reach an index.
_INHERITED = re.compile(r"SSL_CERT_(FILE|DIR)|(HTTPS?|ALL|NO)_PROXY", re.IGNORECASE)
_RETRIES, _TIMEOUT_S = 2, 15
_MAX_SENTENCE_CHARACTERS = 500

Wait = Callable[[float], object]


class PackageIndex(NamedTuple):
    """Where packages come from: options and environment variables of `uv`.

    A URL, which may contain a password, is in a variable: command lines are visible to other users.
    """

    options: tuple[str, ...]
    variables: Mapping[str, str]


class UvFailed(Exception):
    """`uv` failed. The text is a sentence, without passwords."""


def parse_index(text: str) -> PackageIndex | None:
    """Return a package index: `pypi`, the URL of a simple index, or a folder of wheels; None for `off`.

    Raises:
        ValueError: it is none of these.
    """
    if text == OFF:
        return None
    if text == PYPI:
        return PackageIndex((), {})
    parts = urlsplit(text)
    if parts.scheme in {"http", "https"} and parts.hostname:
        return PackageIndex((), {"UV_DEFAULT_INDEX": text})
    folder = Path(parts.path if parts.scheme == "file" else text)
    if parts.scheme not in {"", "file"} or not folder.is_absolute():
        raise ValueError(
            "must be 'pypi', the URL of a package index (https://...), the absolute path of a folder, or 'off'"
        )
    return PackageIndex(("--no-index", "--find-links", str(folder)), {})


def find_uv() -> str | None:
    """Return the program `uv`: that of the wheel `uv`, else the one on PATH; None without it."""
    beside = Path(sys.executable).with_name("uv")
    return str(beside) if os.access(beside, os.X_OK) else shutil.which("uv")


def run_uv(
    arguments: Sequence[str],
    index: PackageIndex,
    *,
    folder: Path,
    timeout_s: float,
    wait: Wait,
    pass_fds: Sequence[int] = (),
) -> None:
    """Run `uv` with temporary files in `folder`, where `uv.log` is what it prints; call `wait` (seconds) meanwhile.

    `pass_fds` are open until it ends, even if this process is killed before. It is killed where `wait` raises.

    Raises:
        UvFailed: it failed, is not installed, or took longer than `timeout_s`.
    """
    program = find_uv()
    if program is None:
        raise UvFailed("uv is not installed here: pip install 'open-kleinkram[environments]'.")
    scratch = folder / "scratch"
    scratch.mkdir(exist_ok=True)
    settings = ("--no-config", "--no-progress", "--color=never", "--no-python-downloads", "--no-cache")
    with (folder / "uv.log").open("wb") as log:
        process = subprocess.Popen(
            [program, *arguments, *index.options, *settings, "--python", sys.executable],
            cwd=scratch,
            env={**_environment(scratch), **index.variables},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            pass_fds=pass_fds,
            start_new_session=True,
        )
    until_s = time.monotonic() + timeout_s
    try:
        while process.poll() is None:
            if time.monotonic() > until_s:
                raise UvFailed(f"It took longer than {timeout_s:g} s.")
            wait(0)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_CHECK_EVERY_S)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if process.returncode != 0:
        raise UvFailed(explain((folder / "uv.log").read_text(errors="replace")))


def _environment(scratch: Path) -> Mapping[str, str]:
    inherited = {name: value for name, value in os.environ.items() if _INHERITED.fullmatch(name)}
    own = {"PATH": os.defpath, "HOME": str(scratch), "TMPDIR": str(scratch), "LANG": "C.UTF-8"}
    limits = {"UV_HTTP_RETRIES": str(_RETRIES), "UV_HTTP_TIMEOUT": str(_TIMEOUT_S), "UV_SYSTEM_CERTS": "1"}
    return {**inherited, **own, **limits}


# What uv prints for the failures of its users, and the sentence for each.
_NOT_FOUND = re.compile(r"(\S+) was not found in the (?:package registry|provided package locations)")
_NO_WHEEL = re.compile(r"(\S+) has no (?:usable )?wheels?")
_NO_VERSION = re.compile(r"there (?:is|are) no versions? of (\S+)|only \S+ (?:is|are) available and you require (\S+),")
_PYTHON = re.compile(r"(?:and |Because )(\S+) (?:depends on Python|requires Python )([<>=!~.,\d]+)")
_HASH = re.compile(r"Hash mismatch for `([^`]+)`")
_FOLDER = re.compile(r"`--find-links` directory: (\S+)")
_STATUS = re.compile(r"HTTP status (?:client|server) error \((\d+)")
_FORBIDDEN = re.compile(r"authentication credentials \((\d+)|returned a (40[13]) ")
_AWAY = re.compile(r"Request failed|[Ee]rror sending request|Failed to fetch|dns error|tcp connect|timed out")
# Up to the last @: a password may contain some.
_USERINFO = re.compile(r"//[^/\s]+@")


def explain(output: str) -> str:
    """Return a sentence about why `uv` failed, from its output."""
    text = " ".join(output.split())
    if match := _HASH.search(text):
        return f"The files of {match[1]} in the package index do not have the hash of the lock."
    if "No space left" in text:
        return "The disk is full."
    if match := _FOLDER.search(text):
        return f"The folder of wheels {match[1]} cannot be read."
    if match := _FORBIDDEN.search(text):
        return f"The package index refuses access (HTTP status {match[1] or match[2]})."
    if match := _STATUS.search(text):
        return f"The package index does not answer (HTTP status {match[1]})."
    if match := _NOT_FOUND.search(text):
        return f"There is no package {match[1]} in the package index."
    if match := _PYTHON.search(text):
        python = match[2].partition(",")[0]
        return f'{match[1]} requires Python {python}: the header of the script needs requires-python = "{python}".'
    if match := _NO_WHEEL.search(text):
        return f"The package {match[1]} has no wheel; packages are not built from source."
    if (match := _NO_VERSION.search(text)) and "depends on" not in text:
        return f"There is no release {(match[1] or match[2]).rstrip(',')} in the package index."
    if "No solution found" in text:
        cause = text.partition("cause: ")[2].partition(" hint: ")[0] or text
        return f"The packages do not fit together: {_shorten(cause)}"
    if _AWAY.search(text):
        return "The package index does not answer."
    return f"uv failed: {_shorten(text.removeprefix('error: '))}"


def _shorten(text: str) -> str:
    text = _USERINFO.sub("//", text)
    return text if len(text) <= _MAX_SENTENCE_CHARACTERS else f"{text[:_MAX_SENTENCE_CHARACTERS]}..."
