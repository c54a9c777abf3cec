"""`klein convert`: local recordings as MCAPs or ROS 1 bags, without a server."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import argument, flag, option
from kleinkram.cli.cut import Watch, watch_shares
from kleinkram.cli.errors import ExitCode, recording_code
from kleinkram.cli.render import Output, note, table
from kleinkram.cli.units import size
from kleinkram.client.errors import DestinationRefused, InvalidInput
from kleinkram.recordings.errors import RecordingError
from kleinkram.recordings.open_paths import LocalRecordingPath, find_recordings
from kleinkram.recordings.writing.bag import BagCompression, BagOptions
from kleinkram.recordings.writing.conversion import (
    ConversionOptions,
    ConversionPlan,
    ConversionResult,
    convert_recording,
    is_as_wanted,
    plan_conversion,
    target_names,
)
from kleinkram.recordings.writing.mcap import ChunkCompression, McapOptions, Ros1Messages
from kleinkram.recordings.writing.message_copy import sentences

_EXTENSIONS = {McapOptions: ".mcap", BagOptions: ".bag"}


def convert(
    sources: Annotated[list[str], argument("SOURCE", "Files and folders of recordings.")],
    to: Annotated[str, option("--to", "FORMAT", "Write mcap or bag.")] = "mcap",
    keep_ros1: Annotated[
        bool, flag("--keep-ros1", "Keep ROS 1 messages in an MCAP as they are, instead of re-encoding them for ROS 2.")
    ] = False,
    compression: Annotated[
        str | None,
        option("--compression", "NAME", "Compress chunks: zstd, lz4 or none in an MCAP, lz4, bz2 or none in a bag."),
    ] = None,
    level: Annotated[
        int | None, option("--level", "N", "Set the level: 1 to 22 for zstd, 0 to 16 for lz4 in an MCAP.")
    ] = None,
    output: Annotated[
        Path, option("--output -o", "PATH", "The folder to write to, or, for one recording, the file.")
    ] = Path(),
    dry_run: options.DryRun = False,
) -> Output:
    """Convert, recompress or repair recordings: each becomes one whole MCAP, or one ROS 1 bag.

    ROS 1 messages in an MCAP become ROS 2 messages (CDR), unless --keep-ros1; ROS 2 messages in a bag become ROS 1
    messages. Of a damaged recording, what can be read is written. A recording that is already as wanted is left out.
    No file is replaced.

    The exit code is 0 also if messages were lost or left out, which is printed; it is 8 if a recording could not be
    read or converted, 11 if a file could not be written, and 10 for both.
    """
    how = _options(to, compression, level, keep_ros1)
    jobs = _jobs(sources, output, how)
    if dry_run:
        return _planned([_plan(job, how) for job in jobs])
    for job in jobs:
        if job.path.exists() or job.path.is_symlink():
            reason = "there is such a file or folder, and it is not replaced: choose another folder with -o"
            raise DestinationRefused(path=str(job.path), reason=reason)
    with watch_shares("The files that were written are complete.") as watch:
        return _converted([_convert(job, how, watch) for job in jobs])


@dataclass(frozen=True)
class _Job:
    """A recording, and the file that it becomes."""

    recording: LocalRecordingPath
    path: Path


@dataclass(frozen=True)
class _Outcome:
    """What became of a recording. `result`: None if it was already as wanted, or failed for the reason `error`."""

    job: _Job
    bytes_in: int = 0
    plan: ConversionPlan | None = None
    result: ConversionResult | None = None
    error: str | None = None
    exit_code: int = 0


def _options(to: str, compression: str | None, level: int | None, keep_ros1: bool) -> ConversionOptions:
    """Return how outputs are written; InvalidInput for what their format does not have."""
    try:
        if to == "bag":
            if level is not None or keep_ros1:
                raise ValueError(f"{'--level' if level is not None else '--keep-ros1'} is for MCAPs, not for bags")
            return BagOptions(BagCompression(compression or "lz4"))
        if to != "mcap":
            raise ValueError(f"--to is mcap or bag, not {to!r}")
        ros1 = Ros1Messages.keep if keep_ros1 else Ros1Messages.reencode
        return McapOptions(ChunkCompression(compression or "zstd"), level, ros1=ros1)
    except ValueError as error:
        reason = str(error)
        if "is not a valid" in reason:
            names = [one.value for one in BagCompression] if to == "bag" else [one.value for one in ChunkCompression]
            reason = f"--compression is {', '.join(names)}, not {compression!r}"
        raise InvalidInput(what="The command", reason=reason) from None


def _jobs(sources: Sequence[str], output: Path, how: ConversionOptions) -> list[_Job]:
    """Return what each recording becomes: a file in the folder `output`, or the file of this name."""
    recordings = find_recordings(sources)
    extension = _EXTENSIONS[type(how)]
    if output.suffix in _EXTENSIONS.values() and not output.is_dir():
        if len(recordings) > 1 or output.suffix != extension:
            what = f"a folder, or, for one recording, a file with the extension {extension}"
            raise InvalidInput(what="--output", reason=f"it is {what}, not {output}")
        return [_Job(recordings[0], output)]
    names = [str(PurePosixPath(*_inside(item.name))) for item in recordings]
    return [
        _Job(item, output / f"{target}{extension}")
        for item, target in zip(recordings, target_names(names), strict=True)
    ]


def _inside(name: str) -> Iterator[str]:
    """Yield the parts of a path that stay below the folder to write to."""
    return (part for part in PurePosixPath(name).parts if part not in ("/", ".."))


def _plan(job: _Job, how: ConversionOptions) -> _Outcome:
    try:
        with job.recording.open() as recording:
            plan = plan_conversion(recording, how)
            return _Outcome(job, plan.size_bytes, plan)
    except RecordingError as error:
        return _Outcome(job, error=str(error), exit_code=recording_code(error))


def _convert(job: _Job, how: ConversionOptions, watch: Watch) -> _Outcome:
    try:
        with job.recording.open() as recording:
            if is_as_wanted(recording, how):
                return _Outcome(job, recording.size_bytes)
            job.path.parent.mkdir(parents=True, exist_ok=True)
            result = convert_recording(recording, job.path, how, on_progress=watch(job.recording.name))
            return _Outcome(job, recording.size_bytes, result=result)
    except OSError as error:
        return _Outcome(job, error=f"{job.path.parent}: {error.strerror or error}", exit_code=ExitCode.destination)
    except RecordingError as error:
        return _Outcome(job, error=str(error), exit_code=recording_code(error))


def _planned(outcomes: Sequence[_Outcome]) -> Output:
    items = [
        {
            "recording": one.job.recording.name,
            "path": str(one.job.path) if one.plan and one.plan.reasons else None,
            "exists": one.job.path.exists(),
            "reasons": [*one.plan.reasons] if one.plan else [],
            "size_bytes": one.bytes_in,
            "estimated_bytes": one.plan.estimated_bytes if one.plan else None,
            "error": one.error,
        }
        for one in outcomes
    ]
    return Output({"dry_run": True, "items": items}, lambda: _show_plan(outcomes), _exit_code(outcomes))


def _show_plan(outcomes: Sequence[_Outcome]) -> None:
    rows: list[tuple[object, ...]] = []
    for one in outcomes:
        plan = one.plan
        if plan is None:
            rows.append((one.job.recording.name, None, None, None, f"cannot be read: {one.error}"))
        elif not plan.reasons:
            rows.append(
                (one.job.recording.name, None, size(one.bytes_in), None, "nothing to do, unless a checksum is wrong")
            )
        else:
            why = "; ".join((*(["the file exists"] if one.job.path.exists() else []), *plan.reasons))
            sizes = size(one.bytes_in), f"about {size(plan.estimated_bytes)}"
            rows.append((one.job.recording.name, str(one.job.path), *sizes, why))
    table(["recording", "becomes", "from", "to", "why"], rows)


def _converted(outcomes: Sequence[_Outcome]) -> Output:
    items = [_item(one) for one in outcomes]

    def show() -> None:
        results = [(one, one.result) for one in outcomes if one.result is not None]
        rows = [
            (one.job.recording.name, str(made.path), made.message_count, size(one.bytes_in), size(made.size_bytes))
            for one, made in results
        ]
        if rows:
            table(["recording", "file", "messages", "from", "to"], rows)

    for one in outcomes:
        _note_outcome(one)
    return Output({"items": items}, show, _exit_code(outcomes))


def _item(one: _Outcome) -> dict[str, object]:
    result = one.result
    return {
        "recording": one.job.recording.name,
        "status": "failed" if one.error else "unchanged" if result is None else "converted",
        "path": None if result is None else str(result.path),
        "size_bytes": one.bytes_in,
        "output_bytes": None if result is None else result.size_bytes,
        "message_count": None if result is None else result.message_count,
        "losses": [] if result is None else [asdict(loss) for loss in result.losses],
        "left_out": [] if result is None else [asdict(part) for part in result.left_out],
        "error": one.error,
    }


def _note_outcome(one: _Outcome) -> None:
    """Print what of a recording was not converted."""
    name = one.job.recording.name
    if one.error:
        note(f"Not converted: {one.error}")
    elif one.result is None:
        note(f"{name}: nothing to do, it is already as wanted.")
    else:
        for loss in one.result.losses:
            note(f"Lost: {loss.file}: {loss.reason}")
        for sentence in sentences(one.result.left_out):
            note(f"{name}: {sentence}")


def _exit_code(outcomes: Sequence[_Outcome]) -> int:
    """Return the exit code that all failures have, otherwise `several`; 0 for no failures."""
    codes = {one.exit_code for one in outcomes if one.error}
    return ExitCode.several if len(codes) > 1 else next(iter(codes), 0)
