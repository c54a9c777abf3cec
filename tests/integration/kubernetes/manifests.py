"""The manifests that administrators apply for a runner."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

FILE = Path(__file__).parents[3] / "deploy" / "kubernetes" / "runner.yaml"


def manifests(kind: str) -> list[dict[str, Any]]:
    """Return those of a kind."""
    return [it for it in YAML(typ="safe").load_all(FILE) if it["kind"] == kind]


def rules() -> list[dict[str, Any]]:
    """Return the rules of the Role."""
    (role,) = manifests("Role")
    return list(role["rules"])
