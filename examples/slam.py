"""The part of the story about SLAM: odometry and its error run by themselves, and two versions are compared."""

import json
import os
import re
import subprocess
import time

from stage import KLEIN, STAGE, Failed, Story, environment, klein

ACTIONS = ("lidar-odometry", "slam-evaluate")
DRIVES = ("courtyard", "corridor")
PROJECT = ("-p", "slam")
WAIT_LIMIT_S = 600
MAX_ATE_M = 0.05
FIRST, SECOND = "derived/lidar-odometry.tum", "derived/coarse.tum"


def evaluate_odometry(story: Story) -> None:
    """Have odometry and evaluation run on two drives by themselves, and compare with a coarser version."""
    if (reason := missing_packages()) is not None:
        if os.environ.get("KLEINKRAM_REQUIRE_ALL") == "1":
            raise Failed(f"the packages of odometry and evaluation cannot be had: {reason}")
        with story.step("Odometry and its error: SKIPPED"):
            print(f"  Their packages cannot be had here: {reason}", flush=True)
        return
    with story.step(
        "Two actions that are shipped: odometry by the lidar, and its error. They are to run by themselves"
    ):
        klein("project", "create", "slam", "--description", "Drives with lidar and ground truth")
        for name in ACTIONS:
            klein("action", "add", f"kleinkram/{name}", *PROJECT)
            klein("project", "actions", "add", name, *PROJECT, "--on", "complete")
    with story.step("Upload two drives, which name their ground truth, and complete them. The rest happens by itself"):
        (STAGE / "reference.yaml").write_text("reference: /odom\n")
        for number, drive in enumerate(DRIVES):
            klein("sample", drive, "--duration", "10", "--format", "mcap", "--seed", str(21 + number), show=False)
            mission = (*PROJECT, "-m", drive)
            klein("upload", *mission, "--create", "--metadata", "reference.yaml", "--wait", drive)
            klein("mission", "complete", drive, *PROJECT)
        wait_for_evaluations(2)
        klein("run", "list", *PROJECT)
        klein("run", "metrics", *PROJECT, "--name", "ate_rmse", "--latest")
        check_errors()
    with story.step("Version 2 of the odometry has a map of 2 m. Its trajectories are evaluated by themselves, too"):
        copied = ("action", "library", "--show", "kleinkram/lidar-odometry")
        print(f"$ klein {' '.join(copied)} > lidar_odometry.py   # voxel_size: 2, to: {SECOND}", flush=True)
        (STAGE / "lidar_odometry.py").write_text(coarser(klein(*copied, show=False)))
        published = ("action", "create", "lidar_odometry.py", *PROJECT, "--new-version")
        print(f"$ klein {' '.join(published)}", flush=True)
        klein(*published, show=False)
        klein("action", "run", "lidar-odometry@2", "--query", "project:slam", "--yes")
        wait_for_evaluations(4)
    with story.step("How much worse is it, and how much faster? For a paper, in LaTeX"):
        error = ("metrics", "table", *PROJECT, "--metric", "ate_rmse", "--columns", "label.estimate")
        klein(*error, "--compare", f"estimate={FIRST}", f"estimate={SECOND}")
        speed = ("metrics", "table", *PROJECT, "--metric", "scan_rate", "--columns", "action,version")
        klein(*speed, "--compare", "lidar-odometry@1", "lidar-odometry@2")
        klein(*error, "--format", "latex")


def missing_packages() -> str | None:
    """Return why the packages of both actions cannot be had here; None where they can."""
    if os.environ.get("KLEINKRAM_PACKAGE_INDEX") == "off":
        return "KLEINKRAM_PACKAGE_INDEX is off."
    for name in ACTIONS:
        command = [KLEIN, "action", "lock", f"kleinkram/{name}", "--out", os.devnull]
        done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)
        if done.returncode != 0:
            return done.stderr.strip().splitlines()[-1].removeprefix("Error: ")
    return None


def wait_for_evaluations(count: int) -> None:
    """Wait until this many evaluations are done.

    Raises:
        Failed: one fails or cannot start, or it takes too long.
    """
    deadline = time.monotonic() + WAIT_LIMIT_S
    while True:
        runs = json.loads(klein("run", "list", *PROJECT, "--json", show=False))["items"]
        problems = [f"{run['action']['name']}: {run['message']}" for run in runs if run["state"] == "failed"]
        if not runs:
            named = json.loads(klein("project", "actions", "list", *PROJECT, "--json", show=False))["items"]
            problems = [action["problem"] for action in named if action["problem"]]
        if problems:
            raise Failed(problems[0])
        if sum((run["action"]["name"], run["state"]) == ("slam-evaluate", "done") for run in runs) >= count:
            return
        if time.monotonic() > deadline:
            raise Failed(
                f"{count} evaluations were expected: {[(run['action']['name'], run['state']) for run in runs]}"
            )
        time.sleep(1)


def check_errors() -> None:
    """Raise Failed unless each drive has an ATE, of less than five centimetres."""
    listed = klein("run", "metrics", *PROJECT, "--name", "ate_rmse", "--latest", "--json", show=False)
    errors = {row["mission"]["name"]: row["metric"]["value"] for row in json.loads(listed)["items"]}
    if errors.keys() != {*DRIVES} or max(errors.values()) >= MAX_ATE_M:
        raise Failed(f"the errors are {errors}")


def coarser(script: str) -> str:
    """Return the odometry with another resolution of its map, and another file for its trajectory."""
    changed = re.sub(r'(name = "voxel_size"(?:\n# .*)*?\n# default = )0\n', r"\g<1>2\n", script)
    return changed.replace(f'default = "{FIRST}"', f'default = "{SECOND}"')
