"""`klein audit` lists, filters and exports events."""

import json

from tests.acceptance.conftest import Terminal


def test_events_are_found_and_exported(terminal: Terminal, project: str) -> None:
    terminal.run("mission", "create", "m", "-p", project)
    events = terminal.run("audit", "-p", project, "--operation", "mission.*", "--person", "owner", "--json").json()
    assert [event["operation"] for event in events["items"]] == ["mission.create"]
    mission_id = events["items"][0]["resource_id"]
    shown = terminal.run("audit", "-m", "m", "-p", project).out
    assert "mission.create" in shown
    assert "token local owner" in shown
    assert "127.0.0.1" in shown
    lines = terminal.run("audit", "--export", "-p", project).out.splitlines()
    assert [json.loads(line)["operation"] for line in lines] == ["project.create", "mission.create"]
    assert terminal.run("audit", "--jsonl", "--id", mission_id, "--until", "2000-01-01").out == ""
    since = ["--since", events["items"][0]["at"]]
    assert len(terminal.run("audit", *since, "-p", project, "--export").out.splitlines()) == 1


def test_invalid_filters_are_refused(terminal: Terminal) -> None:
    assert "--export prints everything" in terminal.run("audit", "--export", "--limit", 3, code=2).err
    assert "resource_id" in terminal.run("audit", "--id", "x", code=2).err
    assert "write a time as" in terminal.run("audit", "--since", "yesterday", code=2).err
