"""How a run says what it found: a line of JSON for each, which its runner reads while the run lasts."""

import fcntl
import os
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, JsonValue, ValidationError

from kleinkram.action import places
from kleinkram.contract.reports import (
    EVENTS_FILE,
    MAX_EVENT_BYTES,
    Finding,
    Metric,
    Preview,
    Progress,
    PutBack,
    ReportEvent,
)
from kleinkram.contract.wording import in_plain_words

T = TypeVar("T", bound=BaseModel)
AnyPath = str | os.PathLike[str]


class Reporting:
    """`report`. Safe to use from threads and from processes of one run."""

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
        """Say that something was noticed: `severity` is info, warning or error; `code` such as `imu.gap`.

        `file` is one of the inputs; `time_ns` a log time, in ns since 1970.
        """
        path = None if file is None else _within(file, places.given)
        found = _made(Finding, severity=severity, code=code, message=message, file=path, topic=topic, time_ns=time_ns)
        _say(ReportEvent(finding=found))

    def metric(self, name: str, value: float, *, unit: str | None = None, file: AnyPath | None = None) -> None:
        """Say a number, such as `metric("ate_rmse", 0.12, unit="m")`. Said again, it takes the earlier one's place.

        Raises:
            ReportRefused: the name is not of small letters, digits and `_ . -`, beginning with a letter, at most 64; or
                the number is NaN or infinite: say so by `finding`.
        """
        path = None if file is None else _within(file, places.given)
        _say(ReportEvent(metric=_made(Metric, name=name, value=value, unit=unit, file=path)))

    def preview(self, path: AnyPath, title: str = "") -> None:
        """Show an artifact with the run: PNG, JPEG, SVG, CSV or GeoJSON under `/out`."""
        _say(ReportEvent(preview=_made(Preview, path=_within(path, places.out), title=title)))

    def propose(self, **metadata: JsonValue) -> None:
        """Propose metadata of the mission. People take it over, or do not."""
        _say(_made(ReportEvent, metadata=metadata))

    def put_back(self, path: AnyPath, to: str | None = None, *, made_from: list[AnyPath] | None = None) -> None:
        """Make a file of the mission out of an artifact, at `to` (its path under `/out`, if not said).

        `made_from` are the inputs that it comes from; all of them, where none is named.
        """
        artifact = _within(path, places.out)
        sources = [_within(each, places.given) for each in made_from or []]
        _say(ReportEvent(put_back=_made(PutBack, path=artifact, to=to or artifact, made_from=sources)))


def progress(fraction: float, message: str = "") -> None:
    """Say how far the run is, from 0 to 1, and what it is at."""
    _say(ReportEvent(progress=_made(Progress, fraction=fraction, message=message)))


class ReportRefused(ValueError):
    """What a run wanted to report cannot be kept; says which part of it, and why."""


def _made(kind: type[T], **fields: object) -> T:
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        name = str(error.errors(include_url=False)[0]["loc"][0])
        reason = in_plain_words(error)
        if name in {"name", "code"}:
            reason = "use at most 64 small letters, digits and _ . -, beginning with a letter: 'rate.imu.data'"
        raise ReportRefused(f"the {name} {fields.get(name)!r} of a {kind.__name__.lower()}: {reason}") from None


def _within(path: AnyPath, folder: Path) -> str:
    """Return a path as relative to a folder, whether it is said so or as a whole."""
    return Path(os.path.normpath(folder / path)).relative_to(folder).as_posix()


def _say(event: ReportEvent) -> None:
    line = event.model_dump_json(exclude_unset=True, exclude_none=True).encode() + b"\n"
    if len(line) > MAX_EVENT_BYTES:
        raise ValueError(f"this has {len(line)} bytes; {MAX_EVENT_BYTES} can be said at once")
    path = places.out / EVENTS_FILE
    path.parent.mkdir(exist_ok=True)
    with path.open("ab", buffering=0) as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        stream.write(line)


report = Reporting()
