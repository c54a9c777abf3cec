"""One mission per subfolder: errors that stop all of them, and errors that stop only one."""

from pathlib import Path
from typing import Any

import pytest

from kleinkram.cli import transfer as module
from kleinkram.cli.errors import ExitCode, Interrupted
from kleinkram.contract.errors import KleinkramError, NotFound


def _upload(folder: Path, failure: KleinkramError, monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], Any]:
    """Upload two subfolders, the first of which fails; return which were begun, and what came of it."""
    for name in ("a", "b"):
        (folder / name).mkdir()
    begun: list[str] = []

    def upload(_client: object, _project: str, mission: str, *_: object) -> tuple[dict[str, object], int]:
        begun.append(mission)
        if mission == "a":
            raise failure
        return {}, 0

    monkeypatch.setattr(module, "_upload", upload)
    how = module._UploadOptions(True, None, False, (), None, 1, None, False)
    client: Any = None
    return begun, lambda: module._upload_folders(client, "alpine", [str(folder)], how)


def test_ctrl_c_stops_all_uploads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, run = _upload(tmp_path, Interrupted(), monkeypatch)
    with pytest.raises(Interrupted):
        run()
    assert begun == ["a"]


def test_a_failed_upload_does_not_stop_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, run = _upload(tmp_path, NotFound(resource_type="mission", ref="a"), monkeypatch)
    result, code = run()
    assert (begun, code) == (["a", "b"], ExitCode.not_found)
    assert [item["mission"] for item in result["items"]] == ["a", "b"]
