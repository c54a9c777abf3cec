"""Reading manifests of actions, also untrusted ones."""

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


def test_a_script_names_its_packages_and_python(tmp_path: Path) -> None:
    file = tmp_path / "look.py"
    file.write_text('# /// script\n# requires-python = ">=3.11"\n# dependencies = ["evo==1.38.1"]\n# ///\nprint(1)\n')
    definition = read_manifest(file)
    assert (definition.dependencies, definition.requires_python) == (["evo==1.38.1"], ">=3.11")
    file.write_text('# /// script\n# requires-python = "3.11"\n# ///\n')
    with pytest.raises(InvalidInput, match="is not a condition on the version of Python"):
        read_manifest(file)
