"""The only door to the object store. Speaks S3; nobody else in the server does.

Addresses for clients are signed for the public store address, the server's own calls go to the internal one. Never
called inside a database transaction. Keys are opaque, and an object is never written twice.
"""

import base64
import hashlib
from collections.abc import AsyncGenerator, AsyncIterator, Iterable, Mapping
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, replace
from xml.sax.saxutils import escape

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.names import file_name
from kleinkram.contract.uploads import ChecksumKind, HeldPart
from kleinkram.server.s3 import LOST, S3, Answer, Question, S3Error, open_s3, why
from kleinkram.server.settings import Settings
from kleinkram.server.signing import Presigner, StoreClock

CHECKSUM_HEADERS = {
    ChecksumKind.crc64nvme: "x-amz-checksum-crc64nvme",
    ChecksumKind.sha256: "x-amz-checksum-sha256",
    ChecksumKind.md5: "Content-MD5",
}


class StoreRefused(Exception):
    """The store would not take what it was given, for a reason that trying again does not mend. Its own words inside.

    `is_digest`: the bytes are not those of the stated checksum.
    """

    def __init__(self, words: str, *, is_digest: bool = False) -> None:
        super().__init__(words)
        self.is_digest = is_digest


class StoreMissing(Exception):
    """The store says that it has no such object or multipart upload."""


@dataclass(frozen=True)
class StoredObject:
    """What the store says of an object. `crc64nvme` is null where it keeps none for the whole object."""

    key: str
    size_bytes: int
    crc64nvme: bytes | None


@dataclass(frozen=True)
class Signed:
    """An address good for one kind of request, and the headers that must go with it."""

    url: str
    headers: dict[str, str]


@dataclass(frozen=True)
class PartTarget:
    """Where one part goes. Without a multipart id the part is the whole object."""

    key: str
    multipart_id: str | None
    number: int
    size_bytes: int
    checksum: str


@dataclass(frozen=True)
class Abilities:
    """What a store can do, as the start-up probe found.

    `checksum`: how it verifies what it receives. `writes_once`: it refuses to write an object that exists.
    """

    checksum: ChecksumKind
    writes_once: bool


@dataclass(frozen=True)
class Signers:
    """What signs for clients and what signs for this server's own processes: each reaches the store by its address."""

    public: Presigner
    internal: Presigner
    bucket: str


