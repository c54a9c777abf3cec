"""Files, the recordings they make up, and the topics inside."""

import datetime
import enum
import uuid
from typing import Annotated, Any

from pydantic import Field

from kleinkram.contract.base import ETag, Request, Response, etag_of
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.names import FilePath, Label, Term, Terms
from kleinkram.contract.people import PersonRef


class Density(Response):
    """Distribution of messages over time.

    `counts[k]` are the messages from `start_ns + k * bin_ns` on, that time included, up to the next bin. `bin_ns` is a
    power of two, and `start_ns` a multiple of it. Stamps that cannot be true are in no bin.
    """

    start_ns: int
    bin_ns: int
    counts: list[int]


class BlobState(str, enum.Enum):
    """State of a file's bytes: checksums confirmed by the store; read by the server; missing; or altered."""

    stored = "stored"
    verified = "verified"
    lost = "lost"
    corrupt = "corrupt"


class ContentState(str, enum.Enum):
    """What is known of the meaning of the bytes (see the concepts page)."""

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
    """What of a damaged recording cannot be read. `messages` is null where nothing in the file tells."""

    bytes: int
    chunks: int
    messages: int | None


class FileFact(Response):
    """One thing more that a file says of itself, such as the number of poses of a trajectory."""

    name: str
    value: str | int | float
    unit: str


class FileProblem(Response):
    """Something odd inside a recording, in plain words."""

    code: str
    where: str
    message: str


def _etag(values: dict[str, Any]) -> str:
    return etag_of(values["path"], values["mission"].id, values["labels"])


class FileRead(Response):
    """A file of a mission: its place, its bytes, and what they hold. Checksums are lower-case hex.

    `sha256` is the uploader's word until `state` is `verified`; `md5` is null until then. `summarised_at` is null until
    the server has looked at the content, whatever came of it. `depth` says how far it read; null until then.
    `damaged_at` is since when it is known to be lost or corrupt; `state_reason` says how that showed. `etag` names
    the path and labels that people gave it last, as with missions.
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


class FileUpdate(Request):
    """What to change of a file; what is left out stays. A path renames, a mission moves; no object is touched."""

    path: FilePath | None = None
    mission_id: uuid.UUID | None = None
    labels: Annotated[list[Label], Field(max_length=50)] | None = None


class TopicRead(Response):
    """One topic of one recording file. Times: integer nanoseconds of the log clock; `rate_hz` = (count - 1) / span.

    `density` is told in lists of one file, where it is known, and nowhere else.
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
    """One logical capture of 1..n files. `missing` are members that its metadata names and the mission lacks.

    `content` is that of all members together: `recovered` where something can be read and something is damaged or
    missing. `problems` are those of the whole; what is odd inside one file is among the problems of that file.
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


class FileFilter(Request):
    """Which files: all that are given must hold; within one list any may. Names and paths may be globs (`*`, `?`).

    `where` compares metadata of the mission, as in `MissionFilter`. `format` is what the content is
    (`mcap`, `rosbag1`, `db3`, …), whatever the extension. `problem` are codes of problems inside the file, or globs:
    `*` finds files with any problem. Sizes in bytes; `recorded_*` against the file's span.
    Quotes in `text` make several words one. `projects` and `missions` are names, globs or ids of several, of which any
    may hold; `project` and `mission` are one name or glob. `month` is the one in which the recording began,
    UTC. `without` are terms of the query language (see the page on searching) of which none may hold.
    """

    text: Term | None = None
    project: Term | None = None
    project_id: uuid.UUID | None = None
    projects: Terms = []
    mission: Term | None = None
    mission_id: uuid.UUID | None = None
    missions: Terms = []
    recording_id: uuid.UUID | None = None
    path: Terms = []
    where: Terms = []
    topic: Terms = []
    message_type: Terms = []
    format: Terms = []
    label: Terms = []
    state: list[BlobState] = []
    content: list[ContentState] = []
    problem: Terms = []
    recorded_after: datetime.datetime | None = None
    recorded_before: datetime.datetime | None = None
    min_size_bytes: SizeBytes | None = None
    max_size_bytes: SizeBytes | None = None
    min_duration_ns: DurationNs | None = None
    max_duration_ns: DurationNs | None = None
    month: Annotated[list[Month], Field(max_length=50)] = []
    without: Terms = []


class FetchPurpose(str, enum.Enum):
    """What addresses of files are asked for, by the word of whoever asks: either gives all bytes, for as long."""

    download = "download"
    preview = "preview"


class DownloadRequest(Request):
    """Files to fetch, or only to look into; the record says which."""

    file_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=500)]
    purpose: FetchPurpose = FetchPurpose.download


class DownloadLink(Response):
    """Where to read one file's bytes: GET with or without a Range header, until `expires_at`."""

    file_id: uuid.UUID
    path: str
    size_bytes: int
    sha256: str | None
    crc64nvme: str | None
    state: BlobState
    url: str
    expires_at: datetime.datetime


class DownloadLinks(Response):
    """Links, one a file, in the order asked."""

    items: list[DownloadLink]
