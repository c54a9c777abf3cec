"""Reading an untrusted `action.yaml`."""

import time
from pathlib import Path

import pytest

from kleinkram.client.actions import read_manifest
from kleinkram.client.errors import InvalidInput


@pytest.mark.parametrize("text", ["[" * 1000, "name: x\nparameters: " + "[" * 100_000, "- " * 100_000])
def test_a_manifest_of_deep_brackets_is_refused_in_milliseconds(text: str, tmp_path: Path) -> None:
    file = tmp_path / "action.yaml"
    file.write_text(text)
    began = time.process_time()
    with pytest.raises(InvalidInput, match="levels deep"):
        read_manifest(tmp_path)
    assert time.process_time() - began < 0.1
