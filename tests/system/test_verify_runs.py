"""`verify` as an action of a project: missions become good or bad by themselves, and again when the rules change."""

from pathlib import Path

import pytest

from kleinkram.cli.errors import ExitCode
from kleinkram.library import lidar_odometry
from kleinkram.recordings.sample import Defect, Faults, SampleFormat, generate_mission
from tests.acceptance.conftest import wait_until
from tests.system import backend
from tests.system.cluster import Cluster

_VERIFY = Path(lidar_odometry.__file__).with_name("verify.py")
_RULES = """
version: 1
profiles:
- topics: {/imu/data: {rate: 200 Hz}}
  images: {/camera/*: {max_brightness: 243}}
"""
_STRICT_RULES = _RULES.replace("243", "20")
_REPORTS = """
    SELECT mission.name, count(*), bool_and(check_report.run_id IS NOT NULL) FROM check_report
    JOIN mission ON mission.id = check_report.mission_id GROUP BY mission.name ORDER BY mission.name
"""


def _record(folder: Path, *defects: Defect) -> None:
    faults = Faults(defects=frozenset(defects))
    generate_mission(folder, duration_s=3, size_bytes=3_000_000, formats=[SampleFormat.mcap], faults=faults)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_missions_become_good_or_bad_without_a_person(cluster: Cluster) -> None:
    # Without an engine, runs are processes, which have the packages of this machine.
    cluster.settings |= {"DOCKER_HOST": f"unix://{cluster.home}/nothing", "KLEINKRAM_PACKAGE_INDEX": "off"}
    cluster.start()
    klein, rules = cluster.terminal, cluster.home / "checks.yaml"
    rules.write_text(_RULES)
    klein.run("project", "create", "p")
    klein.run("checks", "set", rules, "-p", "p")
    klein.run("action", "create", _VERIFY, "-p", "p")
    # On a slow machine, seconds pass between the files of a mission. None of them may be checked without the others.
    klein.run("project", "actions", "add", "verify", "-p", "p", "--on", "idle", "--idle", "10s")
    _record(cluster.home / "drives" / "good")
    _record(cluster.home / "drives" / "black", Defect.black_camera)

    def verdicts() -> dict[str, str]:
        listed = klein.run("mission", "list", "-p", "p", "--json").json()["items"]
        return {mission["name"]: mission["verdict"] for mission in listed}

    def become(expected: dict[str, str]) -> None:
        def has_happened() -> bool:
            backend.tidy(cluster)  # its worker does this once a minute
            return verdicts() == expected

        wait_until(has_happened, f"the missions to be {expected}")

    klein.run("upload", "-p", "p", "--mission-per-folder", "--create", "--wait", cluster.home / "drives")
    # Outdated: a part of the mission was judged before the rest of it arrived.
    before = {"unchecked", "running", "outdated"}
    assert verdicts()["good"] in before | {"good"}
    assert verdicts()["black"] in before | {"bad"}
    become({"good": "good", "black": "bad"})
    assert backend.sql(cluster, _REPORTS) == [("black", 1, True), ("good", 1, True)]
    checks = klein.run("checks", "mission", "p/black", "--json").json()["checks"]
    assert [(check["name"], check["source"]) for check in checks if check["status"] == "error"] == [
        ("image.black", "report")
    ]

    local = ("action", "run-local", _VERIFY, "-m", "black", "-p", "p", "--package-index", "off")
    ran = klein.run(*local, "--out", cluster.home / "out", code=ExitCode.verdict_bad)
    assert "Nothing was sent: this run has no access to the server." in ran.err

    rules.write_text(_STRICT_RULES)
    klein.run("checks", "set", rules, "-p", "p")
    assert verdicts()["good"] in {"outdated", "running", "bad"}
    become({"good": "bad", "black": "bad"})
    backend.tidy(cluster)
    assert backend.sql(cluster, _REPORTS) == [("black", 2, True), ("good", 2, True)]
    assert backend.sql(cluster, "SELECT count(*), count(run_id) FROM automatic_run") == [(4, 4)]
