"""The demo: the commands of docs/story.md, run against a real instance. `make demo`; `--story` runs all of them.

Everything happens in `.demo/`, on loopback, and is stopped at the end. Exit code 0 means that every step succeeded.
"""

import argparse
import filecmp
import json
import secrets
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from people import Browser, log_in
from slam import evaluate_odometry
from stage import KLEIN, STAGE, Failed, Story, environment, klein, url

FIELDS = """\
# Metadata of every mission in this project.
undeclared: refuse
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true, description: Which robot was out}
  - {name: operator, type: string, required: true, description: Who held the remote}
  - {name: temperature, type: number, unit: degC}
  - {name: location, type: location}
"""
METADATA = """\
robot: anymal
operator: Ada
temperature: 7.5 degC
location: {latitude: 46.5475, longitude: 7.9808, name: Jungfraujoch}
"""
# An action is one file; its first comment is its definition.
ACTION = """\
# /// script
# dependencies = ["open-kleinkram"]
#
# [tool.kleinkram]
# description = "Rates of IMU topics, and a table of them"
# inputs = {topics = ["*imu*"]}
# right = "CREATE"
# ///
from kleinkram.action import context, out, progress, report

rows = ["file,topic,rate_hz"]
imu_topics = [topic for topic in context().topics if "imu" in topic.name and topic.rate_hz]
paths = {file.id: file.path for file in context().files}
for number, topic in enumerate(imu_topics, 1):
    progress(number / len(imu_topics), topic.name)
    print(f"{paths[topic.file_id]}: {topic.name} at {topic.rate_hz:.1f} Hz", flush=True)
    report.metric("imu_rate", topic.rate_hz, unit="Hz", file=paths[topic.file_id])
    rows.append(f"{paths[topic.file_id]},{topic.name},{topic.rate_hz:.3f}")
(out / "imu_rates.csv").write_text("\\n".join(rows) + "\\n")
report.mission_file("imu_rates.csv", "derived/imu_rates.csv")
"""