class Storage:
    """One bucket of one store."""

    def __init__(self, s3: S3, signers: Signers, abilities: Abilities) -> None:
        self._s3 = s3
        self._signers = signers
        self.abilities = abilities

    @property
    def clock_ahead_s(self) -> float:
        """By how many seconds the store's clock is ahead of this machine's; 0 where the difference is small."""
        return self._signers.internal.clock.ahead_s

    @property
    def checksum(self) -> ChecksumKind:
        """How the store verifies what it receives."""
        return self.abilities.checksum

    async def check(self) -> None:
        """Ask for the bucket: that it is there, and may be used.

        Raises:
            StoreUnavailable: the store does not answer, has no such bucket, or refuses the access key.
        """
        try:
            await self._s3.ask(Question("HEAD"))
        except S3Error as error:
            code = await self._why_bucket_is_refused(error)
            reason = _MISCONFIGURED.get(code, f"ask for the bucket: {code}")
            raise StoreUnavailable(reason=reason.format(bucket=self._signers.bucket)) from error
        except LOST as error:
            raise StoreUnavailable(reason=f"it does not answer: {why(error)}") from error

    async def _why_bucket_is_refused(self, refusal: S3Error) -> str:
        """Return the store's code for a refusal; the answer to HEAD has no body, so ask once more where it matters."""
        if refusal.status not in {403, 404}:
            return refusal.code
        try:
            await self._s3.ask(Question("GET", query={"list-type": "2", "max-keys": "1", "prefix": "probe/"}))
        except S3Error as error:
            return error.code
        except LOST:
            return refusal.code
        return refusal.code

    async def begin_multipart(self, key: str) -> str:
        """Open a multipart upload and return the store's id of it.

        Raises:
            StoreUnavailable: the store does not answer, or gives no id.
        """
        headers = {}
        if self.checksum is ChecksumKind.crc64nvme:
            headers = {"x-amz-checksum-algorithm": "CRC64NVME", "x-amz-checksum-type": "FULL_OBJECT"}
        elif self.checksum is ChecksumKind.sha256:
            headers = {"x-amz-checksum-algorithm": "SHA256"}
        what = "begin a multipart upload"
        answer = await self._ask(what, Question("POST", key, {"uploads": ""}, headers))
        if multipart_id := answer.text("UploadId"):
            return multipart_id
        raise StoreUnavailable(reason=f"{what}: it gave no id")

    async def held_parts(self, key: str, multipart_id: str) -> list[HeldPart] | None:
        """Return the parts that the store holds, in order, or None when it no longer knows the upload."""
        raw = await self._raw_parts(key, multipart_id)
        if raw is None:
            return None
        return [
            HeldPart(number=int(part["PartNumber"]), size_bytes=int(part["Size"]), etag=part["ETag"]) for part in raw
        ]

    async def _raw_parts(self, key: str, multipart_id: str) -> list[dict[str, str]] | None:
        question = Question("GET", key, {"uploadId": multipart_id})
        try:
            return await self._listed("list parts", question, "Part", ("part-number-marker", "NextPartNumberMarker"))
        except StoreMissing:
            return None

    async def _listed(self, what: str, question: Question, name: str, marker: tuple[str, str]) -> list[dict[str, str]]:
        """Return all entries of a list; `marker` is how the next page is asked for, and how the last one names it."""
        return [entry async for page in self._pages(what, question, name, marker) for entry in page]

    async def _pages(
        self, what: str, question: Question, name: str, marker: tuple[str, str]
    ) -> AsyncIterator[list[dict[str, str]]]:
        asked, told = marker
        at = ""
        while True:
            page = replace(question, query={**question.query, asked: at}) if at else question
            answer = await self._ask(what, page)
            yield answer.entries(name)
            if answer.text("IsTruncated") != "true":
                return
            before, at = at, answer.text(told)
            if at in {"", before}:
                raise StoreUnavailable(reason=f"{what}: it does not say where its list goes on")

    def sign_part(self, target: PartTarget, *, expires_s: float) -> Signed:
        """Return where a client puts one part. Length and checksum (hex) are signed: other bytes are refused.

        The address of a whole object is good for one write where the store can promise that, so that it cannot be used
        to replace what was verified meanwhile. A part's dies with its multipart upload.
        """
        checksum = base64.b64encode(bytes.fromhex(target.checksum)).decode()
        headers = {CHECKSUM_HEADERS[self.checksum]: checksum, "Content-Length": str(target.size_bytes)}
        query = {}
        if target.multipart_id is not None:
            query = {"uploadId": target.multipart_id, "partNumber": str(target.number)}
        elif self.abilities.writes_once:
            headers["If-None-Match"] = "*"
        url = self._signers.public.sign("PUT", target.key, query=query, headers=headers, expires_s=expires_s)
        return Signed(url, headers)

    async def complete_multipart(self, key: str, multipart_id: str, *, count: int, crc64nvme: bytes) -> None:
        """Join the parts, of which there must be `count`; the store compares the whole's CRC-64/NVME where it can.

        Raises:
            StoreMissing: the store does not know this upload; it may have been completed before.
            StoreRefused: parts are missing or the checksum differs. This call made no object; another one may have.
        """
        parts = await self._raw_parts(key, multipart_id)
        if parts is None:
            raise StoreMissing(multipart_id)
        # A part sent twice may be listed twice; and while another call joins them, a list may be of what is left.
        listed = len({part["PartNumber"] for part in parts})
        if listed != count:
            raise StoreRefused(f"the store lists {listed} of {count} parts")
        # Of different bytes the store takes the last. The same are named once: SeaweedFS 4.48, asked for both, joins
        # one and drops the bytes of both.
        each = {(part["PartNumber"], part["ETag"]): part for part in parts}
        headers = {}
        if self.checksum is ChecksumKind.crc64nvme:
            checksum = base64.b64encode(crc64nvme).decode()
            headers = {CHECKSUM_HEADERS[ChecksumKind.crc64nvme]: checksum, "x-amz-checksum-type": "FULL_OBJECT"}
        body = _part_list(each.values(), with_sha256=self.checksum is ChecksumKind.sha256)
        question = Question("POST", key, {"uploadId": multipart_id}, headers, body)
        await self._ask("complete a multipart upload", question)

    async def abort_multipart(self, key: str, multipart_id: str) -> None:
        """Drop a multipart upload and its parts; nothing happens where there is none."""
        try:
            await self._ask("abort a multipart upload", Question("DELETE", key, {"uploadId": multipart_id}))
        except StoreMissing:
            return

    async def find(self, key: str) -> StoredObject | None:
        """Return what the store says of an object, or None where there is none.

        Raises:
            StoreUnavailable: the store does not answer, or contradicts itself.
        """
        what = "look for an object"
        try:
            answer = await self._ask(what, Question("HEAD", key, headers={"x-amz-checksum-mode": "ENABLED"}))
        except StoreMissing:
            # An answer without a body may be a proxy's. A list is the store's own word.
            if key in await self.sizes(key):
                raise StoreUnavailable(reason=f"{what}: it is listed, and not found") from None
            return None
        crc = answer.headers.get(CHECKSUM_HEADERS[ChecksumKind.crc64nvme])
        return StoredObject(key, int(answer.headers["content-length"]), base64.b64decode(crc) if crc else None)

    async def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes in bytes of all objects whose keys begin with `prefix`."""
        return {key: size_bytes async for page in self.pages(prefix) for key, size_bytes in page.items()}

    async def pages(self, prefix: str = "") -> AsyncIterator[dict[str, int]]:
        """Yield the same in portions as the store gives them, by key; at least one, which may be empty.

        Raises:
            StoreUnavailable: the store does not answer, or stops in the middle.
        """
        async for page in self._objects(prefix):
            yield {entry["Key"]: int(entry["Size"]) for entry in page}

    async def held_objects(self, prefix: str) -> dict[str, HeldPart]:
        """Return, by key, the objects whose keys begin with `prefix`: each as the one part in which it came."""
        return {
            entry["Key"]: HeldPart(number=1, size_bytes=int(entry["Size"]), etag=entry["ETag"])
            async for page in self._objects(prefix)
            for entry in page
        }

    def _objects(self, prefix: str) -> AsyncIterator[list[dict[str, str]]]:
        question = Question("GET", query={"list-type": "2", "prefix": prefix})
        return self._pages("list objects", question, "Contents", ("continuation-token", "NextContinuationToken"))

    async def open_multiparts(self, prefix: str) -> list[tuple[str, str]]:
        """Return key and id of the multipart uploads under way whose keys begin with `prefix`."""
        question = Question("GET", query={"uploads": "", "prefix": prefix})
        answer = await self._ask("list multipart uploads", question)
        return [(entry["Key"], entry["UploadId"]) for entry in answer.entries("Upload")]

    def sign_read(self, key: str, *, path: str, expires_s: float) -> str:
        """Return where a client reads an object, whole or by ranges; a browser saves it under the file's name."""
        quoted = file_name(path).encode("ascii", "replace").decode().replace('"', "_").replace("?", "_")
        query = {
            "response-content-disposition": f'attachment; filename="{quoted}"',
            # Every header that an uploader can have stored is replaced: a browser would unpack what is called packed,
            # and a proxy would keep and hand to others what is called public.
            "response-content-encoding": "identity",
            "response-content-type": "application/octet-stream",
            "response-content-language": "und",
            "response-cache-control": "private",
            "response-expires": "Thu, 01 Jan 1970 00:00:00 GMT",
        }
        return self._signers.public.sign("GET", key, query=query, headers={}, expires_s=expires_s)

    def sign_internal_read(self, key: str, *, expires_s: float) -> str:
        """Return where a process of this server, without credentials, reads an object by ranges."""
        return self._signers.internal.sign("GET", key, query={}, headers={}, expires_s=expires_s)

    async def read(self, key: str, *, attempts: int = 3) -> AsyncGenerator[bytes, None]:
        """Stream an object in pieces of at most 1 MiB; `aclose` gives the connection back before the end.

        Raises:
            FileNotFoundError: the store has no such object.
            StoreUnavailable: the store does not answer, or stops in the middle.
        """
        try:
            async with aclosing(self._s3.stream(Question("GET", key), attempts=attempts)) as pieces:
                async for piece in pieces:
                    yield piece
        except S3Error as error:
            if error.code == "NoSuchKey":
                raise FileNotFoundError(key) from None
            raise StoreUnavailable(reason=f"read an object: {error.code}") from error
        except LOST as error:
            raise StoreUnavailable(reason=f"reading stopped: {why(error)}") from error

    async def read_range(self, key: str, *, offset: int, size_bytes: int, attempts: int = 3) -> bytes:
        """Return some bytes of an object, fewer where it ends before; to be small enough to be held.

        Raises:
            FileNotFoundError: the store has no such object.
            StoreUnavailable: the store does not answer, or stops in the middle.
        """
        question = Question("GET", key, headers={"Range": f"bytes={offset}-{offset + size_bytes - 1}"})
        try:
            async with aclosing(self._s3.stream(question, attempts=attempts)) as pieces:
                return b"".join([piece async for piece in pieces])
        except S3Error as error:
            if error.code == "InvalidRange":
                return b""
            if error.code == "NoSuchKey":
                raise FileNotFoundError(key) from None
            raise StoreUnavailable(reason=f"read an object: {error.code}") from error
        except LOST as error:
            raise StoreUnavailable(reason=f"reading stopped: {why(error)}") from error

    async def put_small(self, key: str, body: bytes, headers: Mapping[str, str] | None = None) -> None:
        """Write a small object of the server's own, by the conditions that `headers` state.

        Raises:
            StoreRefused: the store would not take it.
        """
        await self._ask("write an object", Question("PUT", key, {}, headers or {}, body))

    async def put_small_part(self, key: str, multipart_id: str, body: bytes, headers: Mapping[str, str]) -> None:
        """Write one small part of the server's own, by the conditions that `headers` state.

        Raises:
            StoreRefused: the store would not take it.
        """
        query = {"uploadId": multipart_id, "partNumber": "1"}
        await self._ask("write a part", Question("PUT", key, query, headers, body))

    async def set_cross_origin(self, rules: bytes) -> None:
        """Write which pages browsers let talk to the bucket, in place of what was said before.

        Raises:
            StoreRefused, StoreUnavailable: the store would not take it, or knows no such rules.
        """
        digest = base64.b64encode(hashlib.md5(rules, usedforsecurity=False).digest()).decode()
        headers = {"Content-MD5": digest, "Content-Type": "application/xml"}
        await self._ask("write the CORS rules", Question("PUT", "", {"cors": ""}, headers, rules))

    async def lets_page(self, origin: str, method: str) -> bool:
        """Ask as a browser does whether pages of `origin` may send such requests; no where there is no answer."""
        try:
            return await self._s3.lets_page(origin, method)
        except LOST:
            return False

    def verifying_by(self, checksum: ChecksumKind) -> "Storage":
        """Return the same store, asked for another kind of verification."""
        return Storage(self._s3, self._signers, replace(self.abilities, checksum=checksum))

    def with_abilities(self, abilities: Abilities) -> "Storage":
        """Return the same store, of which more is known."""
        return Storage(self._s3, self._signers, abilities)

    async def delete(self, key: str) -> None:
        """Delete an object; nothing happens where there is none."""
        await self._ask("delete an object", Question("DELETE", key))

    async def _ask(self, what: str, question: Question) -> Answer:
        try:
            return await self._s3.ask(question)
        except S3Error as error:
            raise _refusal(error, what, question) from error
        except LOST as error:
            raise StoreUnavailable(reason=f"{what}: {why(error)}") from error


