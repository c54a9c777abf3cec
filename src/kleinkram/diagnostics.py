"""Diagnostics of an instance, with severity and remedy: for `klein doctor`, the server's `check`, readiness.

Imports nothing of ours: a command on a laptop and a server process use the same tests of clocks and disks.
"""

import enum
import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

LOW_DISK_BYTES = 5 * 1024**3
LOW_DISK_SHARE = 0.02
# S3 rejects signatures that are 15 minutes off; synchronised clocks differ by far less than a minute.
MAX_SKEW_S = 60.0


class DiagnosticSeverity(str, enum.Enum):
    """Severity of a diagnostic: with warnings, Kleinkram runs."""

    ok = "ok"
    warning = "warning"
    problem = "problem"


@dataclass(frozen=True)
class Diagnostic:
    """What one test of an instance found. `remedy`: how to correct what is wrong."""

    check: str
    severity: DiagnosticSeverity
    message: str
    remedy: str = ""


def ok(check: str, message: str) -> Diagnostic:
    """Return the result of a check that found nothing wrong."""
    return Diagnostic(check, DiagnosticSeverity.ok, message)


def warning(check: str, message: str, remedy: str = "") -> Diagnostic:
    """Return a result that does not stop Kleinkram."""
    return Diagnostic(check, DiagnosticSeverity.warning, message, remedy)


def problem(check: str, message: str, remedy: str = "") -> Diagnostic:
    """Return a result that stops Kleinkram, or part of it."""
    return Diagnostic(check, DiagnosticSeverity.problem, message, remedy)


def judge(
    check: str, is_ok: bool, message: str, remedy: str, *, otherwise: DiagnosticSeverity = DiagnosticSeverity.problem
) -> Diagnostic:
    """Return ok, or the other severity with the remedy."""
    return ok(check, message) if is_ok else Diagnostic(check, otherwise, message, remedy)


def check_clock(check: str, skew_s: float) -> Diagnostic:
    """Check how far another machine's clock is ahead of, or behind, this machine's."""
    remedy = "Signatures contain the time: set the clocks of both machines by NTP."
    return judge(check, abs(skew_s) <= MAX_SKEW_S, f"The clocks differ by {abs(skew_s):.0f} s.", remedy)


def check_disk(
    check: str, folder: Path, remedy: str, *, otherwise: DiagnosticSeverity = DiagnosticSeverity.problem
) -> Diagnostic:
    """Check the free space on a folder's disk."""
    try:
        usage = shutil.disk_usage(folder)
    except OSError as error:
        return problem(check, f"{folder} cannot be used ({error.strerror}).", "Create it, or set another one.")
    message = f"{usage.free / 1e9:.1f} GB free of {usage.total / 1e9:.0f} GB in {folder}."
    return judge(check, not is_disk_low(usage.free, usage.total), message, remedy, otherwise=otherwise)


def is_disk_low(free_bytes: int, total_bytes: int) -> bool:
    """Whether a disk is almost full."""
    return free_bytes < max(LOW_DISK_BYTES, LOW_DISK_SHARE * total_bytes)


def find_problems(results: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Return the results that are problems."""
    return [result for result in results if result.severity is DiagnosticSeverity.problem]


def report(results: Sequence[Diagnostic], *, as_json: bool) -> str:
    """Return results as lines of text, or as one JSON document."""
    if as_json:
        return json.dumps(
            {"ok": not find_problems(results), "checks": [asdict(result) for result in results]}, indent=2
        )
    marks = {
        DiagnosticSeverity.ok: "ok     ",
        DiagnosticSeverity.warning: "WARNING",
        DiagnosticSeverity.problem: "PROBLEM",
    }
    lines = (f"{marks[result.severity]} {result.check}: {result.message} {result.remedy}" for result in results)
    return "\n".join(line.rstrip() for line in lines)
