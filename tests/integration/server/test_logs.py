"""Log lines with untrusted text are escaped."""

import json
import logging
import subprocess
import sys

from kleinkram.server.logs import JsonLines


def test_log_lines_cannot_control_a_terminal() -> None:
    path = "/käse \u009b31m\x1b[31m \u202eback \U000e0001"
    record = logging.makeLogRecord({"msg": "request", "fields": {"path": path}})
    line = JsonLines().format(record)
    assert line.isprintable()
    assert "käse" in line
    assert json.loads(line)["path"] == path


def test_the_error_that_ends_a_process_is_logged() -> None:
    program = (
        "from kleinkram.server.logs import set_up_logs; import threading\n"
        "set_up_logs('json')\n"
        "thread = threading.Thread(target=lambda: 1 / 0); thread.start(); thread.join()\n"
        "raise ValueError('no more')\n"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    lines = [json.loads(line) for line in ran.stderr.splitlines()]
    assert [line["message"] for line in lines] == [
        "ended by an error: ZeroDivisionError: division by zero",
        "ended by an error: ValueError: no more",
    ]
    assert all("Traceback" in line["exception"] for line in lines)
    assert ran.returncode == 1
