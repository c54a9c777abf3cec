"""Code of an action is tested as a plain process with the environment of a run."""

from pathlib import Path

import pytest

from kleinkram.action.testing import try_out
from kleinkram.client.errors import InvalidInput
from tests.package_index import serve_index

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


def test_dependencies_of_a_script_are_installed_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    script = tmp_path / "look.py"
    header = '# /// script\n# dependencies = ["arm-of-tests", "packaging"]\n# ///\n'
    script.write_text(header + "import arm_of_tests\nprint(arm_of_tests.VERSION)\n")
    with serve_index(tmp_path / "wheels") as index:
        index.add("arm-of-tests", "1.0")
        index.add("packaging", "99.0")
        monkeypatch.setenv("KLEINKRAM_PACKAGE_INDEX", index.url)
        (tmp_path / "one").mkdir()
        assert try_out(script, tmp_path / "one", files={"a": b""}).log == "1.0\n"

        monkeypatch.setenv("KLEINKRAM_PACKAGE_INDEX", "off")
        (tmp_path / "two").mkdir()
        assert "No module named 'arm_of_tests'" in try_out(script, tmp_path / "two", files={"a": b""}).log

        monkeypatch.setenv("KLEINKRAM_PACKAGE_INDEX", index.url)
        script.write_text(header.replace("arm-of-tests", "leg-of-tests"))
        (tmp_path / "three").mkdir()
        with pytest.raises(InvalidInput, match="There is no package leg-of-tests in the package index"):
            try_out(script, tmp_path / "three", files={})
