"""Objects whose names are attacks: markup, script URLs, templates of other frameworks."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kleinkram.cli.errors import ExitCode
from kleinkram.recordings.sample import Faults, TopicGap, generate_bag, generate_mcap
from tests.acceptance.conftest import Terminal, wait_until
from tests.recording_files.writers import McapWriter

# A host that the browser would call if any of these names became an element.
FOREIGN = "http://evil.invalid"
# Names may not contain the characters of paths and wildcards, such as quotes and slashes.
PROJECT = "<img src=x onerror=wasRun=1> {{7+7}}"
MISSION = "<svg onload=wasRun=1> javascript:wasRun=1"
GROUP = "<b onmouseover=wasRun=1 autofocus onfocus=wasRun=1>"
PERSON = f'"><img src="{FOREIGN}/person.png" onerror="wasRun=1">'
TOKEN = f"<iframe src={FOREIGN}/token>"
LABEL = "<img src=x onerror=wasRun=1>"
SHARE = '<script>wasRun=1</script>"><script src=//evil.invalid>'
NOTES = f"[a link](javascript:wasRun=1) ![x]({FOREIGN}/notes.png) <img src=x onerror=wasRun=1> {{{{7*7}}}} ${{7*7}}"
VALUE = f'"><svg onload=wasRun=1><img src="{FOREIGN}/value.png">{{{{constructor.constructor(\'wasRun=1\')()}}}}'
ADDRESS = "javascript:wasRun=1"
DESCRIPTION = f'<style>@import "{FOREIGN}/style.css";body{{display:none}}</style><base href="{FOREIGN}">'
TOPIC = "/<img src=x onerror=wasRun=1>/{{7*7}}"
TYPE = "evil_msgs/<svg onload=wasRun=1>"
RECORDING = '"><svg onload=wasRun=1>.mcap'
TEXT = "<iframe srcdoc='<script>parent.wasRun=1<'>.txt"
ACTION = "look <img src=x onerror=wasRun=1>"
BROKEN = "cut <img src=x onerror=wasRun=1>.bag"
PROFILE = f"<object data={FOREIGN}/profile> {{{{7*7}}}}"
REASON = f"<embed src={FOREIGN}/reason> <a href=javascript:wasRun=1>known</a>"

_FIELDS = [
    {
        "name": "robot",
        "type": "choice",
        "choices": ["anymal", VALUE[:60]],
        "required": True,
        "description": DESCRIPTION,
    },
    {"name": "operator", "type": "string", "pattern": "[a-z<>=\\s]+", "required": True, "description": VALUE},
    {"name": "wind", "type": "number", "unit": "<b>m"},
]


_RULES = f"# {NOTES}\n" + json.dumps(
    {
        "version": 1,
        "profiles": [
            {
                "name": PROFILE,
                "files": {"*.mcap": {"min_size": "1GB"}},
                "topics": {
                    TOPIC: {"type": "std_msgs/String", "rate": "10 Hz", "max_gap": "1ms"},
                    f"{TOPIC}/missing": {},
                    "/imu/*": {"max_gap": "1s", "severity": "warning"},
                },
                "images": {"/camera/*": {}},
            },
            {"name": f"left out {LABEL}", "when": {"robot": VALUE[60:]}, "topics": {TOPIC: {}}},
        ],
    },
    indent=2,
)
_PUBLIC_RULES = "version: 1\nprofiles:\n- topics:\n    /imu/*: {max_gap: 1s}\n    /lake: {}\n"

_SCRIPT = f"""\
# /// script
# [tool.kleinkram]
# name = {json.dumps(ACTION)}
# description = {json.dumps(DESCRIPTION)}
# [[tool.kleinkram.parameters]]
# name = "robot"
# type = "choice"
# choices = [{json.dumps(VALUE[:60])}]
# description = {json.dumps(VALUE)}
# ///
from kleinkram.action import out, report

print({NOTES!r}, flush=True)
report.finding("error", "evil", {VALUE!r}, topic={TOPIC!r})
report.metric("evil", 1, unit="<b>m", topic={TOPIC!r}, labels={{"method": {LABEL!r}}})
report.check("evil.check", "error", {VALUE!r}, value=2, limit=1, unit="<b>m", topic={TOPIC!r})
report.propose(robot={VALUE!r})
for ending in ("svg", "csv", "geojson"):
    (out / f"evil.{{ending}}").write_text({NOTES!r})
    report.preview(f"evil.{{ending}}", title={LABEL!r})
