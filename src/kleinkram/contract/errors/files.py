"""A file cannot be stored, or its bytes cannot be given out."""

from dataclasses import dataclass

from kleinkram.contract.errors.base import ErrorCode, KleinkramError


@dataclass(eq=False)
class FileExists(KleinkramError):
    """{path!r} is already in this mission with other content{hashes}. Nothing was changed; rename yours, or delete the old one first."""  # noqa: E501  one sentence

    code = ErrorCode.file_exists
    status = 409
    path: str
    # Null, as is the id, for who may not read what is there.
    existing_sha256: str | None
    given_sha256: str | None
    existing_file_id: str | None

    @property
    def hashes(self) -> str:
        """Both contents, where both may be told."""
        if self.existing_sha256 is None:
            return ""
        return f" (there sha256 {self.existing_sha256}, yours {self.given_sha256})"


@dataclass(eq=False)
class PathConflict(KleinkramError):
    """{path!r} cannot be stored beside {other!r}: one is a file where the other needs a folder, or they differ only in case or Unicode form."""  # noqa: E501  one sentence

    code = ErrorCode.path_conflict
    status = 409
    path: str
    other: str


@dataclass(eq=False)
class NameLeased(KleinkramError):
    """{path!r} is being uploaded by another client right now. Wait for it, or try again after {lease_ends_at}."""

    code = ErrorCode.name_leased
    status = 409
    path: str
    lease_ends_at: str


@dataclass(eq=False)
class UploadGone(KleinkramError):
    """The upload {upload_id} has ended (expired, aborted, or its mission was deleted). Run the same command again to begin anew."""  # noqa: E501  one sentence

    code = ErrorCode.upload_gone
    status = 410
    upload_id: str


@dataclass(eq=False)
class UploadIncomplete(KleinkramError):
    """The store does not hold all of {path!r}: {reason}. Run the same command again; only what is missing is sent."""

    code = ErrorCode.upload_incomplete
    status = 409
    path: str
    reason: str


@dataclass(eq=False)
class ChecksumMismatch(KleinkramError):
    """The bytes that arrived for {path!r} are not the bytes that were read: {reason}. Nothing was kept; upload it again."""  # noqa: E501  one sentence

    code = ErrorCode.checksum_mismatch
    status = 422
    path: str
    reason: str


@dataclass(eq=False)
class FileUnavailable(KleinkramError):
    """The bytes of {path!r} cannot be given out: the store's copy is {state}. Upload the file again to mend it."""

    code = ErrorCode.file_unavailable
    status = 409
    path: str
    state: str


@dataclass(eq=False)
class QuotaExceeded(KleinkramError):
    """The project {project!r} has no room for this: it asks for {asked} {unit}{numbers}. Nothing was begun; delete something, or ask an admin for more."""  # noqa: E501  one sentence

    code = ErrorCode.quota_exceeded
    status = 507
    project: str
    # `bytes` or `files`.
    unit: str
    asked: int
    # Null for whoever may not see what the project holds.
    used: int | None = None
    quota: int | None = None

    @property
    def numbers(self) -> str:
        """What is used of what there is, where that may be told."""
        return "" if self.used is None else f" more, and {self.used} of {self.quota} are used"
