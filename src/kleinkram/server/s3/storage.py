"""The object store as the rest of the server uses it: objects, multipart uploads and signed URLs of one bucket.

URLs for clients are signed for the store's public address; the server's own requests go to the internal one. Never
called inside a database transaction. Keys are opaque, and no object is written twice.
"""

import base64
import hashlib
from collections.abc import AsyncGenerator, AsyncIterator, Iterable, Mapping
from contextlib import aclosing, asynccontextmanager, suppress
from dataclasses import dataclass, replace
from typing import NamedTuple
from xml.sax.saxutils import escape

from kleinkram import traces
from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.names import file_name
from kleinkram.contract.uploads import ChecksumKind, StoredPart
from kleinkram.server.s3.client import (
    CONNECTION_ERRORS,
    S3Client,
    S3Error,
    S3Request,
    S3Response,
    describe_connection_error,
    is_certificate_error,
    open_s3,
)
from kleinkram.server.s3.signing import Presigner, StoreClock
from kleinkram.server.s3.traced_client import TracedS3Client
from kleinkram.server.settings import Settings

CHECKSUM_HEADERS = {
    ChecksumKind.crc64nvme: "x-amz-checksum-crc64nvme",
    ChecksumKind.sha256: "x-amz-checksum-sha256",
    ChecksumKind.md5: "Content-MD5",
}
_NAMESPACE = "http://s3.amazonaws.com/doc/2006-03-01/"
# Error codes for requests that are wrong themselves. Any other request may succeed later.
_WRONG_CHECKSUM = frozenset({"BadDigest", "InvalidDigest", "XAmzContentChecksumMismatch"})
_WRONG_REQUEST = frozenset(
    {"InvalidPart", "InvalidPartOrder", "EntityTooSmall", "EntityTooLarge", "InvalidRequest", "InvalidArgument"}
    | {"BadRequest", "NotImplemented", "PreconditionFailed", "MalformedXML"}
)
_MISSING = frozenset({"NoSuchKey", "NoSuchUpload"})
_MISCONFIGURED = {
    "NoSuchBucket": "there is no bucket '{bucket}': create it, or correct KLEINKRAM_S3_BUCKET",
    "InvalidAccessKeyId": "it does not know the access key: correct KLEINKRAM_S3_ACCESS_KEY",
    "SignatureDoesNotMatch": "the secret key does not fit the access key: correct KLEINKRAM_S3_SECRET_KEY",
    "AccessDenied": "the access key has no right to list the bucket '{bucket}': grant it s3:ListBucket",
    **dict.fromkeys(
        ("AuthorizationHeaderMalformed", "AuthorizationQueryParametersError", "PermanentRedirect", "InvalidRegion"),
        "it is in another region: correct KLEINKRAM_S3_REGION",
    ),
    "400": "it does not understand requests: KLEINKRAM_S3_INTERNAL_URL may have to begin with https://",
    "NotAStore": "the server at KLEINKRAM_S3_INTERNAL_URL is no S3 store",
    "404": "there is no bucket '{bucket}': create it, or correct KLEINKRAM_S3_BUCKET",
    "RequestTimeTooSkewed": "its clock and this machine's differ: let both set their clocks (NTP)",
}
_MAY_NOT_CREATE = "the access key may not create the bucket: grant it s3:CreateBucket, or create the bucket yourself"
# The region that a request to create a bucket must not name. Source: Amazon S3 API Reference, CreateBucket.
_UNNAMED_REGION = "us-east-1"
# Every header that an uploader can have stored is replaced: a browser would decode what is declared as compressed, and
# a proxy would cache what is declared as public.
_SAFE_RESPONSE_HEADERS = {
    "response-content-encoding": "identity",
    "response-content-type": "application/octet-stream",
    "response-content-language": "und",
    "response-cache-control": "private",
    "response-expires": "Thu, 01 Jan 1970 00:00:00 GMT",
}


class StoreRefused(Exception):
    """The store refused a request, and would refuse it again; the message is the store's.

    `is_wrong_checksum`: the bytes do not match the stated checksum.
    """

    def __init__(self, message: str, *, is_wrong_checksum: bool = False) -> None:
        super().__init__(message)
        self.is_wrong_checksum = is_wrong_checksum


class StoreMissing(Exception):
    """The store has no such object or multipart upload."""


