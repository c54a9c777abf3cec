"""Code of an action is tested as a plain process with the environment of a run."""

from pathlib import Path

import pytest

from kleinkram.action.testing import try_out
from kleinkram.client.errors import InvalidInput

SCRIPT = """\
# /// script
# [tool.kleinkram]
# parameters = [{name = "factor", type = "integer"}]
# ///
import json
from kleinkram.action import context, inputs, out, parameters, report

for path in inputs():
    report.metric("size", path.stat().st_size * parameters()["factor"], unit="B", file=path)
(out / "report.json").write_text(json.dumps({"findings": [{"severity": "info", "code": "a.b", "message": "seen"}]}))
print("of", context().mission.metadata["robot"])
raise SystemExit(3)
"""


def test_report_and_artifacts_are_returned(tmp_path: Path) -> None:
    script, folder = tmp_path / "look.py", tmp_path / "run"
    script.write_text(SCRIPT)
    folder.mkdir()
    ran = try_out(script, folder, files={"a/b.txt": b"four"}, parameters={"factor": 2}, metadata={"robot": "anymal"})
    assert (ran.exit_code, ran.log) == (3, "of anymal\n")
    assert ran.metric("size", "a/b.txt") == 8
    assert ran.codes() == {"a.b"}
    with pytest.raises(InvalidInput, match="requires its parameter 'factor'"):
        try_out(script, folder, files={})
