"""How the end of a transfer looks."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict

from kleinkram.cli.errors import EXIT_CODES
from kleinkram.cli.render import escape, note
from kleinkram.cli.units import size
from kleinkram.client.errors import ClientError, request_id_of
from kleinkram.client.transfer import TransferReport
from kleinkram.contract.errors import KleinkramError


def say_left_out(left_out: Iterable[ClientError]) -> None:
    """Name on stderr what will not be transferred."""
    for error in left_out:
        note(escape(str(error)))


def plain_report(report: TransferReport) -> dict[str, object]:
    """Return the stable JSON shape of a transfer's end."""
    items = [
        {
            "path": result.path,
            "local": str(result.local),
            "size_bytes": result.size_bytes,
            "outcome": result.outcome.value,
            "moved_bytes": result.moved_bytes,
            "file_id": str(result.file_id) if result.file_id else None,
            "sha256": result.sha256,
            "error": plain_error(result.error),
        }
        for result in report.results
    ]
    left_out = [plain_error(error) for error in report.left_out]
    return {"items": items, "left_out": left_out, "link": asdict(report.link)}


def say_summary(report: TransferReport, elapsed_s: float) -> None:
    """Say on stderr what was moved, how fast, and what became of the files."""
    moved = sum(result.moved_bytes for result in report.results)
    counts = Counter(result.outcome.value for result in report.results)
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())) or "nothing"
    speed = f", {size(int(moved / elapsed_s))}/s" if moved and elapsed_s > 0 else ""
    note(f"{outcomes}; {size(moved)} in {elapsed_s:.1f} s{speed}")
    if (advice := report.link.advice()) is not None:
        note(advice)
    for request_id in sorted({found for error in report.failures if (found := request_id_of(error))}):
        note(f"Request id: {escape(request_id)}")


def plain_error(error: KleinkramError | None) -> dict[str, object] | None:
    """Return the stable JSON shape of a failure."""
    if error is None:
        return None
    return {"kind": type(error).__name__, "message": str(error), "exit_code": int(EXIT_CODES[type(error)])}
