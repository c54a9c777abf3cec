"""What `uv` prints becomes one sentence; a Python is described by what it prints of itself."""

import json

import pytest

from kleinkram.environments.lock import CannotLock, oldest_python
from kleinkram.environments.python import Python, PythonUnknown, parse_python
from kleinkram.environments.uv import explain, parse_index

FACTS = {
    "implementation": "cpython",
    "version": "3.12.4",
    "machine": "x86_64",
    "system": "linux",
    "libc": "glibc",
    "libc_version": "2.36",
    "free_threaded": False,
}


@pytest.mark.parametrize(
    ("output", "sentence"),
    [
        (
            "error: No solution found when resolving dependencies for split (markers: python_full_version == '3.10')\n"
            "  cause: Because the requested Python version (>=3.10) does not satisfy Python>=3.11 and evo==1.38.1 "
            "depends on Python>=3.11, we can conclude that evo==1.38.1 cannot be used.\n"
            "         And because only evo<=1.38.1 is available and you require evo==1.38.1, we can conclude ...\n",
            'evo==1.38.1 requires Python >=3.11: the header of the script needs requires-python = ">=3.11".',
        ),
        (
            "error: Request failed after 3 retries in 9.4s\n  cause: Failed to fetch: https://a:b@lab.example/simple/x/",
            "The package index does not answer.",
        ),
        ("error: No space left on device (os error 28)", "The disk is full."),
        ("error: odd: https://me:secret@lab.example/simple", "uv failed: odd: https://lab.example/simple"),
        ("error: odd: https://me:s@cr@t@lab.example/simple", "uv failed: odd: https://lab.example/simple"),
    ],
)
def test_failures_become_sentences(output: str, sentence: str) -> None:
    assert explain(output) == sentence


@pytest.mark.parametrize("text", ["PyPI", "ftp://example.org/simple", "wheels", "file://wheels", ""])
def test_an_index_is_a_url_a_folder_or_off(text: str) -> None:
    with pytest.raises(ValueError, match="the URL of a package index"):
        parse_index(text)


def test_pypi_is_the_default_index_of_uv() -> None:
    assert parse_index("pypi") == ((), {})


def test_an_index_may_be_off() -> None:
    assert parse_index("off") is None


@pytest.mark.parametrize(
    ("changes", "platform"),
    [
        ({}, "x86_64-manylinux_2_36"),
        ({"libc_version": "2.30"}, "x86_64-manylinux_2_28"),
        ({"libc_version": "2.99"}, "x86_64-manylinux_2_40"),
        ({"machine": "aarch64"}, "aarch64-manylinux_2_36"),
        ({"libc": "", "libc_version": ""}, "x86_64-unknown-linux-musl"),
    ],
)
def test_a_python_has_a_platform_of_wheels(changes: dict[str, object], platform: str) -> None:
    python = parse_python("a warning\n" + json.dumps(FACTS | changes))
    assert python == Python("3.12.4", platform)
    assert (python.short_version, python.markers()["python_full_version"]) == ("3.12", "3.12.0")


@pytest.mark.parametrize(
    ("output", "reason"),
    [
        ("", "has no python3"),
        ("{}", "has no python3"),
        (json.dumps(FACTS | {"version": 3.12}), "has no python3"),
        (json.dumps(FACTS | {"version": "3.12.4; --index-url"}), "has no python3"),
        (json.dumps(FACTS | {"machine": ["x86_64"]}), "has no python3"),
        (json.dumps({name: value for name, value in FACTS.items() if name != "system"}), "has no python3"),
        (json.dumps(FACTS | {"implementation": "pypy"}), "cannot be installed for pypy"),
        (json.dumps(FACTS | {"free_threaded": True}), "cannot be installed"),
        (json.dumps(FACTS | {"machine": "armv7l"}), "on armv7l"),
        (json.dumps(FACTS | {"libc_version": "2.12"}), "older than 2.17"),
    ],
)
def test_a_python_without_wheels_is_refused(output: str, reason: str) -> None:
    with pytest.raises(PythonUnknown, match=reason):
        parse_python(output)


def test_the_oldest_python_is_what_the_script_accepts() -> None:
    accepted = {
        None: "3.10",
        ">=3.8": "3.10",
        ">=3.11.2": "3.11",
        "~=3.12": "3.12",
        ">3.10,<4": "3.10",
        "==3.11.4": "3.11",
    }
    assert {text: oldest_python(text) for text in accepted} == accepted
    with pytest.raises(CannotLock, match="No version of Python"):
        oldest_python("<3.10")
