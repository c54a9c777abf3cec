"""Collects what each reader reports about a recording, and compares it.

The readers are `klein inspect` (the summary), `klein inspect --deep` (the scan), `Recording` near and far, and the
server. They agree when

* members, types of topics, counts and spans are equal, and `Recording` near and far yield the same messages;
* every code of a problem that the summary names is named by all others. They may name more, never fewer;
* of messages whose topic the file does not define, the summary and the scan tell how many there are, and `Recording`
  yields none: it names `topic-undefined`;
* `Recording` says the span of all messages: of a damaged recording lost ones may be included, as its index says them,
  and so are suspect stamps, which the others leave out;
* only damage that no index shows makes the scan count less than the summary. Then the scan's content is `recovered`,
  and `Recording` yields what the scan counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from kleinkram.recordings import Content, Depth, FileSource, NotARecording, Recording
from kleinkram.recordings.inspect import Inspection, inspect_paths

Plain = tuple[str, int, int, int, bytes]


class ParallelSource(FileSource):
    """A local file that is read as one over a network is: several ranges at once."""

    parallel_reads = 4


@dataclass(frozen=True)
class Account:
    """What one reader says of a recording.

    Attributes:
        members: names of the data files, in the order of recording.
        content: of the recording; None where the reader does not say.
        span: earliest and latest log time that is not suspect.
        topics: message type and count by name.
        problems: the codes.
        undefined: topics that the file does not define.
    """

    members: tuple[str, ...]
    content: Content | None
    count: int | None
    span: tuple[int | None, int | None]
    topics: Mapping[str, tuple[str, int | None]]
    problems: frozenset[str]
    undefined: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Reading:
    """What `Recording` says, and the messages that it yields.

    Attributes:
        claimed_count: `message_count` as the files say.
        messages: topic, log time, publish time, sequence and digest of the data.
    """

    account: Account
    claimed_count: int | None
    messages: tuple[Plain, ...]


@dataclass(frozen=True)
class Accounts:
    """What all readers say of one recording."""

    name: str
    summary: Account
    scan: Account
    near: Reading | None
    far: Reading | None
    server: Account | None = None


def accounts_of(folder: Path) -> list[Accounts]:
    """Ask all readers that need no server about all recordings below a folder."""
    summaries, scans = inspect_paths([folder]), inspect_paths([folder], depth=Depth.scan)
    assert [item.path for item in summaries] == [item.path for item in scans]
    return [
        Accounts(
            Path(by_summary.path).relative_to(folder).as_posix(),
            account_of(by_summary),
            account_of(by_scan),
            read(by_summary, FileSource),
            read(by_summary, ParallelSource),
        )
        for by_summary, by_scan in zip(summaries, scans, strict=True)
    ]


def account_of(inspection: Inspection) -> Account:
    """Return what `klein inspect` says."""
    summary = inspection.summary
    return Account(
        tuple(Path(member).name for member in inspection.members),
        summary.content,
        summary.message_count,
        (summary.start_ns, summary.end_ns),
        {topic.name: (topic.message_type, topic.count) for topic in summary.topics},
        frozenset(problem.code for problem in summary.problems),
        frozenset(problem.where for problem in summary.problems if problem.code == "topic-undefined"),
    )


def read(inspection: Inspection, open_file: type[FileSource]) -> Reading | None:
    """Read all messages of a recording; None where `Recording` says that it holds none that it reads.

    Near, a path is opened as a person would; far, and where a set of files has no path of its own, its files.
    """
    path = Path(inspection.path)
    is_path_of_all = path.is_dir() or len(inspection.members) == 1
    with ExitStack() as stack:
        what: Path | list[FileSource] = path
        if open_file is not FileSource or not is_path_of_all:
            logs = [Path(f"{member}-wal") for member in inspection.members]
            files = [path / "metadata.yaml", *map(Path, inspection.members), *logs]
            what = [stack.enter_context(open_file(file)) for file in files if file.is_file()]
        try:
            recording = stack.enter_context(Recording.open(what))
        except NotARecording:
            return None
        return reading_of(recording)


def reading_of(recording: Recording) -> Reading:
    """Read all messages of a recording that is open."""
    messages = tuple(
        (message.topic, message.log_time_ns, message.publish_time_ns, message.sequence, sha256(message.data).digest())
        for message in recording.raw_messages()
    )
    counts = Counter(message[0] for message in messages)
    account = Account(
        recording.files,
        None,
        len(messages),
        (recording.start_ns, recording.end_ns),
        {topic.name: (topic.message_type, counts[topic.name]) for topic in recording.topics},
        frozenset(problem.code for problem in recording.problems),
    )
    return Reading(account, recording.message_count, messages)


def disagreements(accounts: Accounts) -> list[str]:
    """Return in words where the readers of one recording disagree."""
    summary, scan = accounts.summary, accounts.scan
    is_damaged_inside = summary.content is Content.indexed and scan.content is Content.recovered
    actual = [] if is_damaged_inside else _differences("the scan", scan, "the summary", summary)
    actual += _fewer_problems("the scan", scan, "the summary", summary)
    if accounts.server is not None:
        actual += _differences("the server", accounts.server, "the scan", scan)
        actual += _fewer_problems("the server", accounts.server, "the scan", scan)
    for name, reading in (("near", accounts.near), ("far", accounts.far)):
        reader_name = f"Recording ({name})"
        if reading is None:
            if scan.content not in (Content.opaque, Content.broken):
                actual.append(f"{reader_name} refuses what the scan calls {scan.content}")
            continue
        account = reading.account
        may_differ = scan.content is not Content.indexed or "suspect-stamps" in scan.problems
        if may_differ and _contains(account.span, scan.span):
            account = replace(account, span=scan.span)
        actual += _differences(reader_name, account, "the scan", _without_undefined_topics(scan))
        actual += _fewer_problems(reader_name, account, "the summary", summary)
        if reading.claimed_count not in (None, summary.count) and summary.content is Content.indexed:
            actual.append(f"{reader_name} claims {reading.claimed_count} messages, the summary {summary.count}")
    if accounts.near is not None and accounts.far is not None and accounts.near.messages != accounts.far.messages:
        actual.append("Recording yields other messages far than near")
    return actual


def _contains(outer: tuple[int | None, int | None], inner: tuple[int | None, int | None]) -> bool:
    if outer[0] is None or outer[1] is None or inner[0] is None or inner[1] is None:
        return True
    return outer[0] <= inner[0] and inner[1] <= outer[1]


def _without_undefined_topics(account: Account) -> Account:
    topics = {name: topic for name, topic in account.topics.items() if name not in account.undefined}
    left_out = sum(account.topics[name][1] or 0 for name in account.undefined)
    return replace(account, topics=topics, count=None if account.count is None else account.count - left_out)


def _differences(reader_name: str, one: Account, other_name: str, other: Account) -> list[str]:
    """Compare all but problems. A time that a file does not tell without being read whole is not compared."""
    actual = []
    if one.members != other.members:
        actual.append(f"{reader_name} names the members {one.members}, {other_name} {other.members}")
    if None not in (one.content, other.content) and one.content is not other.content:
        actual.append(f"{reader_name} calls it {one.content}, {other_name} {other.content}")
    if one.count != other.count:
        actual.append(f"{reader_name} counts {one.count} messages, {other_name} {other.count}")
    if one.span != other.span and one.span != (None, None):
        actual.append(f"{reader_name} says the span {one.span}, {other_name} {other.span}")
    return actual + [
        f"{reader_name} says of {name} {one.topics.get(name)}, {other_name} {other.topics.get(name)}"
        for name in sorted(one.topics.keys() | other.topics.keys())
        if one.topics.get(name) != other.topics.get(name)
    ]


def _fewer_problems(reader_name: str, one: Account, other_name: str, other: Account) -> list[str]:
    missing: Iterable[str] = sorted(other.problems - one.problems)
    return [f"{reader_name} does not name {code}, as {other_name} does" for code in missing]