@dataclass(frozen=True)
class StoredObject:
    """Properties of a stored object. `crc64nvme` is None if the store has none for the whole object."""

    key: str
    size_bytes: int
    crc64nvme: bytes | None


@dataclass(frozen=True)
class SignedRequest:
    """A URL that is valid for one kind of request, and the headers that the request must carry."""

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


class MultipartUpload(NamedTuple):
    """A multipart upload that is open at the store."""

    key: str
    multipart_id: str


@dataclass(frozen=True)
class StoreCapabilities:
    """Capabilities of the store, probed at start-up: the `checksum` it verifies; whether it refuses to overwrite."""

    checksum: ChecksumKind
    writes_once: bool


@dataclass(frozen=True)
class Signers:
    """Signers for clients and for this server's own processes, which reach the store at different addresses."""

    public: Presigner
    internal: Presigner
    bucket: str


class Storage:
    """One bucket of one store."""

    def __init__(self, client: S3Client, signers: Signers, capabilities: StoreCapabilities) -> None:
        self._client = client
        self._signers = signers
        self.capabilities = capabilities

    @property
    def clock_offset_s(self) -> float:
        """Seconds by which the store's clock is ahead of this machine's; 0 for a small difference."""
        return self._signers.internal.clock.offset_s

    @property
    def checksum(self) -> ChecksumKind:
        """The checksum that the store verifies on receipt."""
        return self.capabilities.checksum

    def with_checksum(self, checksum: ChecksumKind) -> "Storage":
        """Return the same store, using another kind of checksum."""
        return self.with_capabilities(replace(self.capabilities, checksum=checksum))

    def with_capabilities(self, capabilities: StoreCapabilities) -> "Storage":
        """Return the same store with other capabilities."""
        return Storage(self._client, self._signers, capabilities)

    # -- the bucket ---------------------------------------------------------------------------------------------------

    async def check(self) -> None:
        """Check that the bucket exists and is accessible.

        Raises:
            StoreUnavailable: the store does not answer, has no such bucket, or refuses the access key.
        """
        try:
            await self._client.request(S3Request("HEAD"))
        except S3Error as error:
            code = await self._code_of_refusal(error)
            reason = _MISCONFIGURED.get(code, f"check the bucket: {code}")
            raise StoreUnavailable(reason=reason.format(bucket=self._signers.bucket)) from error
        except CONNECTION_ERRORS as error:
            reason = f"it does not answer: {describe_connection_error(error)}"
            if is_certificate_error(error):
                reason += " (KLEINKRAM_S3_CA_FILE names the certificate of a private authority)"
            raise StoreUnavailable(reason=reason) from error

    async def create_bucket(self, region: str) -> bool:
        """Create the bucket unless it exists; return whether it was created.

        Raises:
            StoreUnavailable: the store does not answer, or refuses.
        """
        with suppress(StoreUnavailable):
            await self.check()
            return False
        try:
            await self._client.request(S3Request("PUT", body=_location(region)))
        except S3Error as error:
            reasons = {**_MISCONFIGURED, "AccessDenied": _MAY_NOT_CREATE}
            raise StoreUnavailable(reason=reasons.get(error.code, f"create the bucket: {error.code}")) from error
        except CONNECTION_ERRORS as error:
            raise StoreUnavailable(reason=f"it does not answer: {describe_connection_error(error)}") from error
        await self.check()
        return True

    async def _code_of_refusal(self, refusal: S3Error) -> str:
        """Return the store's error code; the response to HEAD has no body, so a GET repeats the request."""
        if refusal.status not in {301, 400, 403, 404}:
            return refusal.code
        try:
            await self._client.request(S3Request("GET", query={"list-type": "2", "max-keys": "1", "prefix": "probe/"}))
        except S3Error as error:
            return error.code
        except CONNECTION_ERRORS:
            return refusal.code
        return refusal.code

    async def set_cors(self, rules: bytes) -> None:
        """Replace the bucket's CORS rules.

        Raises:
            StoreRefused, StoreUnavailable: the store did not accept them, or supports none.
        """
        digest = base64.b64encode(hashlib.md5(rules, usedforsecurity=False).digest()).decode()
        headers = {"Content-MD5": digest, "Content-Type": "application/xml"}
        await self._request("write the CORS rules", S3Request("PUT", "", {"cors": ""}, headers, rules))

    async def allows_page(self, origin: str, method: str) -> bool:
        """Return whether a browser would let pages of `origin` send such requests; False if the store is away."""
        try:
            return await self._client.allows_page(origin, method)
        except CONNECTION_ERRORS:
            return False

    # -- multipart uploads --------------------------------------------------------------------------------------------

    async def create_multipart(self, key: str) -> str:
        """Create a multipart upload and return its id.

        Raises:
            StoreUnavailable: the store does not answer, or returns no id.
        """
        headers = {}
        if self.checksum is ChecksumKind.crc64nvme:
            headers = {"x-amz-checksum-algorithm": "CRC64NVME", "x-amz-checksum-type": "FULL_OBJECT"}
        elif self.checksum is ChecksumKind.sha256:
            headers = {"x-amz-checksum-algorithm": "SHA256"}
        response = await self._request("create a multipart upload", S3Request("POST", key, {"uploads": ""}, headers))
        if multipart_id := response.text("UploadId"):
            return multipart_id
        raise StoreUnavailable(reason="create a multipart upload: it returned no id")

    async def list_multiparts(self, prefix: str) -> list[MultipartUpload]:
        """Return the open multipart uploads whose keys start with `prefix`."""
        request = S3Request("GET", query={"uploads": "", "prefix": prefix})
        response = await self._request("list multipart uploads", request)
        return [MultipartUpload(entry["Key"], entry["UploadId"]) for entry in response.entries("Upload")]

    async def list_parts(self, key: str, multipart_id: str) -> list[StoredPart] | None:
        """Return the parts that the store has, in order, or None if it no longer has the upload."""
        entries = await self._part_entries(key, multipart_id)
        if entries is None:
            return None
        return [
            StoredPart(number=int(entry["PartNumber"]), size_bytes=int(entry["Size"]), etag=entry["ETag"])
            for entry in entries
        ]

    async def _part_entries(self, key: str, multipart_id: str) -> list[dict[str, str]] | None:
        request = S3Request("GET", key, {"uploadId": multipart_id})
        markers = ("part-number-marker", "NextPartNumberMarker")
        try:
            return [entry async for page in self._pages("list parts", request, "Part", markers) for entry in page]
        except StoreMissing:
            return None

    def sign_part(self, target: PartTarget, *, expires_s: float) -> SignedRequest:
        """Return where a client PUTs one part. Size and checksum (hex) are signed: other bytes are refused.

        The URL of a whole object is valid for one write if the store can guarantee that, so it cannot be used to
        replace the object later. The URL of a part ends with its multipart upload.
        """
        checksum = base64.b64encode(bytes.fromhex(target.checksum)).decode()
        headers = {CHECKSUM_HEADERS[self.checksum]: checksum, "Content-Length": str(target.size_bytes)}
        query = {}
        if target.multipart_id is not None:
            query = {"uploadId": target.multipart_id, "partNumber": str(target.number)}
        elif self.capabilities.writes_once:
            headers["If-None-Match"] = "*"
        url = self._signers.public.sign("PUT", target.key, query=query, headers=headers, expires_s=expires_s)
        return SignedRequest(url, headers)

    async def complete_multipart(self, key: str, multipart_id: str, *, count: int, crc64nvme: bytes) -> None:
        """Join all `count` parts; the store compares the CRC-64/NVME of the whole if it supports that.

        Raises:
            StoreMissing: the store has no such upload; it may have been completed before.
            StoreRefused: parts are missing or the checksum differs. Another call may still have made the object.
        """
        entries = await self._part_entries(key, multipart_id)
        if entries is None:
            raise StoreMissing(multipart_id)
        # A part sent twice may be listed twice; and while another call joins them, the list may be incomplete.
        listed = len({entry["PartNumber"] for entry in entries})
        if listed != count:
            raise StoreRefused(f"the store lists {listed} of {count} parts")
        # Of parts with different bytes the store takes the last. Parts with the same bytes are named once: given both,
        # SeaweedFS 4.48 joins one and drops the bytes of both.
        parts = {(entry["PartNumber"], entry["ETag"]): entry for entry in entries}
        headers = {}
        if self.checksum is ChecksumKind.crc64nvme:
            checksum = base64.b64encode(crc64nvme).decode()
            headers = {CHECKSUM_HEADERS[ChecksumKind.crc64nvme]: checksum, "x-amz-checksum-type": "FULL_OBJECT"}
        body = _part_list(parts.values(), with_sha256=self.checksum is ChecksumKind.sha256)
        request = S3Request("POST", key, {"uploadId": multipart_id}, headers, body)
        await self._request("complete a multipart upload", request)

    async def abort_multipart(self, key: str, multipart_id: str) -> None:
        """Delete a multipart upload and its parts; does nothing if there is none."""
        try:
            await self._request("abort a multipart upload", S3Request("DELETE", key, {"uploadId": multipart_id}))
        except StoreMissing:
            return

    async def put_part(self, key: str, multipart_id: str, body: bytes, headers: Mapping[str, str]) -> None:
        """Write one small part as the server.

        Raises:
            StoreRefused: the store refused it.
        """
        query = {"uploadId": multipart_id, "partNumber": "1"}
        await self._request("write a part", S3Request("PUT", key, query, headers, body))

    # -- objects ------------------------------------------------------------------------------------------------------

    async def find(self, key: str) -> StoredObject | None:
        """Return the properties of an object, or None if there is none.

        Raises:
            StoreUnavailable: the store does not answer, or contradicts itself.
        """
        try:
            request = S3Request("HEAD", key, headers={"x-amz-checksum-mode": "ENABLED"})
            response = await self._request("look up an object", request)
        except StoreMissing:
            # An answer without a body may be a proxy's; a listing can only be the store's.
            if key in await self.sizes(key):
                raise StoreUnavailable(reason="look up an object: it is listed but not found") from None
            return None
        crc = response.headers.get(CHECKSUM_HEADERS[ChecksumKind.crc64nvme])
        return StoredObject(key, int(response.headers["content-length"]), base64.b64decode(crc) if crc else None)

    async def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes in bytes of all objects whose keys start with `prefix`."""
        return {key: size_bytes async for page in self.size_pages(prefix) for key, size_bytes in page.items()}

    async def size_pages(self, prefix: str = "") -> AsyncIterator[dict[str, int]]:
        """Yield the same page by page, ordered by key; at least one page, which may be empty.

        Raises:
            StoreUnavailable: the store does not answer, or stops in the middle.
        """
        async for page in self._object_pages(prefix):
            yield {entry["Key"]: int(entry["Size"]) for entry in page}

    async def list_objects(self, prefix: str) -> dict[str, StoredPart]:
        """Return, by key, the objects whose keys start with `prefix`, each as the one part it was uploaded in."""
        return {
            entry["Key"]: StoredPart(number=1, size_bytes=int(entry["Size"]), etag=entry["ETag"])
            async for page in self._object_pages(prefix)
            for entry in page
        }

    def _object_pages(self, prefix: str) -> AsyncIterator[list[dict[str, str]]]:
        request = S3Request("GET", query={"list-type": "2", "prefix": prefix})
        return self._pages("list objects", request, "Contents", ("continuation-token", "NextContinuationToken"))

    async def _pages(
        self, purpose: str, request: S3Request, name: str, markers: tuple[str, str]
    ) -> AsyncIterator[list[dict[str, str]]]:
        """Yield a listing's entries page by page; `markers` are the query parameter and the element for the next."""
        parameter, element = markers
        position = ""
        while True:
            page = replace(request, query={**request.query, parameter: position}) if position else request
            response = await self._request(purpose, page)
            yield response.entries(name)
            if response.text("IsTruncated") != "true":
                return
            previous, position = position, response.text(element)
            if position in {"", previous}:
                raise StoreUnavailable(reason=f"{purpose}: the listing does not say where it continues")

    def sign_get(self, key: str, *, path: str, expires_s: float) -> str:
        """Return where a client reads an object, whole or by ranges; browsers save it under the file's name."""
        name = file_name(path).encode("ascii", "replace").decode().replace('"', "_").replace("?", "_")
        query = {"response-content-disposition": f'attachment; filename="{name}"', **_SAFE_RESPONSE_HEADERS}
        return self._signers.public.sign("GET", key, query=query, headers={}, expires_s=expires_s)

    def sign_internal_get(self, key: str, *, expires_s: float) -> str:
        """Return where a process of this server without credentials reads an object by ranges."""
        return self._signers.internal.sign("GET", key, query={}, headers={}, expires_s=expires_s)

    def read(self, key: str, *, attempts: int = 3) -> AsyncGenerator[bytes, None]:
        """Stream an object in chunks of at most 1 MiB; `aclose` returns the connection before the end.

        Raises:
            FileNotFoundError: the store has no such object.
            StoreUnavailable: the store does not answer, or stops in the middle.
        """
        return self._stream(S3Request("GET", key), attempts)

    async def read_range(self, key: str, *, offset: int, size_bytes: int, attempts: int = 3) -> bytes:
        """Return a small range of an object, shorter where the object ends before it.

        Raises:
            FileNotFoundError: the store has no such object.
            StoreUnavailable: the store does not answer, or stops in the middle.
        """
        request = S3Request("GET", key, headers={"Range": f"bytes={offset}-{offset + size_bytes - 1}"})
        return b"".join([chunk async for chunk in self._stream(request, attempts)])

    async def _stream(self, request: S3Request, attempts: int) -> AsyncGenerator[bytes, None]:
        try:
            async with aclosing(self._client.stream(request, attempts=attempts)) as chunks:
                async for chunk in chunks:
                    yield chunk
        except S3Error as error:
            if error.code == "InvalidRange":  # the object ends before the range
                return
            if error.code == "NoSuchKey":
                raise FileNotFoundError(request.key) from None
            raise StoreUnavailable(reason=f"read an object: {error.code}") from error
        except CONNECTION_ERRORS as error:
            raise StoreUnavailable(reason=f"reading stopped: {describe_connection_error(error)}") from error

    async def put_object(self, key: str, body: bytes, headers: Mapping[str, str] | None = None) -> None:
        """Write a small object as the server; `headers` may state conditions.

        Raises:
            StoreRefused: the store refused it.
        """
        await self._request("write an object", S3Request("PUT", key, {}, headers or {}, body))

    async def delete(self, key: str) -> None:
        """Delete an object; does nothing if there is none."""
        await self._request("delete an object", S3Request("DELETE", key))

    async def _request(self, purpose: str, request: S3Request) -> S3Response:
        try:
            return await self._client.request(request)
        except S3Error as error:
            raise _translate(error, purpose, request) from error
        except CONNECTION_ERRORS as error:
            raise StoreUnavailable(reason=f"{purpose}: {describe_connection_error(error)}") from error


