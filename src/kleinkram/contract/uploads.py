"""The upload protocol: begin -> parts -> complete. See `docs/decisions/` on resuming and on the store's checksums."""

import datetime
import enum
import uuid
from typing import Annotated, Literal

import anycrc
from pydantic import Field, model_validator
from typing_extensions import Self

from kleinkram.contract.base import Request, Response
from kleinkram.contract.files import FileRead
from kleinkram.contract.names import FilePath
from kleinkram.contract.problems import ProblemDocument

# The minimum of S3. An incomplete part is sent again, so small parts waste less on a slow link.
MIN_PART_BYTES = 5 * 1024 * 1024
MAX_PARTS = 10_000
MAX_FILE_BYTES = 5 * 1024**4
MAX_FILES_PER_REQUEST = 200

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Crc64 = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
PartNumber = Annotated[int, Field(ge=1, le=MAX_PARTS)]


def part_size_bytes(file_size_bytes: int) -> int:
    """Return the part size of a file. It depends only on the file size, so that all clients use the same parts.

    5 MiB up to 40 GiB, then the smallest multiple of 5 MiB that needs no more than 8 192 parts (S3 allows 10 000).
    """
    steps = -(-file_size_bytes // (8192 * MIN_PART_BYTES))
    return MIN_PART_BYTES * max(1, steps)


class ChecksumKind(str, enum.Enum):
    """Method by which the store verifies received bytes, as probed when the server started.

    `crc64nvme`: every part by a signed CRC-64/NVME header, and the whole object by the full-object CRC-64/NVME.
    `sha256`: every part by a signed SHA-256 header. `md5`: every part by a signed Content-MD5, for old stores.
    """

    crc64nvme = "crc64nvme"
    sha256 = "sha256"
    md5 = "md5"


CHECKSUM_HEX_DIGITS = {ChecksumKind.crc64nvme: 16, ChecksumKind.sha256: 64, ChecksumKind.md5: 32}


class UploadState(str, enum.Enum):
    """`open` accepts parts, the server finishes one that is `completing`; the others are final."""

    open = "open"
    completing = "completing"
    done = "done"
    aborted = "aborted"
    expired = "expired"


class UploadFile(Request):
    """One file to upload. The hashes are lower-case hex, and may be left out if they are not known yet.

    Clients announce small files with both hashes: then one response decides about most of them, and contains the URL
    of a file's only part.
    `upload_id` resumes an earlier upload of the same path and size, or starts one with that id. Repeating a request
    with the same id therefore returns the upload that the first request created.
    """

    path: FilePath
    size_bytes: Annotated[int, Field(ge=0, le=MAX_FILE_BYTES)]
    sha256: Sha256 | None = None
    crc64nvme: Crc64 | None = None
    upload_id: uuid.UUID | None = None


class UploadBegin(Request):
    """Files to upload into one mission."""

    files: Annotated[list[UploadFile], Field(min_length=1, max_length=MAX_FILES_PER_REQUEST)]


class StoredPart(Response):
    """A part that the store has."""

    number: PartNumber
    size_bytes: int
    etag: str


class UploadRead(Response):
    """An upload. `parts` are those that the store has, in order."""

    id: uuid.UUID
    mission_id: uuid.UUID
    path: str
    size_bytes: int
    part_size_bytes: int
    checksum: ChecksumKind
    state: UploadState
    lease_ends_at: datetime.datetime
    expires_at: datetime.datetime
    parts: list[StoredPart] = []


class SignedPart(Response):
    """PUT the part's bytes to `url` with exactly these headers, before `expires_at`."""

    upload_id: uuid.UUID
    number: PartNumber
    url: str
    headers: dict[str, Annotated[str, Field(pattern=r"^[\x20-\x7e]*$")]]
    expires_at: datetime.datetime


class UploadRequired(Response):
    """Send the parts that `upload` does not list.

    `part`: the URL of the file's only part, signed for the announced checksum. Otherwise, request URLs of the parts.
    """

    decision: Literal["upload"] = "upload"
    upload: UploadRead
    part: SignedPart | None = None


class AlreadyPresent(Response):
    """The mission already has this file. Send nothing. `file` is null without the right to read."""

    decision: Literal["already_present"] = "already_present"
    file: FileRead | None


class Deduplicated(Response):
    """The server already has these bytes, and you may read them. The file now exists; send nothing."""

    decision: Literal["deduplicated"] = "deduplicated"
    file: FileRead


class HashRequired(Response):
    """The server has a file with this name or size. Announce the file again with its sha256."""

    decision: Literal["hash_required"] = "hash_required"
    path: str


class UploadRefused(Response):
    """This file cannot be uploaded; the others can."""

    decision: Literal["refused"] = "refused"
    path: str
    problem: ProblemDocument


UploadDecision = Annotated[
    AlreadyPresent | Deduplicated | HashRequired | UploadRequired | UploadRefused, Field(discriminator="decision")
]


class UploadDecisions(Response):
    """One decision per file, in the order of the request."""

    items: list[UploadDecision]


class PartToSign(Request):
    """A part to send, with its checksum in lower-case hex, of the kind that the upload specifies."""

    upload_id: uuid.UUID
    number: PartNumber
    checksum: Annotated[str, Field(pattern=r"^([0-9a-f]{16}|[0-9a-f]{32}|[0-9a-f]{64})$")]


class PartsSign(Request):
    """Parts to sign, of one or several uploads."""

    parts: Annotated[list[PartToSign], Field(min_length=1, max_length=MAX_FILES_PER_REQUEST)]

    @model_validator(mode="after")
    def _each_part_once(self) -> Self:
        if len({(part.upload_id, part.number) for part in self.parts}) < len(self.parts):
            raise ValueError("a part is listed twice")
        return self


class SignedParts(Response):
    """Signed parts, in the order of the request, which also renewed the leases of their uploads."""

    items: list[SignedPart]


class UploadFinish(Request):
    """An upload whose parts are all sent, and the hashes of the file."""

    upload_id: uuid.UUID
    sha256: Sha256
    crc64nvme: Crc64


class UploadsComplete(Request):
    """Uploads to finish."""

    uploads: Annotated[list[UploadFinish], Field(min_length=1, max_length=MAX_FILES_PER_REQUEST)]


class Completed(Response):
    """The upload is complete and the file exists. `file` is null without the right to read."""

    outcome: Literal["completed"] = "completed"
    upload_id: uuid.UUID
    file: FileRead | None


class NotCompleted(Response):
    """The upload could not be finished; the problem says why and what to do."""

    outcome: Literal["refused"] = "refused"
    upload_id: uuid.UUID
    problem: ProblemDocument


UploadOutcome = Annotated[Completed | NotCompleted, Field(discriminator="outcome")]


class UploadOutcomes(Response):
    """One outcome per upload, in the order of the request."""

    items: list[UploadOutcome]


_MODEL = anycrc.Model("CRC64-NVME")


def crc64nvme(data: bytes | memoryview, value: int = 0) -> int:
    """Return the CRC-64/NVME of `data`, continuing from `value`."""
    return int(_MODEL.calc(data, value))
