"""Reports the results of a run as lines of JSON, which its runner reads during the run."""

import fcntl
import os
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, JsonValue, ValidationError

from kleinkram.action import run_files
from kleinkram.contract import reports
from kleinkram.contract.problems import first_message

T = TypeVar("T", bound=BaseModel)
AnyPath = str | os.PathLike[str]


class Reporting:
    """The class of `report`. Threads and processes of one run can use it concurrently."""

    def finding(
        self,
        severity: str,
        code: str,
        message: str,
        *,
        file: AnyPath | None = None,
        topic: str | None = None,
        time_ns: int | None = None,
    ) -> None:
        """Report a finding: `severity` is info, warning or error; `code` such as `imu.gap`.

        `file` is one of the inputs; `time_ns` a log time, in ns since 1970.
        """
        path = None if file is None else _within(file, run_files.in_dir)
        finding = _validated(
            reports.Finding, severity=severity, code=code, message=message, file=path, topic=topic, time_ns=time_ns
        )
        _append(finding=finding)

    def metric(self, name: str, value: float, *, unit: str | None = None, file: AnyPath | None = None) -> None:
        """Report a number, such as `metric("ate_rmse", 0.12, unit="m")`. A later value replaces an earlier one.

        Raises:
            ReportRefused: the name is not of at most 64 lower-case letters, digits and `_ . -`, beginning with a
                letter; or the number is NaN or infinite, which a finding can report.
        """
        path = None if file is None else _within(file, run_files.in_dir)
        _append(metric=_validated(reports.Metric, name=name, value=value, unit=unit, file=path))

    def preview(self, path: AnyPath, title: str = "") -> None:
        """Show an artifact with the run: PNG, JPEG, SVG, CSV or GeoJSON under `/out`."""
        _append(preview=_validated(reports.Preview, path=_within(path, run_files.out), title=title))

    def propose(self, **metadata: JsonValue) -> None:
        """Propose metadata of the mission, which people accept or ignore."""
        _append(metadata=metadata)

    def mission_file(self, path: AnyPath, to: str | None = None, *, derived_from: list[AnyPath] | None = None) -> None:
        """Create a file of the mission from an artifact, at `to` (default: its path under `/out`).

        `derived_from` are the inputs that it was made from; by default all.
        """
        artifact = _within(path, run_files.out)
        sources = [_within(source, run_files.in_dir) for source in derived_from or []]
        _append(mission_file=_validated(reports.MissionFile, path=artifact, to=to or artifact, derived_from=sources))


def progress(fraction: float, message: str = "") -> None:
    """Report the progress of the run, from 0 to 1, with a message."""
    _append(progress=_validated(reports.Progress, fraction=fraction, message=message))


class ReportRefused(ValueError):
    """A report is invalid; the message contains the field and the reason."""


def _validated(kind: type[T], **fields: object) -> T:
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        name = str(error.errors(include_url=False)[0]["loc"][0])
        reason = first_message(error)
        if name in {"name", "code"}:
            reason = "use at most 64 lower-case letters, digits and _ . -, beginning with a letter: 'rate.imu.data'"
        raise ReportRefused(f"the {name} {fields.get(name)!r} of a {kind.__name__.lower()}: {reason}") from None


def _within(path: AnyPath, folder: Path) -> str:
    return Path(os.path.normpath(folder / path)).relative_to(folder).as_posix()


def _append(**part: object) -> None:
    event = _validated(reports.ReportEvent, **part)
    line = event.model_dump_json(exclude_unset=True, exclude_none=True).encode() + b"\n"
    if len(line) > reports.MAX_EVENT_BYTES:
        raise ValueError(f"the report has {len(line)} bytes; at most {reports.MAX_EVENT_BYTES} are allowed")
    path = run_files.out / reports.EVENTS_FILE
    path.parent.mkdir(exist_ok=True)
    with path.open("ab", buffering=0) as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        stream.write(line)


report = Reporting()