def _part_list(parts: Iterable[dict[str, str]], *, with_sha256: bool) -> bytes:
    """What a store is sent to join parts."""
    # Some stores verify a part's SHA-256 and do not list it; those that list it want it back.
    names = ["PartNumber", "ETag", *(["ChecksumSHA256"] if with_sha256 else [])]
    listing = ("".join(f"<{name}>{escape(part[name])}</{name}>" for name in names if name in part) for part in parts)
    joined = "".join(f"<Part>{each}</Part>" for each in listing)
    return f'<CompleteMultipartUpload xmlns="{_NAMESPACE}">{joined}</CompleteMultipartUpload>'.encode()


_NAMESPACE = "http://s3.amazonaws.com/doc/2006-03-01/"
# What a store says when the request itself is at fault. Everything else may go better another time.
_REFUSALS = frozenset(
    {"InvalidPart", "InvalidPartOrder", "EntityTooSmall", "EntityTooLarge", "InvalidRequest", "InvalidArgument"}
    | {"BadRequest", "NotImplemented", "PreconditionFailed", "MalformedXML"}
)
_DIGESTS = frozenset({"BadDigest", "InvalidDigest", "XAmzContentChecksumMismatch"})
_MISSING = frozenset({"NoSuchKey", "NoSuchUpload"})


