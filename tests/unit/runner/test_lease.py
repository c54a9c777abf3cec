"""How long a run is held, written down beside it."""

from pathlib import Path

import pytest

from kleinkram.runner.orders import Lease
from kleinkram.runner.ward import HELD


def test_a_folder_that_is_being_removed_gets_nothing_back(tmp_path: Path) -> None:
    lease = Lease(1.0)
    with pytest.raises(FileNotFoundError):
        lease.note_again(tmp_path)
    assert [*tmp_path.iterdir()] == []
    lease.write_down(tmp_path)
    before = (tmp_path / HELD).read_text()
    lease.renew(0.0, 1e6)
    lease.note_again(tmp_path)
    assert float((tmp_path / HELD).read_text()) > float(before)
