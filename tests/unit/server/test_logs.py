"""Log lines: what strangers choose of them is read, and never obeyed."""

import json
import logging

from kleinkram.server.logs import JsonLines


def test_a_terminal_that_shows_a_line_obeys_nothing_in_it() -> None:
    path = "/käse \u009b31m\x1b[31m \u202eback \U000e0001"
    record = logging.makeLogRecord({"msg": "request", "fields": {"path": path}})
    line = JsonLines().format(record)
    assert line.isprintable()
    assert "käse" in line
    assert json.loads(line)["path"] == path
