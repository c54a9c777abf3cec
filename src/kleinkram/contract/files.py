"""Files, their recordings and topics, and the timeline of a mission."""

import datetime
import enum
import uuid
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from kleinkram.contract.base import ETag, NamedRef, Request, Response, etag_of
from kleinkram.contract.missions import MissionCriteria, MissionRef
from kleinkram.contract.names import FilePath, Label, Term, Terms, check_text
from kleinkram.contract.people import PersonRef


class Density(Response):
    """The number of messages in equal bins of log time.

    `counts[k]` covers `start_ns + k * bin_ns` (inclusive) to `start_ns + (k + 1) * bin_ns` (exclusive). `bin_ns` is a
    power of two, and `start_ns` a multiple of it. Implausible timestamps are in no bin.
    """

    start_ns: int
    bin_ns: int
    counts: list[int]


class BlobState(str, enum.Enum):
    """State of a file's bytes: received by the store, read and verified by the server, missing, or altered."""

    stored = "stored"
    verified = "verified"
    lost = "lost"
    corrupt = "corrupt"


class ContentState(str, enum.Enum):
    """What the server has read of a file's content (see the concepts page)."""

    pending = "pending"
    indexed = "indexed"
    recovered = "recovered"
    broken = "broken"
    opaque = "opaque"
    error = "error"


class ReadDepth(str, enum.Enum):
    """How content was read: by the file's own index, or every byte of it."""

    summary = "summary"
    scan = "scan"


class FileLoss(Response):
    """The unreadable part of a damaged recording. `messages` is null if the file does not tell the number."""

    bytes: int
    chunks: int
    messages: int | None


class FileFact(Response):
    """A further property of a file, such as the number of poses of a trajectory."""

    name: str
    value: str | int | float
    unit: str


class FileProblem(Response):
    """A quality warning about a recording."""

    code: str
    where: str
    message: str


def _etag(values: dict[str, Any]) -> str:
    return etag_of(values["path"], values["mission"].id, values["labels"])


class FileRead(Response):
    """A file of a mission: its path, its bytes, and their content. Checksums are lower-case hex.

    `sha256` is as reported by the uploader until `state` is `verified`; `md5` is null until then. `summarised_at` and
    `depth` are null until the server has read the content. `damaged_at` is when the file was found to be lost or
    corrupt, `state_reason` how. `origin` is upload, link (to stored bytes), or run: a file that a run made is derived,
    and in no sum of what was recorded. `etag` covers the path and the labels.
    """

    id: uuid.UUID
    mission: MissionRef
    path: str
    size_bytes: int
    state: BlobState
    state_reason: str | None
    content: ContentState
    content_reason: str | None
    format: str | None
    recording_id: uuid.UUID | None
    sha256: str | None
    md5: str | None
    crc64nvme: str | None
    verified_at: datetime.datetime | None
    summarised_at: datetime.datetime | None
    labels: list[str]
    origin: str
    uploaded_by: PersonRef
    created_at: datetime.datetime
    damaged_at: datetime.datetime | None = None
    message_count: int | None
    start_ns: int | None
    end_ns: int | None
    compression: list[str]
    problems: list[FileProblem]
    depth: ReadDepth | None
    lost: FileLoss | None
    facts: list[FileFact]
    etag: ETag = Field(default_factory=_etag)

    @property
    def is_derived(self) -> bool:
        """Whether a run made it from other files."""
        return self.origin == "run"


class FileUpdate(Request):
    """Changes of a file; omitted fields stay. `path` renames it, `mission_id` moves it; no bytes are copied."""

    path: FilePath | None = None
    mission_id: uuid.UUID | None = None
    labels: Annotated[list[Label], Field(max_length=50)] | None = None


class TopicRead(Response):
    """One topic of one recording file. Times are log times in ns since 1970; `rate_hz` is (count - 1) / span.

    `density` is null in lists of several files.
    """

    file_id: uuid.UUID
    name: str
    message_type: str | None
    schema_name: str | None
    schema_encoding: str | None
    message_encoding: str | None
    count: int | None
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    longest_gap_ns: int | None
    head_gap_ns: int | None
    tail_gap_ns: int | None
    out_of_order_count: int | None
    stored_bytes: int | None
    density: Density | None = None


class RecordingRead(Response):
    """A recording of one or more files. `missing` are files that its metadata lists and the mission does not have.

    `content` is of all files together: `recovered` if only a part can be read. `problems` are those of the recording;
    each file has its own. `is_derived`: runs made its files, so it is in no sum of what was recorded.
    """

    id: uuid.UUID
    mission: MissionRef
    name: str
    kind: str
    file_ids: list[uuid.UUID]
    paths: list[str]
    missing: list[str]
    unlisted: list[str]
    problems: list[FileProblem]
    content: ContentState
    content_reason: str | None
    lost: FileLoss | None
    start_ns: int | None
    end_ns: int | None
    message_count: int | None
    size_bytes: int
    is_derived: bool = False


class FileSort(str, enum.Enum):
    """Orders of a list of files. `path` orders by project, mission and path."""

    path = "path"
    path_desc = "-path"
    created = "created"
    created_desc = "-created"
    size = "size"
    size_desc = "-size"
    start = "start"
    start_desc = "-start"


SizeBytes = Annotated[int, Field(ge=0, le=2**63 - 1)]
DurationNs = Annotated[int, Field(ge=0, le=2**63 - 1)]
Month = Annotated[str, Field(pattern=r"^[12][0-9]{3}-(0[1-9]|1[0-2])$")]