_MISCONFIGURED = {
    "NoSuchBucket": "there is no bucket '{bucket}': create it, or correct KLEINKRAM_S3_BUCKET",
    "InvalidAccessKeyId": "it does not know the access key: correct KLEINKRAM_S3_ACCESS_KEY",
    "SignatureDoesNotMatch": "the secret key does not fit the access key: correct KLEINKRAM_S3_SECRET_KEY",
    "AccessDenied": "the access key has no right to list the bucket '{bucket}': grant it s3:ListBucket",
    "RequestTimeTooSkewed": "its clock and this machine's differ: let both set their clocks (NTP)",
}


def _refusal(error: S3Error, what: str, question: Question) -> Exception:
    # An answer to HEAD has no body, so that the status is all it says.
    if question.key and (error.code in _MISSING or (question.method == "HEAD" and error.status == 404)):
        return StoreMissing(what)
    if error.code in _DIGESTS or error.code in _REFUSALS:
        return StoreRefused(f"{what}: {error.code}: {error.words}", is_digest=error.code in _DIGESTS)
    return StoreUnavailable(reason=f"{what}: {error.code}")


@asynccontextmanager
async def open_storage(settings: Settings) -> AsyncIterator[Storage]:
    """Open the store for the life of a process. What it can do is for the probe to find out, or stands in each row."""
    clock = StoreClock()
    signers = Signers(
        Presigner(settings, settings.store_public_url, clock),
        Presigner(settings, settings.s3_internal_url, clock),
        settings.s3_bucket,
    )
    async with open_s3(settings, signers.internal) as s3:
        await s3.look_at_clock()
        yield Storage(s3, signers, Abilities(ChecksumKind.md5, writes_once=False))
