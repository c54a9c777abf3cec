"""Reading an untrusted `action.yaml`."""

from pathlib import Path

import pytest

from kleinkram.client.actions import read_manifest
from kleinkram.client.errors import InvalidInput


@pytest.mark.parametrize("text", ["[" * 1000, "name: x\nparameters: " + "[" * 100_000, "- " * 100_000])
def test_a_manifest_of_deep_brackets_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "action.yaml"
    file.write_text(text)
    with pytest.raises(InvalidInput, match="levels deep"):
        read_manifest(tmp_path)
