"""A bucket as a place for backups, or as a store that is filled again. Its keys and address come by the environment.

Every part carries its MD5, which every store compares; what was not completed is never seen under its name.
"""

import base64
import contextlib
import hashlib
from collections.abc import AsyncGenerator, AsyncIterator, Iterator
from contextlib import aclosing, asynccontextmanager
from datetime import datetime
from pathlib import Path
from xml.sax.saxutils import escape

from pydantic import Field, SecretStr, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from kleinkram.contract.uploads import part_size_bytes
from kleinkram.server.backup.failing import CannotBeMeant, CannotWrite, Unreachable
from kleinkram.server.backup.shelf import Item
from kleinkram.server.environment import SettingsInvalid, secret_from_file
from kleinkram.server.s3.client import (
    CONNECTION_ERRORS,
    S3Client,
    S3Error,
    S3Request,
    describe_connection_error,
    open_s3,
)
from kleinkram.server.s3.signing import Presigner
from kleinkram.server.settings import Settings

_NAMESPACE = "http://s3.amazonaws.com/doc/2006-03-01/"
_REFUSED = frozenset({"AccessDenied", "QuotaExceeded", "EntityTooLarge", "InvalidRequest", "XMinioStorageFull"})


class BucketSettings(BaseSettings):
    """How the bucket for backups is reached; names in the environment: `KLEINKRAM_BACKUP_` and the name in capitals."""

    model_config = SettingsConfigDict(
        env_prefix="KLEINKRAM_BACKUP_", frozen=True, extra="ignore", hide_input_in_errors=True
    )

    s3_url: str = Field(description="The store's address.")
    s3_region: str = Field("us-east-1", description="The region that signatures name.")
    s3_access_key: str = Field(description="Access key of an identity that may read, write, list and delete.")
    s3_secret_key: SecretStr = Field(description="Its secret key.")
    s3_ca_file: Path | None = Field(None, description="Certificate authority of the store, where it is a private one.")


class BucketShelf:
    """Objects of one bucket whose keys begin with a prefix."""

    def __init__(self, s3: S3Client, name: str, prefix: str = "") -> None:
        self._s3 = s3
        self._name = name
        self._prefix = prefix

    @property
    def name(self) -> str:
        """Its address, as it was given."""
        return self._name

    async def put(self, path: str, pieces: AsyncIterator[bytes], size_bytes: int) -> None:
        """Write an object: at once where it fits into a part, else in parts that are joined at the end."""
        part_bytes = part_size_bytes(size_bytes)
        parts = _cut(pieces, part_bytes)
        first = await anext(parts)
        with self._explained("write"):
            if len(first) < part_bytes:
                await self._s3.request(S3Request("PUT", self._prefix + path, {}, _digest(first), first))
            else:
                await self._put_parts(self._prefix + path, first, parts)

    async def _put_parts(self, key: str, first: bytes, parts: AsyncIterator[bytes]) -> None:
        multipart_id = (await self._s3.request(S3Request("POST", key, {"uploads": ""}))).text("UploadId")
        if not multipart_id:
            raise CannotWrite(f"{self._name} begins no multipart upload: it gave no id.")
        try:
            tags = [await self._put_part(key, multipart_id, 1, first)]
            async for part in parts:
                if part:
                    tags.append(await self._put_part(key, multipart_id, len(tags) + 1, part))
            listing = "".join(
                f"<Part><PartNumber>{number}</PartNumber><ETag>{escape(tag)}</ETag></Part>"
                for number, tag in enumerate(tags, 1)
            )
            body = f'<CompleteMultipartUpload xmlns="{_NAMESPACE}">{listing}</CompleteMultipartUpload>'.encode()
            await self._s3.request(S3Request("POST", key, {"uploadId": multipart_id}, {}, body))
        except BaseException:
            # Nothing is to be read of it, and nobody else would remove its parts.
            with contextlib.suppress(S3Error, *CONNECTION_ERRORS):
                await self._s3.request(S3Request("DELETE", key, {"uploadId": multipart_id}))
            raise

    async def _put_part(self, key: str, multipart_id: str, number: int, part: bytes) -> str:
        query = {"uploadId": multipart_id, "partNumber": str(number)}
        return (await self._s3.request(S3Request("PUT", key, query, _digest(part), part))).headers["etag"]

    async def read(self, path: str) -> AsyncGenerator[bytes, None]:
        """Yield an object's bytes."""
        with self._explained("read"):
            async with aclosing(self._s3.stream(S3Request("GET", self._prefix + path))) as pieces:
                async for piece in pieces:
                    yield piece

    async def listed(self, prefix: str) -> AsyncGenerator[Item, None]:
        """Yield objects, a page of the list at a time."""
        query = {"list-type": "2", "prefix": self._prefix + prefix}
        token = ""
        while True:
            with self._explained("list"):
                page = {**query, "continuation-token": token} if token else query
                answer = await self._s3.request(S3Request("GET", query=page))
            for entry in answer.entries("Contents"):
                at = datetime.fromisoformat(entry["LastModified"].replace("Z", "+00:00")).timestamp()
                yield Item(entry["Key"].removeprefix(self._prefix), int(entry["Size"]), at)
            before, token = token, answer.text("NextContinuationToken")
            if answer.text("IsTruncated") != "true":
                return
            if token in {"", before}:
                raise Unreachable(f"{self._name} does not say where its list goes on.")

    async def size_bytes(self, path: str) -> int | None:
        """Return an object's size, None where there is none."""
        try:
            with self._explained("ask"):
                answer = await self._s3.request(S3Request("HEAD", self._prefix + path))
        except FileNotFoundError:
            return None
        return int(answer.headers["content-length"])

    async def delete(self, path: str) -> None:
        """Remove an object."""
        with self._explained("delete"), contextlib.suppress(FileNotFoundError):
            await self._s3.request(S3Request("DELETE", self._prefix + path))

    async def settle(self) -> None:
        """Do nothing: what a store has acknowledged, it has."""

    async def tidy(self) -> None:
        """Abort multipart uploads that were left open."""
        with self._explained("list"):
            answer = await self._s3.request(S3Request("GET", query={"uploads": "", "prefix": self._prefix}))
            for entry in answer.entries("Upload"):
                with contextlib.suppress(FileNotFoundError):
                    await self._s3.request(S3Request("DELETE", entry["Key"], {"uploadId": entry["UploadId"]}))

    @contextlib.contextmanager
    def _explained(self, what: str) -> Iterator[None]:
        """Say what a store means; an object that is not there is for the caller to name."""
        try:
            yield
        except S3Error as error:
            if error.status == 404 and what != "write" and error.code != "NoSuchBucket":
                raise FileNotFoundError(self._name) from None
            kind = CannotWrite if what == "write" and error.code in _REFUSED else Unreachable
            raise kind(f"{self._name} would not {what}: {error.code}: {error.message or 'no reason given'}.") from error
        except CONNECTION_ERRORS as error:
            raise Unreachable(
                f"{self._name} does not answer ({describe_connection_error(error)}): run it again when it does."
            ) from error


