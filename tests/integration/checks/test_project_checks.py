"""`klein checks set|get|diff|history`, `klein check -p`, and the checks of `klein upload`, against a real server."""

import json
import uuid
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from kleinkram.checks.facts import MissionFacts
from kleinkram.checks.local import read_mission
from kleinkram.cli import main as entry
from kleinkram.recordings.sample import Faults, SampleFormat, generate_mission
from kleinkram.server.checks.facts import read_missions
from kleinkram.server.context import AppContext
from tests.integration.api_server import Api
from tests.integration.jobs import on_site, run_jobs

Klein = Callable[..., "Output"]
RULES = """\
version: 1
profiles:
- name: vehicle
  topics:
    /imu/data: {rate: 200, max_gap: 50ms}
  imu:
    /imu/data: {}
"""
_SIZE = 1_000_000


class Output(NamedTuple):
    """What a command printed."""

    stdout: str
    stderr: str


@pytest.fixture
def klein(api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Klein:
    """Run a command as a terminal would, but in this process, and check its exit code."""
    for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "home" / name))
    monkeypatch.setenv("KLEINKRAM_URL", api.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", str(api.token))

    def run(*arguments: object, code: int = 0) -> Output:
        monkeypatch.setattr("sys.argv", ["klein", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            entry.main()
        output = Output(*capsys.readouterr())
        assert (ended.value.code or 0) == code, f"{arguments}: {ended.value.code} {output}"
        return output

    return run


@pytest.fixture
def project(api: Api) -> str:
    return str(api.project(name=f"field-{uuid.uuid4().hex[:8]}")["name"])


@pytest.fixture
def rules(tmp_path: Path) -> Path:
    path = tmp_path / "rules" / "robot.yaml"
    path.parent.mkdir()
    path.write_text(RULES)
    return path


def _drive(folder: Path, **faults: Any) -> Path:
    generate_mission(folder, duration_s=3, size_bytes=_SIZE, formats=[SampleFormat.mcap], faults=Faults(**faults))
    return folder


def test_the_checks_of_a_project_are_set_fetched_compared_and_removed(
    klein: Klein, project: str, rules: Path, tmp_path: Path
) -> None:
    assert "has no checks" in klein("checks", "get", "-p", project, code=3).stderr
    assert "(number 1)" in klein("checks", "set", "-p", project, rules).stderr
    assert "already (number 1)" in klein("checks", "set", "-p", project, rules).stderr
    assert klein("checks", "get", "-p", project).stdout == RULES
    robot = tmp_path / "checks.yaml"
    klein("checks", "get", "-p", project, "-o", robot)
    assert "is up to date" in klein("checks", "get", "-p", project, "-o", robot).stderr
    assert "does not differ" in klein("checks", "diff", "-p", project, rules).stderr

    rules.write_text(RULES.replace("200", "100"))
    difference = klein("checks", "diff", "-p", project, rules).stdout
    assert "-    /imu/data: {rate: 200, max_gap: 50ms}\n+    /imu/data: {rate: 100, max_gap: 50ms}" in difference
    assert "(number 2)" in klein("checks", "set", "-p", project, rules).stderr
    assert "it exists and differs" in klein("checks", "get", "-p", project, "-o", robot, code=11).stderr
    klein("checks", "get", "-p", project, "-o", robot, "--overwrite")
    assert "rate: 100" in robot.read_text()
    assert klein("checks", "get", "-p", project, "--number", 1).stdout == RULES

    klein("checks", "set", "-p", project, "--remove")
    versions = json.loads(klein("checks", "history", "-p", project, "--json").stdout)["items"]
    assert [(one["number"], one["is_removal"]) for one in versions] == [(3, True), (2, False), (1, False)]
    klein("checks", "get", "-p", project, code=3)


def test_wrong_checks_are_refused_with_their_position(klein: Klein, project: str, rules: Path) -> None:
    rules.write_text(RULES.replace("rate", "rte"))
    error = klein("checks", "set", "-p", project, rules, code=6).stderr
    assert f"{rules}, line 5, column 17" in error
    assert "did you mean 'rate'?" in error
    klein("checks", "set", "-p", project, code=2)
    klein("checks", "set", "-p", project, rules, "--remove", code=2)


def test_a_robot_checks_by_the_file_of_its_project(klein: Klein, project: str, rules: Path, tmp_path: Path) -> None:
    drive = _drive(tmp_path / "bad", dropped_topic="/imu/data")
    klein("check", drive, "-p", project, code=3)
    klein("checks", "set", "-p", project, rules)
    printed = klein("check", drive, "-p", project, code=2).stdout
    assert "error   topic.missing  /imu/data  it is not recorded" in printed
    assert f"Rules:   checks of {project} (profile: vehicle)" in printed


def test_an_upload_says_what_is_wrong_and_stores_it(
    api: Api, klein: Klein, project: str, rules: Path, tmp_path: Path
) -> None:
    klein("checks", "set", "-p", project, rules)
    drive = _drive(tmp_path / "good")
    done = klein("upload", f"{drive}/", "-p", project, "-m", "good", "--create", "--check", "--json")
    document = json.loads(done.stdout)
    assert document["check_results"]["verdict"] == "good"
    assert "Verdict: good (5 passed)" in done.stderr
    assert "Stored the outcome of the checks with the mission." in done.stderr
    run_jobs(api)
    checks = api.get(f"/missions/{document['mission_id']}/checks").ok()
    assert checks["verdict"] == "good"
    assert [(report["depth"], report["is_current"]) for report in checks["reports"]] == [("content", True)]
    sources = {check["name"]: check["source"] for check in checks["checks"] if check["status"] == "ok"}
    assert sources["imu.gravity"] == "report", "the server reads no messages itself"


def test_a_bad_mission_is_uploaded_with_check_but_not_with_require_good(
    api: Api, klein: Klein, project: str, rules: Path, tmp_path: Path
) -> None:
    drive = _drive(tmp_path / "bad", dropped_topic="/imu/data")
    upload = ("upload", f"{drive}/", "-p", project, "-m", "bad", "--create")
    done = klein(*upload, "--require-good", "--checks", rules, code=16)
    assert "Verdict: bad" in done.stderr
    assert "Nothing was uploaded, because the verdict of the checks is bad" in done.stderr
    assert json.loads(klein("mission", "list", "-p", project, "--json").stdout)["items"] == []
    document = json.loads(klein(*upload, "--check", "--checks", rules, "--json").stdout)
    assert document["check_results"]["verdict"] == "bad"
    run_jobs(api)
    assert api.get(f"/missions/{document['mission_id']}/checks").ok()["verdict"] == "bad"


def test_an_upload_with_checks_needs_rules(klein: Klein, project: str, rules: Path, tmp_path: Path) -> None:
    drive = _drive(tmp_path / "drive")
    upload = ("upload", f"{drive}/", "-p", project, "-m", "a", "--create")
    assert "There is no checks.yaml beside" in klein(*upload, "--check", code=3).stderr
    assert "it needs --check or --require-good" in klein(*upload, "--checks", rules, code=2).stderr
    dry = json.loads(klein(*upload, "--require-good", "--checks", rules, "--dry-run", "--json").stdout)
    assert (dry["dry_run"], dry["check_results"]["verdict"]) == (True, "good")
    assert json.loads(klein("mission", "list", "-p", project, "--json").stdout)["items"] == []


def test_the_metadata_of_a_mission_choose_its_profile(klein: Klein, project: str, rules: Path, tmp_path: Path) -> None:
    rules.write_text(RULES.replace("- name: vehicle\n", "- name: vehicle\n  when: {robot: spot}\n"))
    drive = _drive(tmp_path / "drive")
    metadata = tmp_path / "mission.yaml"
    metadata.write_text("robot: anymal\n")
    upload = ("upload", f"{drive}/", "-p", project, "-m", "a", "--create", "--checks", rules)
    done = klein(*upload, "--metadata", metadata, "--require-good", code=16)
    assert "not applied: vehicle, because robot is anymal; it must be spot" in done.stderr
    metadata.write_text("robot: spot\n")
    klein(*upload, "--metadata", metadata, "--require-good")
    again = klein(*upload, "--require-good")
    assert "Verdict: good" in again.stderr, "the mission exists, and has its metadata"


# -- local and remote facts -------------------------------------------------------------------------------------------


def _server_facts(api: Api, mission_id: str) -> MissionFacts:
    async def read(context: AppContext) -> MissionFacts | None:
        async with context.database.begin() as db:
            return (await read_missions(db, [uuid.UUID(mission_id)]))[0].facts

    facts = on_site(api, read)
    assert facts is not None
    return facts


def _comparable(facts: MissionFacts) -> MissionFacts:
    """Return facts without the order of rows, and only with problems that checks use: the server read all bytes."""
    used = ("clock-jump", "gaps-upper-bound")
    recordings = (
        replace(
            one,
            paths=tuple(sorted(one.paths)),
            problems=tuple(sorted({problem for problem in one.problems if problem.code in used}, key=str)),
        )
        for one in facts.recordings
    )
    topics = (replace(one, recordings=tuple(sorted(one.recordings))) for one in facts.topics)
    return replace(
        facts,
        files=tuple(sorted(facts.files, key=lambda one: one.path)),
        recordings=tuple(sorted(recordings, key=lambda one: one.name)),
        topics=tuple(sorted(topics, key=lambda one: (one.name, one.message_type or ""))),
    )


@pytest.mark.parametrize("folder", ["sample", "derived/split_missing_file", "broken/truncated.mcap", "jump"])
def test_local_files_and_a_server_give_the_same_facts(
    api: Api, klein: Klein, project: str, tmp_path: Path, recordings_dir: Path, folder: str
) -> None:
    source = recordings_dir / folder
    if folder == "sample":
        source = tmp_path / "sample"
        generate_mission(source, duration_s=3, size_bytes=3 * _SIZE, formats=[*SampleFormat])
    elif folder == "jump":
        source = recordings_dir / "derived" / "auv_clock_jump_back.mcap"
    paths = f"{source}/" if source.is_dir() else str(source)
    mission_id = json.loads(klein("upload", paths, "-p", project, "-m", "m", "--create", "--json").stdout)["mission_id"]
    run_jobs(api)
    root = source if source.is_dir() else source.parent
    files = [*source.rglob("*")] if source.is_dir() else [source]
    local = read_mission({path.relative_to(root).as_posix(): path for path in files if path.is_file()}).facts
    server = _server_facts(api, mission_id)
    assert _comparable(server) == _comparable(local)
