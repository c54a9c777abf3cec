"""Compare the pinned requirements with published advisories: `python -m requirements.audit`, part of `make check`.

Fails for a known hole that `accepted.txt` does not list, and for an entry there that is past its day. It needs a
service of advisories (the package index's own, else OSV): where none answers, nothing was compared. Then it says so
and does not fail, since a hole that nobody could look up is no fault of the change at hand; a machine that is meant to
reach one sets KLEINKRAM_REQUIRE_AUDIT=1, and there it fails. Never installs or changes anything.
"""

import datetime
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel

_HERE = Path(__file__).parent
_PINS = tuple(_HERE / f"{name}.txt" for name in ("dev", "server", "runner", "sbom", "node", "workflows"))
_SERVICES = ("pypi", "osv")
_TIMEOUT_S = 10
_WHOLE_S = 150


class Advisory(BaseModel):
    """One published hole."""

    id: str
    aliases: list[str] = []
    fix_versions: list[str] = []


class Dependency(BaseModel):
    """What a service knows of one pinned package; with `skip_reason` it knows nothing."""

    name: str
    version: str = ""
    vulns: list[Advisory] = []
    skip_reason: str | None = None


class Report(BaseModel):
    """What pip-audit says as JSON."""

    dependencies: list[Dependency]


@dataclass(frozen=True)
class Accepted:
    """An advisory that we live with, until a day."""

    advisory: str
    package: str
    until: datetime.date


def read_accepted(text: str) -> list[Accepted]:
    """Return the entries of `accepted.txt`.

    Raises:
        ValueError: a line is not `ADVISORY PACKAGE YYYY-MM-DD why`.
    """
    entries = []
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        advisory, package, until, _why = line.split(maxsplit=3)
        entries.append(Accepted(advisory, package, datetime.date.fromisoformat(until)))
    return entries


def failures(report: Report, accepted: Sequence[Accepted], today: datetime.date) -> list[str]:
    """Return a sentence for each hole that is not accepted, and for each entry that is past its day."""
    found = [
        f"accepted.txt: {it.advisory} of {it.package} was accepted until {it.until}"
        for it in accepted
        if it.until < today
    ]
    known = {(it.package, it.advisory) for it in accepted if it.until >= today}
    for dependency in report.dependencies:
        for hole in dependency.vulns:
            if not {(dependency.name, name) for name in (hole.id, *hole.aliases)} & known:
                mended = ", ".join(hole.fix_versions) or "no version yet"
                found.append(f"{dependency.name} {dependency.version}: {hole.id} (mended in: {mended})")
    return found


def unaudited(report: Report) -> list[str]:
    """Return the packages of which the service knew nothing."""
    return [dependency.name for dependency in report.dependencies if dependency.skip_reason is not None]


def main() -> int:
    """Audit, say what was found or why nothing could be, and return the exit code."""
    today = datetime.datetime.now(datetime.timezone.utc).date()
    accepted = read_accepted((_HERE / "accepted.txt").read_text(encoding="utf-8"))
    service = next((name for name in _SERVICES if _answers(name)), None)
    report = _ask(service, _PINS) if service else None
    if report is None:
        return _not_audited("no service of advisories answers from here", accepted, today)
    wrong = failures(report, accepted, today)
    for sentence in wrong:
        _say(sentence)
    left_out = unaudited(report)
    if left_out:
        return max(_not_audited(f"{service} knows nothing of {', '.join(left_out)}", [], today), int(bool(wrong)))
    _say(f"{len(report.dependencies)} pinned packages compared with the advisories of {service}: {len(wrong)} problems")
    return int(bool(wrong))


def _not_audited(why: str, accepted: Sequence[Accepted], today: datetime.date) -> int:
    _say(f"NOT AUDITED: {why}; nothing is known about holes in them")
    late = failures(Report(dependencies=[]), accepted, today)
    for sentence in late:
        _say(sentence)
    return int(bool(late) or os.environ.get("KLEINKRAM_REQUIRE_AUDIT") == "1")


def _answers(service: str) -> bool:
    """Say whether a service knows one package of ours: a mirror of the index may serve files, and no advisories."""
    pin = (_HERE / "server.txt").read_text(encoding="utf-8").split("\n")
    first = next(number for number, line in enumerate(pin[1:], 1) if "==" in line)
    with tempfile.TemporaryDirectory() as folder:
        one = Path(folder) / "one.txt"
        one.write_text("\n".join(pin[:first]) + "\n", encoding="utf-8")
        report = _ask(service, [one])
    return report is not None and not unaudited(report)


def _ask(service: str, pins: Sequence[Path]) -> Report | None:
    """Return what a service knows of pinned packages; None where it does not answer."""
    files = [argument for path in pins for argument in ("--requirement", str(path))]
    command = [sys.executable, "-m", "pip_audit", *files, "--require-hashes", "--disable-pip", "--format", "json"]
    how = ["--vulnerability-service", service, "--timeout", str(_TIMEOUT_S), "--progress-spinner", "off"]
    try:
        asked = subprocess.run([*command, *how], capture_output=True, text=True, timeout=_WHOLE_S, check=False)
    except subprocess.TimeoutExpired:
        return None
    # Exit code 1 is both a hole and a crash; only the former comes with a report.
    return Report.model_validate(json.loads(asked.stdout)) if asked.stdout.startswith("{") else None


def _say(text: str) -> None:
    sys.stderr.write(f"audit: {text}\n")


if __name__ == "__main__":
    sys.exit(main())
