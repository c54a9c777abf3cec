"""The folder of a runner."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.runner.input_cache import InputCache
from kleinkram.runner.state_directory import open_state_directory


@pytest.mark.parametrize("name", ["runs", "cache", "environments", "images"])
def test_other_users_cannot_look_into_a_folder_that_they_can_read(tmp_path: Path, name: str) -> None:
    """Inputs and results are readable for each user, since jobs may be others; on a cluster there are many."""
    tmp_path.chmod(0o755)
    (tmp_path / name).mkdir()
    (tmp_path / name).chmod(0o755)
    with open_state_directory(tmp_path):
        InputCache(tmp_path / "cache", 10**6)
        assert (tmp_path / name).stat().st_mode & 0o777 == 0o700
    assert tmp_path.stat().st_mode & 0o777 == 0o755, "it may have other folders, for others"