"""


@dataclass(frozen=True)
class World:
    """Ids and addresses for the browser program."""

    invitation: str
    unused_invitation: str
    share: str
    ids: dict[str, str]


def make_world(terminal: Terminal, folder: Path) -> World:
    """Fill a server, and wait until all files are read."""
    _projects(terminal, folder)
    day = _day(folder / "day")
    place = ("-p", PROJECT, "-m", MISSION)
    metadata = folder / "metadata.yaml"
    metadata.write_text(
        json.dumps({"robot": VALUE[:60], "operator": "<b onclick=wasrun>", "page": ADDRESS, "extra": VALUE})
    )
    terminal.run("mission", "create", *place, "--metadata", metadata, "--notes", NOTES)
    terminal.run("upload", *place, f"{day}/")
    terminal.run("mission", "create", "-p", PROJECT, "-m", f"gone {LABEL}", "--metadata", metadata)
    terminal.run("mission", "delete", f"gone {LABEL}", "-p", PROJECT, "--yes")
    # The field is declared as a link after it has a value, so that the value was never validated as one.
    fields = folder / "later.yaml"
    fields.write_text(json.dumps({"undeclared": "accept", "fields": [*_FIELDS, {"name": "page", "type": "link"}]}))
    terminal.run("project", "update", PROJECT, "--fields", fields)
    terminal.run("file", "update", RECORDING, *place, "--label", LABEL)
    invited = terminal.run("person", "invite", "eve@lab.example", "--name", PERSON, "--json").json()
    other = terminal.run("person", "invite", "mallory@lab.example", "--name", PERSON, "--json").json()
    terminal.run("group", "create", GROUP)
    terminal.run("token", "create", TOKEN, "--days", 9)
    share = terminal.run("share", "create", *place, "--name", SHARE, "--json").json()

    def files() -> list[dict[str, Any]]:
        return list(terminal.run("file", "list", "--json").json()["items"])

    script = folder / "evil.py"
    script.write_text(_SCRIPT)
    terminal.run("action", "create", script)
    parameters = ("--set", f"robot={VALUE[:60]}")
    terminal.run("action", "run", ACTION, *place, *parameters, "--follow", "--yes", code=ExitCode.verdict_bad)
    wait_until(lambda: all(file["content"] != "pending" for file in files()), "all files to be read")
    known = {file["path"]: file["id"] for file in files()}
    missions = {row["name"]: row["id"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    _check(terminal, folder, parameters)
    projects = {row["name"]: row["id"] for row in terminal.run("project", "list", "--json").json()["items"]}
    groups = {row["name"]: row["id"] for row in terminal.run("group", "list", "--json").json()["items"]}
    actions = terminal.run("action", "list", "--json").json()["items"]
    runs = terminal.run("run", "list", "--json").json()["items"]
    ids = {
        "action": actions[0]["id"],
        "run": runs[0]["id"],
        "project": projects[PROJECT],
        "empty": projects["Nothing yet"],
        "public": projects["Lakes"],
        "mission": missions[MISSION],
        "publicMission": missions["shore"],
        "recording": known[RECORDING],
        "drive": known["drive.mcap"],
        "broken": known[BROKEN],
        "text": known[TEXT],
        "publicFile": known["shore.mcap"],
        "group": groups[GROUP],
    }
    return World(invited["url"], other["url"], share["url"], ids)


def _check(terminal: Terminal, folder: Path, parameters: tuple[str, ...]) -> None:
    """Give the projects rules and an action that checks; accept a check, and wait for the verdicts."""
    for project, text in ((PROJECT, _RULES), ("Lakes", _PUBLIC_RULES)):
        rules = folder / "checks.yaml"
        rules.write_text(text)
        terminal.run("checks", "set", "-p", project, rules)
    terminal.run("project", "actions", "add", ACTION, "-p", PROJECT, "--on", "idle", "--idle", "24h", *parameters)

    def verdicts() -> set[str]:
        return {row["verdict"] for row in terminal.run("mission", "list", "--json").json()["items"]}

    wait_until(lambda: verdicts() == {"bad"}, "all missions to be checked")
    place = ("-p", PROJECT, "-m", MISSION)
    terminal.run("mission", "accept", *place, "--check", "file.size", "--because", REASON)
    terminal.run("mission", "note", *place, "--check", "topic.gap", "--topic", TOPIC, "--text", NOTES)


def _projects(terminal: Terminal, folder: Path) -> None:
    fields = folder / "fields.yaml"
    fields.write_text(json.dumps({"undeclared": "accept", "fields": _FIELDS}))
    terminal.run("project", "create", PROJECT, "--description", DESCRIPTION, "--fields", fields)
    terminal.run("project", "create", "Nothing yet")
    terminal.run("project", "create", "Lakes", "--description", "What everybody may see.")
    shore = folder / "shore.mcap"
    generate_mcap(shore, size_bytes=400_000, duration_s=20, seed=4)
    terminal.run("upload", "-p", "Lakes", "-m", "shore", "--create", shore)
    terminal.run("project", "update", "Lakes", "--public")


def _day(day: Path) -> Path:
    day.mkdir()
    generate_mcap(
        day / "drive.mcap", duration_s=12, size_bytes=3_000_000, faults=Faults(gap=TopicGap("/imu/data", 3, 4))
    )
    generate_bag(day / BROKEN, duration_s=10, size_bytes=2_000_000, faults=Faults(truncate_to=0.6))
    (day / TEXT).write_text(VALUE)
    with (day / RECORDING).open("xb") as file:
        writer = McapWriter(file, profile=LABEL)
        schema = writer.add_schema(TYPE, "ros2msg", b"string data\n")
        channel = writer.add_channel(TOPIC, schema, "cdr")
        for number in range(50):
            writer.add_message(
                channel, 1_714_550_400_000_000_000 + number * 10**8, b"\0\1\0\0\2\0\0\0x\0", publish_time_ns=1
            )
        writer.finish()
    return day
