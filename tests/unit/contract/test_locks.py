"""Locks contain versions with hashes, and nothing else that pip would do."""

import pytest
from pydantic import ValidationError

from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.locks import check_lock, parse_lock, parse_requirement, pinned_versions

HASH = f"--hash=sha256:{'0' * 64}"
LOCK = f"""\
# made by uv
arm==1.0 \\
    {HASH} \\
    {HASH}
Robot_Arm==2.1 ; python_full_version < '3.12' \\
    {HASH}    # why
"""


def test_a_lock_is_read_with_its_markers() -> None:
    arm, robot = parse_lock(LOCK)
    assert (arm.name, arm.version, arm.marker) == ("arm", "1.0", None)
    assert (robot.name, robot.version) == ("robot-arm", "2.1")
    assert robot.is_needed({"python_full_version": "3.11.4"})
    assert not robot.is_needed({"python_full_version": "3.12.0"})


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("arm>=1.0", "is not one version of a package"),
        ("arm==1.*", "is not one version of a package"),
        ("arm==1.0", "must be followed by hashes"),
        ("arm==1.0 --hash=md5:00", "must be followed by hashes"),
        (f"arm==1.0 {HASH} --global-option=x", "must be followed by hashes"),
        (f"arm @ https://example.org/arm.whl {HASH}", "packages come from the package index"),
        ("--index-url https://example.org", "is not a requirement"),
        ("-r other.txt", "is not a requirement"),
        ("-e .", "is not a requirement"),
        ("./arm.whl", "is not a requirement"),
        ("", "contains no package"),
    ],
)
def test_other_lines_are_refused_with_their_number(line: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as caught:
        parse_lock(f"\n{line}\n")
    assert not line or str(caught.value).startswith("line 2: ")


def test_each_dependency_is_locked_in_a_version_that_it_allows() -> None:
    packages = parse_lock(LOCK)
    check_lock(packages, [parse_requirement(text) for text in ("arm>=1,<2", "robot.arm", "open-kleinkram[reading]")])
    with pytest.raises(ValueError, match=r"arm>=2 is locked as arm==1\.0"):
        check_lock(packages, [parse_requirement("arm>=2")])
    with pytest.raises(ValueError, match="leg is not locked"):
        check_lock(packages, [parse_requirement("leg")])
    with pytest.raises(ValueError, match="open-kleinkram, which is part of where scripts run"):
        check_lock(parse_lock(f"open-kleinkram==1.0 {HASH}"), [])


def test_a_definition_is_refused_with_a_lock_of_other_dependencies() -> None:
    fields = {"name": "look", "script": "pass", "dependencies": ["leg"]}
    with pytest.raises(ValidationError, match="the lock does not match the dependencies: leg is not locked"):
        ActionDefinition.model_validate({**fields, "lock": LOCK})
    with pytest.raises(ValidationError, match="is not a condition on the version of Python"):
        ActionDefinition.model_validate({**fields, "requires_python": "3.11"})


@pytest.mark.parametrize(
    "text",
    [
        "arm\n-r /etc/passwd",
        r"""arm; platform_version == 'x"\n-r /etc/passwd\narm; platform_version == "x'""",
        r"""arm; platform_version == "x'\n-r /etc/passwd\narm; platform_version == 'x\x22" """,
    ],
    ids=["plain", "escaped", "both-quotes"],
)
def test_a_dependency_is_one_line_of_a_file_of_requirements(text: str) -> None:
    with pytest.raises(ValueError, match="is not a requirement"):
        parse_requirement(text.strip())


def test_a_marker_that_cannot_be_evaluated_is_left_to_the_installation() -> None:
    (package,) = parse_lock(f"arm==1.0 ; os_name ~= 'x' {HASH}\n")
    assert package.is_needed({"os_name": "posix"})


def test_the_versions_of_a_lock_are_listed_once() -> None:
    forked = LOCK + f"arm==0.9 ; python_full_version < '3.9' \\\n    {HASH}\narm==1.0 ; os_name == 'nt' {HASH}\n"
    assert pinned_versions(forked) == ["arm==1.0", "robot-arm==2.1", "arm==0.9"]
    assert pinned_versions(forked.replace("\n", "\r\n")) == pinned_versions(forked)
    assert pinned_versions(None) == []
