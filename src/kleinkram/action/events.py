"""Reports the results of a run as lines of JSON, which its runner reads during the run."""

import fcntl
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, JsonValue, ValidationError
from pydantic_core import ErrorDetails

from kleinkram.action import run_files
from kleinkram.contract import reports
from kleinkram.contract.checks import Check
from kleinkram.contract.problems import message_of

T = TypeVar("T", bound=BaseModel)
AnyPath = str | os.PathLike[str]


class Reporting:
    """The class of `report`. Threads and processes of one run can use it concurrently."""

    def check(
        self,
        name: str,
        status: str,
        message: str,
        *,
        value: float | None = None,
        limit: float | None = None,
        unit: str | None = None,
        topic: str | None = None,
        file: AnyPath | None = None,
        time_ns: int | None = None,
    ) -> None:
        """Report the outcome of a check: `status` is ok, warning, error or not_made; `name` such as `imu.gravity`.

        `value` was measured and `limit` is the bound that it is compared with, in `unit`. `file` is one of the inputs;
        `time_ns` a log time, in ns since 1970. Each call is one check.

        Raises:
            ReportRefused: the name is not of two to four parts of lower-case letters, digits and `_ -`, joined by dots;
                or a number is NaN or infinite: leave it out, and say so in the message.
        """
        path = None if file is None else _within(file, run_files.in_dir)
        place = {"topic": topic, "file": path, "time_ns": time_ns}
        numbers = {"value": value, "limit": limit, "unit": unit}
        _append(check=_validated(Check, name=name, status=status, message=message, **numbers, **place))

    def verdict(self, verdict: str) -> None:
        """Report what the run concludes: good, warnings or bad. The last call counts.

        Without it, and where they are worse, the checks and findings of the run decide.
        """
        _append(verdict=_validated(_Verdict, verdict=verdict).verdict)

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

    def metric(
        self,
        name: str,
        value: float,
        *,
        unit: str | None = None,
        file: AnyPath | None = None,
        topic: str | None = None,
        labels: Mapping[str, str] | None = None,
    ) -> None:
        """Report a number: `metric("rate", 199.6, unit="Hz", topic="/imu/data")`.

        `labels` distinguish numbers of one name: `metric("ate_rmse", 0.12, unit="m", labels={"alignment": "se3"})`. A
        later value of the same name, file, topic and labels replaces an earlier one.

        Raises:
            ReportRefused: the name is not of at most 64 lower-case letters, digits and `_ . -`, beginning with a
                letter; or the number is NaN or infinite, which a finding or a check can report.
        """
        path = None if file is None else _within(file, run_files.in_dir)
        place = {"file": path, "topic": topic, "labels": dict(labels or {})}
        _append(metric=_validated(reports.Metric, name=name, value=value, unit=unit, **place))

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


class _Verdict(BaseModel):
    verdict: reports.ReportedVerdict


class ReportRefused(ValueError):
    """A report is invalid; the message contains the field and the reason."""


def _validated(kind: type[T], **fields: object) -> T:
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise ReportRefused(_reason(kind, fields, error.errors(include_url=False)[0])) from None


def _reason(kind: type[BaseModel], fields: Mapping[str, object], problem: ErrorDetails) -> str:
    """Return a sentence that names the field, its value, and the check, metric or finding that it belongs to."""
    field = str(problem["loc"][0]) if problem["loc"] else ""
    what = kind.__name__.strip("_").lower()
    if problem["type"] == "finite_number":
        code = fields.get("name")
        return (
            f"the {field} of the {what} {code!r} is {problem['input']}, which is not a finite number: "
            "report it as a finding or a failed check, or leave it out"
        )
    if field in _NAME_RULES.get(kind, {}):
        return f"the {field} {fields.get(field)!r} of a {what}: {_NAME_RULES[kind][field]}"
    value = "" if field == what else f" of a {what}"
    return f"the {field} {fields.get(field)!r}{value}: {message_of(problem)}"


_CODE_RULE = "use at most 64 lower-case letters, digits and _ . -, beginning with a letter: 'rate.imu.data'"
_CHECK_RULE = "use two to four parts of lower-case letters, digits and _ -, joined by dots: 'imu.gravity'"
_NAME_RULES: dict[type[BaseModel], dict[str, str]] = {
    reports.Finding: {"code": _CODE_RULE},
    reports.Metric: {"name": _CODE_RULE},
    Check: {"name": _CHECK_RULE},
}


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
