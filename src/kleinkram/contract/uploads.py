"""The upload protocol: begin -> parts -> complete. See `docs/decisions/` on resuming and on proof by the store."""

import datetime
import enum
import uuid
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.errors import ProblemDocument
from kleinkram.contract.files import FileRead
from kleinkram.contract.names import FilePath

# The least that S3 takes. A part that did not arrive whole is sent again, which is dear on a slow link.
MIN_PART_BYTES = 5 * 1024 * 1024
MAX_PARTS = 10_000
MAX_FILE_BYTES = 5 * 1024**4
MAX_FILES_PER_REQUEST = 200

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Crc64 = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
PartNumber = Annotated[int, Field(ge=1, le=MAX_PARTS)]


def part_size_bytes(file_size_bytes: int) -> int:
    """Return the part size of a file: a function of its size alone, so that every client cuts alike.

    5 MiB up to 40 GiB, then the smallest multiple of 5 MiB that needs no more than 8 192 parts (S3 allows 10 000).
    """
    steps = -(-file_size_bytes // (8192 * MIN_PART_BYTES))
    return MIN_PART_BYTES * max(1, steps)


class ChecksumKind(str, enum.Enum):
    """How the store proves what it received, as found by the server's probe when it started.

    `crc64nvme`: every part by a signed CRC-64/NVME header, and the whole object by the full-object CRC-64/NVME.
    `sha256`: every part by a signed SHA-256 header. `md5`: every part by a signed Content-MD5, for old stores.
    """

    crc64nvme = "crc64nvme"
    sha256 = "sha256"
    md5 = "md5"


CHECKSUM_HEX_DIGITS = {ChecksumKind.crc64nvme: 16, ChecksumKind.sha256: 64, ChecksumKind.md5: 32}


class UploadState(str, enum.Enum):
    """`open` takes parts, `completing` is being finished by the server, the others are ends."""

    open = "open"
    completing = "completing"
    done = "done"
    aborted = "aborted"
    expired = "expired"


class UploadFile(BaseModel):
    """One file that a client wants to upload. Hashes where they are known already, lower-case hex.

    Small files come with both hashes at once, so that most are decided in one answer, and where there is one part, its
    address is in it.
    `upload_id` resumes an earlier upload of the same path and size; where there is none, one begins by that id. So who
    says the same twice, since an answer did not come, gets what the first began.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: FilePath
    size_bytes: Annotated[int, Field(ge=0, le=MAX_FILE_BYTES)]
    sha256: Sha256 | None = None
    crc64nvme: Crc64 | None = None
    upload_id: uuid.UUID | None = None


class UploadBegin(BaseModel):
    """Files to upload into one mission."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    files: Annotated[list[UploadFile], Field(min_length=1, max_length=MAX_FILES_PER_REQUEST)]


class HeldPart(BaseModel):
    """A part that the store already holds."""

    model_config = ConfigDict(frozen=True)

    number: PartNumber
    size_bytes: int
    etag: str


class UploadRead(BaseModel):
    """An upload under way. `parts` are those the store holds, in order; empty for one that has just begun."""

    model_config = ConfigDict(frozen=True)

    id: uuid.UUID
    mission_id: uuid.UUID
    path: str
    size_bytes: int
    part_size_bytes: int
    checksum: ChecksumKind
    state: UploadState
    lease_ends_at: datetime.datetime
    expires_at: datetime.datetime
    parts: list[HeldPart] = []


class SignedPart(BaseModel):
    """PUT the part's bytes to `url` with exactly these headers, before `expires_at`."""

    model_config = ConfigDict(frozen=True)

    upload_id: uuid.UUID
    number: PartNumber
    url: str
    headers: dict[str, Annotated[str, Field(pattern=r"^[\x20-\x7e]*$")]]
    expires_at: datetime.datetime


class Send(BaseModel):
    """Send the parts that `upload` does not list.

    `part` is where the only part of a file goes, signed for the checksum that was announced; else ask for addresses.
    """

    model_config = ConfigDict(frozen=True)

    decision: Literal["send"] = "send"
    upload: UploadRead
    part: SignedPart | None = None


class Present(BaseModel):
    """The mission already has this very file under this name: nothing to send. `file` is null for who may not read."""

    model_config = ConfigDict(frozen=True)

    decision: Literal["present"] = "present"
    file: FileRead | None


class Linked(BaseModel):
    """The same bytes are kept already and you may read them: the file now exists, nothing to send."""

    model_config = ConfigDict(frozen=True)

    decision: Literal["linked"] = "linked"
    file: FileRead


class HashFirst(BaseModel):
    """Something of this name or size is kept already: ask again with the sha256."""

    model_config = ConfigDict(frozen=True)

    decision: Literal["hash_first"] = "hash_first"
    path: str


class Refused(BaseModel):
    """This file cannot be uploaded; the others can."""

    model_config = ConfigDict(frozen=True)

    decision: Literal["refused"] = "refused"
    path: str
    problem: ProblemDocument


UploadDecision = Annotated[Present | Linked | HashFirst | Send | Refused, Field(discriminator="decision")]


class UploadDecisions(BaseModel):
    """One decision a file, in the order asked."""

    model_config = ConfigDict(frozen=True)

    items: list[UploadDecision]


class PartToSign(BaseModel):
    """A part about to be sent, with its checksum in lower-case hex (of the kind that the upload names)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    upload_id: uuid.UUID
    number: PartNumber
    checksum: Annotated[str, Field(pattern=r"^([0-9a-f]{16}|[0-9a-f]{32}|[0-9a-f]{64})$")]


class PartsSign(BaseModel):
    """Parts to sign, of one or several uploads: many small files take one request."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    parts: Annotated[list[PartToSign], Field(min_length=1, max_length=MAX_FILES_PER_REQUEST)]

    @model_validator(mode="after")
    def _each_part_once(self) -> Self:
        if len({(part.upload_id, part.number) for part in self.parts}) < len(self.parts):
            raise ValueError("a part is asked for twice; one part has one checksum")
        return self


class SignedParts(BaseModel):
    """Signed parts, in the order asked; asking also renews the leases of their uploads."""

    model_config = ConfigDict(frozen=True)

    items: list[SignedPart]


class UploadFinish(BaseModel):
    """An upload whose parts are all sent; the hashes are of the whole file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    upload_id: uuid.UUID
    sha256: Sha256
    crc64nvme: Crc64


class UploadsComplete(BaseModel):
    """Uploads to finish."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    uploads: Annotated[list[UploadFinish], Field(min_length=1, max_length=MAX_FILES_PER_REQUEST)]


class Completed(BaseModel):
    """The store agreed; the file exists. It is null for who may not read, where another brought the same bytes."""

    model_config = ConfigDict(frozen=True)

    outcome: Literal["completed"] = "completed"
    upload_id: uuid.UUID
    file: FileRead | None


class NotCompleted(BaseModel):
    """The upload could not be finished; the problem says why and what to do."""

    model_config = ConfigDict(frozen=True)

    outcome: Literal["refused"] = "refused"
    upload_id: uuid.UUID
    problem: ProblemDocument


UploadOutcome = Annotated[Completed | NotCompleted, Field(discriminator="outcome")]


class UploadOutcomes(BaseModel):
    """One outcome an upload, in the order asked."""

    model_config = ConfigDict(frozen=True)

    items: list[UploadOutcome]
