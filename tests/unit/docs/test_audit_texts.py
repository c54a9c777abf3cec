"""The web has a text for every event of the audit log."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
_SERVER = ROOT / "src" / "kleinkram" / "server"
# Columns and files have names of the same form.
_NO_VERBS = {"id", "person_id", "js", "css"}
_PURGED = {"project.purge", "mission.purge", "file.purge"}  # built from the kind of object in `trash/service.py`
_BY_DATABASE = {"audit.expire", "audit.redact"}  # written by functions of the migrations


# An operation begins with the kind of object that it concerns.
_OPERATION = re.compile(
    r'"((?:access|action|admin|auth|file|grant|group|identity|invitation|job|link|login|mission|password|person|project'
    r'|rate|report|run|runner|server|session|share|store|token|totp|upload)\.([a-z_]+))"'
)


def _operations() -> set[str]:
    sources = (path.read_text(encoding="utf-8") for path in _SERVER.rglob("*.py"))
    matches = (match for source in sources for match in _OPERATION.findall(source))
    return {operation for operation, verb in matches if verb not in _NO_VERBS} | _PURGED | _BY_DATABASE


def test_every_event_has_a_text_in_the_web() -> None:
    texts = (ROOT / "web" / "src" / "texts" / "audit.ts").read_text(encoding="utf-8")
    assert set(re.findall(r'^  "([a-z]+\.[a-z_]+)":', texts, re.MULTILINE)) == _operations()