def main() -> int:
    """Run the steps; returns 0 if all succeed."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--story", action="store_true", help="run all steps")
    options = arguments.parse_args()
    story = Story()
    try:
        with running_instance(story):
            upload_and_find(story)
            if options.story:
                # Before there is a second account: then runs without containers need nobody's permission.
                evaluate_odometry(story)
            show_access(story)
            if options.story:
                run_remaining_steps(story)
    except Failed as failure:
        sys.stderr.write(f"\nThe demo failed: {failure}\n")
        return 1
    story.close()
    return 0


@contextmanager
def running_instance(story: Story) -> Iterator[None]:
    """Start Kleinkram in an empty directory, and stop it cleanly."""
    if (STAGE / "data").exists():
        subprocess.run([KLEIN, "down"], env=environment(), capture_output=True, check=False)
    shutil.rmtree(STAGE, ignore_errors=True)
    STAGE.mkdir()
    with story.step("Start Kleinkram: PostgreSQL, S3, API, worker and runner, as one command"):
        print("$ klein up", flush=True)
        process = subprocess.Popen([KLEIN, "up"], env=environment(), stdout=subprocess.PIPE, text=True, cwd=STAGE)
        line = process.stdout.readline() if process.stdout else ""
        if not line:
            raise Failed("Kleinkram did not start; its logs are in .demo/data/logs")
        print(f"  {line.strip()}")
    try:
        yield
    finally:
        with story.step("Stop it"):
            process.send_signal(signal.SIGINT)
            code = process.wait(timeout=60)
    if code != 0:
        raise Failed(f"Kleinkram ended with {code}")


def upload_and_find(story: Story) -> None:
    """Upload a field day, inspect it, find it, download it, run an action, and kill an upload half-way."""
    with story.step("Make a sample mission: MCAP, ROS 1 bag and rosbag2, with cameras, lidar, IMU, GPS, tf"):
        klein("sample", "field-day", "--size", "150MB", "--seed", "7")
    with story.step("Declare the metadata that missions need"):
        (STAGE / "fields.yaml").write_text(FIELDS)
        klein("project", "create", "alpine", "--description", "Walks above the snow line", "--fields", "fields.yaml")
    with story.step("Without the metadata, nothing is uploaded"):
        (STAGE / "wrong.yaml").write_text("robot: rover\ntemprature: 7\n")
        klein(
            "upload",
            "-p",
            "alpine",
            "-m",
            "jungfraujoch-1",
            "--create",
            "--metadata",
            "wrong.yaml",
            "field-day",
            expect=6,
        )
    with story.step("Upload, and wait for the summaries"):
        (STAGE / "mission.yaml").write_text(METADATA)
        klein(
            *("upload", "-p", "alpine", "-m", "jungfraujoch-1", "--create"),
            *("--metadata", "mission.yaml", "--wait", "field-day"),
        )
    with story.step("Inspect it"):
        klein("project", "info", "alpine")
        klein("mission", "info", "jungfraujoch-1", "-p", "alpine")
    with story.step("Find a file by a topic in it"):
        klein("search", "--topic", "*imu*", "--where", "robot=anymal")
        matches = json.loads(klein("search", "--topic", "*imu*", "--json", show=False))
        if not matches["items"]:
            raise Failed("the search for an IMU topic found nothing")
    with story.step("Download it, and compare every byte"):
        klein("download", "-p", "alpine", "-m", "jungfraujoch-1", "--dest", "back")
        compare(STAGE / "field-day", STAGE / "back")
    with story.step("Take just two topics of two seconds: as one MCAP, and as tables"):
        klein(
            *("cut", "-p", "alpine", "-m", "jungfraujoch-1", "field-day/drive.mcap"),
            *("--topics", "/imu/data,/odom"),
            *("--start", "+1s", "--end", "+3s", "-o", "slice.mcap"),
        )
        klein("inspect", "slice.mcap")
        klein("export", "slice.mcap", "--to", "parquet", "-o", "tables")
    check_missions(story)
    run_an_action(story)
    kill_and_resume(story)


def check_missions(story: Story) -> None:
    """Make rules from a good mission; find a bad one before and after its upload."""
    with story.step("Make rules from the good mission, and give them to the project"):
        klein("checks", "init", "field-day", "-o", "checks.yaml")
        klein("checks", "set", "checks.yaml", "-p", "alpine")
    with story.step("Its files are there already: check them here, and send only the outcome"):
        klein("upload", "-p", "alpine", "-m", "jungfraujoch-1", "--check", "field-day")
    with story.step("On the robot, before it leaves the field: is this run any good?"):
        defects = ("--defect", "gap", "--defect", "black-camera")
        klein("sample", "bad-day", "--size", "30MB", "--seed", "9", *defects)
        klein("check", "bad-day", "--checks", "checks.yaml", expect=2)
    with story.step("Uploaded all the same, it is bad on the server too"):
        mission = ("-p", "alpine", "-m", "bad-day")
        metadata = ("--create", "--metadata", "mission.yaml")
        klein("upload", *mission, *metadata, "--wait", "--check", "bad-day")
        verdicts = wait_for_verdicts()
        if verdicts != {"jungfraujoch-1": "good", "bad-day": "bad"}:
            raise Failed(f"the verdicts are {verdicts}")
        klein("mission", "list", "-p", "alpine")
        klein("search", "verdict:bad check:image.*")


def wait_for_verdicts() -> dict[str, str]:
    """Return the verdict of each mission as soon as all are checked."""
    deadline = time.monotonic() + 30
    while True:
        missions = json.loads(klein("mission", "list", "-p", "alpine", "--json", show=False))["items"]
        verdicts = {mission["name"]: mission["verdict"] for mission in missions}
        if not {"running", "unchecked", "outdated"} & {*verdicts.values()} or time.monotonic() > deadline:
            return verdicts
        time.sleep(0.3)


def run_an_action(story: Story) -> None:
    """Run a script on the mission: live log, a metric, an artifact, and its lineage."""
    mission = ("-p", "alpine", "-m", "jungfraujoch-1")
    (runner,) = json.loads(klein("runner", "list", "--json", show=False))["items"]
    kind = {"docker": "a container", "process": "a process, because no container engine is running"}
    with story.step(f"Run a script on the mission, as {kind[runner['abilities']['executor']]}"):
        (STAGE / "imu_rate.py").write_text(ACTION)
        klein("action", "run", "imu_rate.py", *mission, "--follow")
        (run,) = json.loads(klein("run", "list", "-p", "alpine", "--json", show=False))["items"]
        if (run["state"], run["metric_count"] > 0, run["artifact_count"]) != ("done", True, 1):
            raise Failed(f"the run failed: {run}")
    with story.step("Its artifacts, and their lineage"):
        klein("run", "artifacts", run["id"], "--download", "artifacts")
        klein("lineage", "derived/imu_rates.csv", *mission)


def compare(source: Path, copy: Path) -> None:
    """Compare two folders byte by byte."""
    files = sorted(path.relative_to(source) for path in source.rglob("*") if path.is_file())
    roots = [copy, copy / source.name]
    for path in files:
        there = next((root / path for root in roots if (root / path).is_file()), None)
        if there is None or not filecmp.cmp(source / path, there, shallow=False):
            raise Failed(f"{path} differs after the download")
    print(f"  {len(files)} files compared: all identical")


def kill_and_resume(story: Story) -> None:
    """Kill an upload half-way with SIGKILL, run the same command again, and show how much is sent again."""
    with story.step("Kill an upload half-way (kill -9) ..."):
        klein("sample", "second-day", "--size", "120MB", "--seed", "8", show=False)
        command = ["upload", "-p", "alpine", "-m", "jungfraujoch-2", "--create", "--metadata", "mission.yaml"]
        print(f"$ klein {' '.join(command)} --limit-rate 20M second-day  &  kill -9 $!", flush=True)
        process = subprocess.Popen(
            [KLEIN, *command, "--limit-rate", "20M", "second-day"],
            env=environment(),
            cwd=STAGE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        # Half-way by the clock of the rate limit: 120 MB at 20 MB/s.
        try:
            process.wait(timeout=3.5)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
        if process.returncode != -signal.SIGKILL:
            raise Failed(f"the upload ended by itself ({process.returncode}) before it could be killed")
    with story.step("... and run the same command again"):
        klein(*command, "second-day")
        klein("verify", "-p", "alpine", "-m", "jungfraujoch-2", "second-day")


def show_access(story: Story) -> None:
    """A person who gets access, and a robot that can only upload."""
    with story.step("Ben is invited, chooses a password in his browser, and signs in on his laptop"):
        klein("project", "create", "secret-plans", show=False)
        browser, link = Browser(url()), klein("person", "invite", "ben@lab.example", "--name", "Ben", show=False)
        print("$ klein person invite ben@lab.example --name Ben")
        browser.accept_invitation(link.strip(), secrets.token_urlsafe())
        print(f"ben$ klein login {browser.url}", flush=True)
        if log_in(KLEIN, browser, environment("ben"), lambda line: print(f"  {line}", flush=True)) != 0:
            raise Failed("Ben could not sign in")
    with story.step("Without a grant, Ben sees nothing"):
        klein("project", "list", who="ben")
        klein("mission", "info", "jungfraujoch-1", "-p", "alpine", who="ben", expect=3)
    with story.step("With READ, Ben can read but not change"):
        klein("access", "grant", "READ", "--to", "ben@lab.example", "-p", "alpine")
        klein("search", "--topic", "*imu*", who="ben")
        klein("mission", "delete", "jungfraujoch-1", "-p", "alpine", "--yes", who="ben", expect=4)
    with story.step("A robot gets an upload-only token for one project"):
        print("$ klein token create anymal-3 --kind robot -p alpine --days 30")
        token = klein(
            "token", "create", "anymal-3", "--kind", "robot", "-p", "alpine", "--days", "30", show=False
        ).strip()
        print(f"  {token[:16]}…")
        (STAGE / "robot.log").write_text("all well\n")
        mission = ("-p", "alpine", "-m", "ridge")
        robot = {"who": "anymal-3", "token": token}
        klein("upload", *mission, "--create", "--metadata", "mission.yaml", "robot.log", **robot)
        klein("project", "list", **robot)
        klein("download", *mission, "--dest", "stolen", expect=4, **robot)
    with story.step("Everything is in the audit log"):
        klein("audit", "-p", "alpine", "--limit", "6")


def run_remaining_steps(story: Story) -> None:
    """The remaining steps: statistics, duplicates, and the trash."""
    with story.step("Statistics"):
        klein("stats", "--by", "topic", "-p", "alpine")
        klein("stats", "--by", "metadata.robot")
    with story.step("The same folder again: nothing is sent"):
        klein("upload", "-p", "alpine", "-m", "jungfraujoch-1", "field-day")
    with story.step("Delete a mission, and restore it"):
        klein("mission", "delete", "jungfraujoch-2", "-p", "alpine", "--yes")
        klein("trash", "list")
        klein("trash", "restore", "jungfraujoch-2")
    with story.step("Show the audit log"):
        klein("audit", "-p", "alpine")
    with story.step("Check the instance"):
        klein("doctor")


if __name__ == "__main__":
    sys.exit(main())