def _translate(error: S3Error, purpose: str, request: S3Request) -> Exception:
    # An answer to HEAD has no body, only a status.
    if request.key and (error.code in _MISSING or (request.method == "HEAD" and error.status == 404)):
        return StoreMissing(purpose)
    if error.code in _WRONG_CHECKSUM or error.code in _WRONG_REQUEST:
        message = f"{purpose}: {error.code}: {error.message}"
        return StoreRefused(message, is_wrong_checksum=error.code in _WRONG_CHECKSUM)
    return StoreUnavailable(reason=f"{purpose}: {error.code}")


def _location(region: str) -> bytes:
    """Return the body of CreateBucket."""
    if region == _UNNAMED_REGION:
        return b""
    constraint = f"<LocationConstraint>{escape(region)}</LocationConstraint>"
    return f'<CreateBucketConfiguration xmlns="{_NAMESPACE}">{constraint}</CreateBucketConfiguration>'.encode()


def _part_list(parts: Iterable[dict[str, str]], *, with_sha256: bool) -> bytes:
    """Return the body of CompleteMultipartUpload."""
    # Some stores verify a part's SHA-256 without listing it; those that list it require it here.
    names = ["PartNumber", "ETag", *(["ChecksumSHA256"] if with_sha256 else [])]
    elements = ("".join(f"<{name}>{escape(part[name])}</{name}>" for name in names if name in part) for part in parts)
    joined = "".join(f"<Part>{element}</Part>" for element in elements)
    return f'<CompleteMultipartUpload xmlns="{_NAMESPACE}">{joined}</CompleteMultipartUpload>'.encode()


@asynccontextmanager
async def open_storage(settings: Settings) -> AsyncIterator[Storage]:
    """Open the store for the life of a process. Its capabilities come from the probe, or from each row."""
    clock = StoreClock()
    signers = Signers(
        Presigner(settings, settings.store_public_url, clock),
        Presigner(settings, settings.s3_internal_url, clock),
        settings.s3_bucket,
    )
    client_class = TracedS3Client if traces.is_on() else S3Client
    async with open_s3(settings, signers.internal, client_class) as client:
        await client.read_clock()
        yield Storage(client, signers, StoreCapabilities(ChecksumKind.md5, writes_once=False))
