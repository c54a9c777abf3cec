"""How a run says what it found: a line of JSON for each, which its runner reads while the run lasts."""

import fcntl
import os
from pathlib import Path

from pydantic import JsonValue

from kleinkram.action import places
from kleinkram.contract.reports import EVENTS_FILE, MAX_EVENT_BYTES, Event, Finding, Metric, Preview, Progress, PutBack
from kleinkram.contract.reports import Severity as _Severity

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
        found = Finding(
            severity=_Severity(severity), code=code, message=message, file=path, topic=topic, time_ns=time_ns
        )
        _say(Event(finding=found))

    def metric(self, name: str, value: float, *, unit: str | None = None, file: AnyPath | None = None) -> None:
        """Say a number, such as `metric("ate_rmse", 0.12, unit="m")`. Said again, it takes the earlier one's place."""
        path = None if file is None else _within(file, places.given)
        _say(Event(metric=Metric(name=name, value=float(value), unit=unit, file=path)))

    def preview(self, path: AnyPath, title: str = "") -> None:
        """Show an artifact with the run: PNG, JPEG, SVG, CSV or GeoJSON under `/out`."""
        _say(Event(preview=Preview(path=_within(path, places.out), title=title)))

    def propose(self, **metadata: JsonValue) -> None:
        """Propose metadata of the mission. People take it over, or do not."""
        _say(Event(metadata=metadata))

    def put_back(self, path: AnyPath, to: str | None = None, *, made_from: list[AnyPath] | None = None) -> None:
        """Make a file of the mission out of an artifact, at `to` (its path under `/out`, if not said).

        `made_from` are the inputs that it comes from; all of them, where none is named.
        """
        artifact = _within(path, places.out)
        sources = [_within(each, places.given) for each in made_from or []]
        _say(Event(put_back=PutBack(path=artifact, to=to or artifact, made_from=sources)))


def progress(fraction: float, message: str = "") -> None:
    """Say how far the run is, from 0 to 1, and what it is at."""
    _say(Event(progress=Progress(fraction=fraction, message=message)))


def _within(path: AnyPath, folder: Path) -> str:
    """Return a path as relative to a folder, whether it is said so or as a whole."""
    return Path(os.path.normpath(folder / path)).relative_to(folder).as_posix()


def _say(event: Event) -> None:
    line = event.model_dump_json(exclude_unset=True, exclude_none=True).encode() + b"\n"
    if len(line) > MAX_EVENT_BYTES:
        raise ValueError(f"this has {len(line)} bytes; {MAX_EVENT_BYTES} can be said at once")
    path = places.out / EVENTS_FILE
    path.parent.mkdir(exist_ok=True)
    with path.open("ab", buffering=0) as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        stream.write(line)


report = Reporting()