@asynccontextmanager
async def open_bucket(address: str) -> "AsyncGenerator[BucketShelf, None]":
    """Open `s3://bucket/prefix` for the life of a command.

    Raises:
        CannotBeMeant: there is no bucket in it, or the environment does not say how to get there.
    """
    bucket, _, prefix = address.removeprefix("s3://").strip("/").partition("/")
    if not bucket:
        raise CannotBeMeant(f"{address} names no bucket: write s3://bucket or s3://bucket/folder.")
    try:
        names = ("s3_access_key", "s3_secret_key")
        read = {name: secret_from_file(f"KLEINKRAM_BACKUP_{name.upper()}") for name in names}
        secrets = {name: value for name, value in read.items() if value is not None}
        given = BucketSettings(**secrets)  # type: ignore[arg-type]  # validated; the rest is read from the environment
    except SettingsInvalid as error:
        raise CannotBeMeant(str(error)) from None
    except ValidationError as error:
        missing = ", ".join(f"KLEINKRAM_BACKUP_{str(each['loc'][0]).upper()}" for each in error.errors())
        raise CannotBeMeant(f"{address} is reached by settings in the environment: set {missing}.") from None
    settings = Settings.model_construct(
        s3_internal_url=given.s3_url,
        s3_bucket=bucket,
        s3_region=given.s3_region,
        s3_access_key=given.s3_access_key,
        s3_secret_key=given.s3_secret_key,
        s3_ca_file=given.s3_ca_file,
    )
    async with open_s3(settings, Presigner(settings, given.s3_url)) as s3:
        yield BucketShelf(s3, address, f"{prefix}/" if prefix else "")


@asynccontextmanager
async def open_site_bucket(settings: Settings) -> "AsyncGenerator[BucketShelf, None]":
    """Open the site's own bucket, to fill it."""
    async with open_s3(settings, Presigner(settings, settings.s3_internal_url)) as s3:
        yield BucketShelf(s3, f"the bucket {settings.s3_bucket} at {settings.s3_internal_url}")


async def _cut(pieces: AsyncIterator[bytes], part_bytes: int) -> AsyncGenerator[bytes, None]:
    """Yield parts of exactly `part_bytes`, then what is left, be it empty."""
    held = bytearray()
    async for piece in pieces:
        held += piece
        while len(held) >= part_bytes:
            yield bytes(held[:part_bytes])
            del held[:part_bytes]
    yield bytes(held)


def _digest(body: bytes) -> dict[str, str]:
    return {"Content-MD5": base64.b64encode(hashlib.md5(body, usedforsecurity=False).digest()).decode()}
