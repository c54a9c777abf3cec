"""The only door to the object store. Speaks S3; nobody else in the server does.

Addresses for clients are signed for the public store address, the server's own calls go to the internal one. Never
called inside a database transaction. Keys are opaque, and an object is never written twice.
"""

import asyncio
import base64
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any

from aiobotocore.config import AioConfig
from aiobotocore.session import get_session
from aiohttp import ClientError as HttpError
from botocore.exceptions import BotoCoreError, ClientError

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.names import file_name
from kleinkram.contract.uploads import ChecksumKind, HeldPart
from kleinkram.server.settings import Settings
from kleinkram.server.signing import Presigner

READ_BYTES = 1024 * 1024
_HEADERS = {
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

    `checksum`: how it proves what it receives. `writes_once`: it refuses to write an object that exists.
    """

    checksum: ChecksumKind
    writes_once: bool


@dataclass(frozen=True)
class Signers:
    """What signs for clients and what signs for this server's own processes: each reaches the store by its address."""

    public: Presigner
    internal: Presigner


class Storage:
    """One bucket of one store."""

    def __init__(self, client: Any, signers: Signers, bucket: str, abilities: Abilities) -> None:
        # Any: botocore builds its clients from data at run time.
        self._client = client
        self._signers = signers
        self.bucket = bucket
        self.abilities = abilities

    @property
    def checksum(self) -> ChecksumKind:
        """How the store proves what it receives."""
        return self.abilities.checksum

    async def check(self) -> None:
        """Ask for the bucket.

        Raises:
            StoreUnavailable: the store does not answer, or not for this bucket and key.
        """
        await self._call("head_bucket", Bucket=self.bucket)

    async def begin_multipart(self, key: str) -> str:
        """Open a multipart upload and return the store's id of it."""
        arguments = {}
        if self.checksum is ChecksumKind.crc64nvme:
            arguments = {"ChecksumAlgorithm": "CRC64NVME", "ChecksumType": "FULL_OBJECT"}
        elif self.checksum is ChecksumKind.sha256:
            arguments = {"ChecksumAlgorithm": "SHA256"}
        answer = await self._call("create_multipart_upload", Bucket=self.bucket, Key=key, **arguments)
        return str(answer["UploadId"])

    async def held_parts(self, key: str, multipart_id: str) -> list[HeldPart] | None:
        """Return the parts that the store holds, in order, or None when it no longer knows the upload."""
        raw = await self._raw_parts(key, multipart_id)
        if raw is None:
            return None
        return [HeldPart(number=part["PartNumber"], size_bytes=part["Size"], etag=part["ETag"]) for part in raw]

    async def _raw_parts(self, key: str, multipart_id: str) -> list[dict[str, Any]] | None:
        parts: list[dict[str, Any]] = []
        marker = 0
        while True:
            try:
                answer = await self._call(
                    "list_parts", Bucket=self.bucket, Key=key, UploadId=multipart_id, PartNumberMarker=marker
                )
            except StoreMissing:
                return None
            parts += answer.get("Parts", [])
            if not answer.get("IsTruncated"):
                return parts
            marker = int(answer["NextPartNumberMarker"])

    def sign_part(self, target: PartTarget, *, expires_s: float) -> Signed:
        """Return where a client puts one part. Length and checksum (hex) are signed: other bytes are refused.

        The address of a whole object is good for one write where the store can promise that, so that it cannot be used
        to replace what was proven meanwhile. A part's dies with its multipart upload.
        """
        checksum = base64.b64encode(bytes.fromhex(target.checksum)).decode()
        headers = {_HEADERS[self.checksum]: checksum, "Content-Length": str(target.size_bytes)}
        query = {}
        if target.multipart_id is not None:
            query = {"uploadId": target.multipart_id, "partNumber": str(target.number)}
        elif self.abilities.writes_once:
            headers["If-None-Match"] = "*"
        url = self._signers.public.sign("PUT", target.key, query=query, headers=headers, expires_s=expires_s)
        return Signed(url, headers)

    async def complete_multipart(self, key: str, multipart_id: str, *, crc64nvme: bytes) -> None:
        """Join the parts; the store compares the whole object's CRC-64/NVME where it can.

        Raises:
            StoreMissing: the store does not know this upload; it may have been completed before.
            StoreRefused: parts are missing or the checksum differs; no object came to be and the parts are still there.
        """
        parts = await self._raw_parts(key, multipart_id)
        if parts is None:
            raise StoreMissing(multipart_id)
        listing: list[dict[str, Any]] = [{"PartNumber": part["PartNumber"], "ETag": part["ETag"]} for part in parts]
        arguments: dict[str, Any] = {}
        if self.checksum is ChecksumKind.crc64nvme:
            arguments = {"ChecksumCRC64NVME": base64.b64encode(crc64nvme).decode(), "ChecksumType": "FULL_OBJECT"}
        elif self.checksum is ChecksumKind.sha256:
            for entry, part in zip(listing, parts, strict=True):
                # Some stores verify it and do not list it; those that list it want it back.
                entry |= {"ChecksumSHA256": part["ChecksumSHA256"]} if "ChecksumSHA256" in part else {}
        await self._call(
            "complete_multipart_upload",
            Bucket=self.bucket,
            Key=key,
            UploadId=multipart_id,
            MultipartUpload={"Parts": listing},
            **arguments,
        )

    async def abort_multipart(self, key: str, multipart_id: str) -> None:
        """Drop a multipart upload and its parts; nothing happens where there is none."""
        try:
            await self._call("abort_multipart_upload", Bucket=self.bucket, Key=key, UploadId=multipart_id)
        except StoreMissing:
            return

    async def find(self, key: str) -> StoredObject | None:
        """Return what the store says of an object, or None where there is none."""
        try:
            answer = await self._call("head_object", Bucket=self.bucket, Key=key, ChecksumMode="ENABLED")
        except StoreMissing:
            return None
        crc = answer.get("ChecksumCRC64NVME")
        return StoredObject(key, answer["ContentLength"], base64.b64decode(crc) if crc else None)

    async def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes in bytes of all objects whose keys begin with `prefix`."""
        found: dict[str, int] = {}
        arguments: dict[str, Any] = {"Bucket": self.bucket, "Prefix": prefix}
        while True:
            answer = await self._call("list_objects_v2", **arguments)
            found |= {entry["Key"]: entry["Size"] for entry in answer.get("Contents", [])}
            if not answer.get("IsTruncated"):
                return found
            arguments["ContinuationToken"] = answer["NextContinuationToken"]

    async def open_multiparts(self, prefix: str) -> list[tuple[str, str]]:
        """Return key and id of the multipart uploads under way whose keys begin with `prefix`."""
        answer = await self._call("list_multipart_uploads", Bucket=self.bucket, Prefix=prefix)
        return [(entry["Key"], entry["UploadId"]) for entry in answer.get("Uploads", [])]

    def sign_read(self, key: str, *, path: str, expires_s: float) -> str:
        """Return where a client reads an object, whole or by ranges; a browser saves it under the file's name."""
        quoted = file_name(path).encode("ascii", "replace").decode().replace('"', "_").replace("?", "_")
        query = {"response-content-disposition": f'attachment; filename="{quoted}"'}
        return self._signers.public.sign("GET", key, query=query, headers={}, expires_s=expires_s)

    def sign_internal_read(self, key: str, *, expires_s: float) -> str:
        """Return where a process of this server, without credentials, reads an object by ranges."""
        return self._signers.internal.sign("GET", key, query={}, headers={}, expires_s=expires_s)

    async def read(self, key: str) -> AsyncIterator[bytes]:
        """Stream an object in pieces of at most 1 MiB.

        Raises:
            FileNotFoundError: the store has no such object.
            StoreUnavailable: the store does not answer, or stops in the middle.
        """
        try:
            answer = await self._call("get_object", Bucket=self.bucket, Key=key)
        except StoreMissing:
            raise FileNotFoundError(key) from None
        async with answer["Body"] as body:
            try:
                while piece := await body.read(READ_BYTES):
                    yield piece
            except (HttpError, BotoCoreError, asyncio.TimeoutError, OSError) as error:
                raise StoreUnavailable(reason=f"reading stopped: {type(error).__name__}") from error

    async def put_small(self, key: str, body: bytes, **arguments: str) -> None:
        """Write a small object of the server's own.

        Raises:
            StoreRefused: the store would not take it.
        """
        await self._call("put_object", Bucket=self.bucket, Key=key, Body=body, **arguments)

    async def put_small_part(self, key: str, multipart_id: str, body: bytes) -> None:
        """Write one small part of the server's own.

        Raises:
            StoreRefused: the store would not take it.
        """
        await self._call("upload_part", Bucket=self.bucket, Key=key, UploadId=multipart_id, PartNumber=1, Body=body)

    def proving_by(self, checksum: ChecksumKind) -> "Storage":
        """Return the same store, asked for another kind of proof."""
        return Storage(self._client, self._signers, self.bucket, replace(self.abilities, checksum=checksum))

    def with_abilities(self, abilities: Abilities) -> "Storage":
        """Return the same store, of which more is known."""
        return Storage(self._client, self._signers, self.bucket, abilities)

    async def delete(self, key: str) -> None:
        """Delete an object; nothing happens where there is none."""
        await self._call("delete_object", Bucket=self.bucket, Key=key)

    async def _call(self, operation: str, **arguments: Any) -> dict[str, Any]:
        try:
            answer: dict[str, Any] = await getattr(self._client, operation)(**arguments)
        except ClientError as error:
            raise _refusal(error, operation) from error
        except (BotoCoreError, HttpError, asyncio.TimeoutError, OSError) as error:
            raise StoreUnavailable(reason=f"{operation}: {type(error).__name__}") from error
        return answer


# What a store says when the request itself is at fault. Everything else may go better another time.
_REFUSALS = frozenset(
    {"InvalidPart", "InvalidPartOrder", "EntityTooSmall", "EntityTooLarge", "InvalidRequest", "InvalidArgument"}
    | {"BadRequest", "NotImplemented", "PreconditionFailed", "MalformedXML"}
)
_DIGESTS = frozenset({"BadDigest", "InvalidDigest", "XAmzContentChecksumMismatch"})
_MISSING = frozenset({"NoSuchKey", "NoSuchUpload"})


def _refusal(error: ClientError, operation: str) -> Exception:
    code = str(error.response["Error"].get("Code", "unknown"))
    status = int(error.response["ResponseMetadata"].get("HTTPStatusCode", 500))
    if operation != "head_bucket" and (code in _MISSING or (operation == "head_object" and status == 404)):
        return StoreMissing(operation)
    if code in _DIGESTS or code in _REFUSALS:
        words = f"{operation}: {code}: {error.response['Error'].get('Message', '')}"
        return StoreRefused(words, is_digest=code in _DIGESTS)
    return StoreUnavailable(reason=f"{operation}: {code}")


@asynccontextmanager
async def open_storage(settings: Settings) -> AsyncIterator[Storage]:
    """Open the store for the life of a process. What it can do is for the probe to find out, or stands in each row."""
    signers = Signers(Presigner(settings, settings.store_public_url), Presigner(settings, settings.s3_internal_url))
    opening = get_session().create_client(
        "s3",
        endpoint_url=settings.s3_internal_url,
        region_name=settings.s3_region,
        aws_access_key_id=settings.s3_access_key,
        aws_secret_access_key=settings.s3_secret_key.get_secret_value(),
        verify=str(settings.s3_ca_file) if settings.s3_ca_file else None,
        config=AioConfig(
            signature_version="s3v4",
            s3={"addressing_style": "path"},
            request_checksum_calculation="when_required",
            response_checksum_validation="when_required",
            connect_timeout=5,
            read_timeout=60,
            max_pool_connections=32,
            retries={"max_attempts": 3, "mode": "standard"},
        ),
    )
    async with opening as client:
        yield Storage(client, signers, settings.s3_bucket, Abilities(ChecksumKind.md5, writes_once=False))