class FileFilter(MissionCriteria):
    """A filter of files; all criteria must match, and of the values in one list, any. Names and paths may be globs.

    `project` and `mission` are a name or a glob, `projects` and `missions` names, globs or ids. `where` compares
    metadata of the mission, as in `MissionFilter`. Quotes in `text` group words. `format` is that of the content
    (`mcap`, `rosbag1`, `db3`, …), whatever the extension. `problem` are codes of quality warnings or globs.
    `recorded_*` are compared with the span of the file. `month` is the month (UTC) in which the recording began.
    `without` are terms of the query language (see the page on searching), of which none may match.
    """

    mission: Term | None = None
    mission_id: uuid.UUID | None = None
    recording_id: uuid.UUID | None = None
    path: Terms = []
    format: Terms = []
    label: Terms = []
    state: list[BlobState] = []
    content: list[ContentState] = []
    problem: Terms = []
    min_size_bytes: SizeBytes | None = None
    max_size_bytes: SizeBytes | None = None
    min_duration_ns: DurationNs | None = None
    max_duration_ns: DurationNs | None = None
    month: Annotated[list[Month], Field(max_length=50)] = []
    without: Terms = []


class FetchPurpose(str, enum.Enum):
    """What the URLs of files are for, according to the caller. Both give access to all bytes."""

    download = "download"
    preview = "preview"


class DownloadRequest(Request):
    """Files to download or preview; the audit log contains the purpose."""

    file_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=500)]
    purpose: FetchPurpose = FetchPurpose.download


class DownloadLink(Response):
    """A URL to GET the bytes of a file from before `expires_at`, with or without a Range header."""

    file_id: uuid.UUID
    path: str
    size_bytes: int
    sha256: str | None
    crc64nvme: str | None
    state: BlobState
    url: str
    expires_at: datetime.datetime


class DownloadLinks(Response):
    """URLs of files, in the requested order."""

    items: list[DownloadLink]


def _split_topics(texts: list[str]) -> list[str]:
    """Return the names and globs in texts that separate them by commas or spaces, each once."""
    names = [*dict.fromkeys(name for text in texts for name in text.replace(",", " ").split())]
    if texts and not names:
        raise ValueError("names no topic; without this parameter, all topics are selected")
    return names


LogTime = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=64)]
TopicPattern = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=4096)]


class SliceQuery(Request):
    """What of a recording is wanted: topics from `start` (inclusive) to `end` (exclusive); by default, all of it.

    `topics`: names or globs, repeated or separated by commas. Times are log times, as `klein cut` takes them:
    2026-05-01T10:00:00Z, 10:00 (UTC), +20s after the start, or nanoseconds since 1970.
    """

    topics: Annotated[list[TopicPattern], Field(max_length=1000), BeforeValidator(_split_topics)] = []
    start: LogTime | None = None
    end: LogTime | None = None


MAX_BINS = 512
MAX_MISSION_TOPICS = 2_000

# The maximum number of bins; a response has at least a quarter as many, if the data allow it.
Bins = Annotated[int, Field(ge=0, le=MAX_BINS)]
MissionTopicsSize = Annotated[int, Field(ge=1, le=MAX_MISSION_TOPICS)]


class TimeAxis(Response):
    """The bins that several densities share: `bins` of `bin_ns` each, the first from `start_ns` on."""

    start_ns: int
    bin_ns: int
    bins: int


class RecordingRef(NamedRef):
    """The id and name of a recording."""


class MissionTopic(Response):
    """One topic with one type, in all recordings of a mission.

    `other_types`: other types of the same topic in the mission, a conflict. `count` is null if a file has no count.
    `rate_hz` and `longest_gap_ns` cover only the time within recordings. `counts` are by the bins of `axis`; null if no
    file with the topic has a density, and less than `count` in sum if only some have. `recordings` are ranges
    `[first, last]` (inclusive) of indexes in the response's `recordings`.
    """

    name: str
    message_type: str | None
    other_types: list[str | None]
    count: int | None
    file_count: int
    recording_count: int
    recordings: list[tuple[int, int]]
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    longest_gap_ns: int | None
    stored_bytes: int | None
    counts: list[int] | None


class MissionTopics(Response):
    """A page of the topics of a mission, by name and type.

    `axis` spans the mission without recordings from before 1990; null if no times are known. `recordings` are in
    chronological order. `is_current`: it reflects the current files; otherwise it will soon.
    """

    axis: TimeAxis | None
    recordings: list[RecordingRef]
    items: list[MissionTopic]
    next: str | None = None
    is_current: bool


MAX_TIMELINE_FILES = 10_000

TimelineSize = Annotated[int, Field(ge=1, le=MAX_TIMELINE_FILES)]


class TimelineFile(Response):
    """When a file was recorded; `start_ns` and `end_ns` are null if it has no times, or was not read yet.

    `is_derived`: a run made it from other files.
    """

    id: uuid.UUID
    path: str
    recording_id: uuid.UUID | None
    start_ns: int | None
    end_ns: int | None
    size_bytes: int
    content: ContentState
    state: BlobState
    is_derived: bool = False


class MissionTimeline(Response):
    """Files of a mission, by path; `next` is the cursor of those that follow, or null.

    `start_ns` and `end_ns` span the mission (log clock, since 1970, UTC), without recordings from before 1990.
    """

    start_ns: int | None
    end_ns: int | None
    items: list[TimelineFile]
    next: str | None = None
