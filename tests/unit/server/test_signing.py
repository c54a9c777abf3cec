"""Presigned URLs are equal to those of the S3 library."""

import asyncio
import datetime
from email.utils import format_datetime
from urllib.parse import parse_qs, urlsplit

import pytest
from aiobotocore.config import AioConfig
from aiobotocore.session import get_session

from kleinkram.server.s3.signing import Presigner, StoreClock
from kleinkram.server.settings import Settings

STORES = (
    "http://127.0.0.1:9333",
    "https://lab.example.org/s3/",
    "https://[::1]:8443",
    "http://Lab:80",
    "https://lab:80",
)
REQUESTS = [
    (
        "put_object",
        {"ContentLength": 5, "ChecksumCRC64NVME": "+/v7+/v7+/s=", "IfNoneMatch": "*"},
        {},
        {"Content-Length": "5", "x-amz-checksum-crc64nvme": "+/v7+/v7+/s=", "If-None-Match": "*"},
    ),
    (
        "upload_part",
        {"ContentLength": 0, "ContentMD5": "MD5/+==", "UploadId": "an/id+1~ x", "PartNumber": 7},
        {"uploadId": "an/id+1~ x", "partNumber": "7"},
        {"Content-Length": "0", "Content-MD5": "MD5/+=="},
    ),
    (
        "get_object",
        {"ResponseContentDisposition": 'attachment; filename="a_ b&c+=%.bag"'},
        {"response-content-disposition": 'attachment; filename="a_ b&c+=%.bag"'},
        {},
    ),
    ("get_object", {}, {}, {}),
]


def _settings(store: str) -> Settings:
    shown = {"database_url": "postgresql://a@b/c", "s3_internal_url": store, "s3_bucket": "buck-et"}
    return Settings.model_validate({**shown, "s3_access_key": "AK/ID+", "s3_secret_key": "se/cr+et"})


async def _by_library(store: str, operation: str, parameters: dict[str, object], key: str) -> str:
    client = get_session().create_client(
        "s3",
        endpoint_url=store,
        region_name="us-east-1",
        aws_access_key_id="AK/ID+",
        aws_secret_access_key="se/cr+et",
        config=AioConfig(
            signature_version="s3v4",
            s3={"addressing_style": "path"},
            request_checksum_calculation="when_required",
        ),
    )
    async with client as s3:
        requested = {"Bucket": "buck-et", "Key": key, **parameters}
        return str(await s3.generate_presigned_url(operation, Params=requested, ExpiresIn=900))


@pytest.mark.parametrize("store", STORES)
@pytest.mark.parametrize(("operation", "parameters", "query", "headers"), REQUESTS)
def test_the_library_signs_the_same(
    store: str, operation: str, parameters: dict[str, object], query: dict[str, str], headers: dict[str, str]
) -> None:
    key = "batch/a b+c~%é.bin"
    theirs = urlsplit(asyncio.run(_by_library(store, operation, parameters, key)))
    shown = parse_qs(theirs.query, strict_parsing=True)
    at = datetime.datetime.strptime(shown["X-Amz-Date"][0], "%Y%m%dT%H%M%S%z")
    method = "GET" if operation == "get_object" else "PUT"
    url = Presigner(_settings(store), store).sign(method, key, query=query, headers=headers, expires_s=900, at=at)
    ours = urlsplit(url)
    assert (ours.scheme, ours.netloc, ours.path) == (theirs.scheme, theirs.netloc.lower(), theirs.path)
    assert parse_qs(ours.query, strict_parsing=True) == shown


def test_the_key_of_one_day_does_not_sign_the_next() -> None:
    store = STORES[0]
    signer = Presigner(_settings(store), store)
    days = [datetime.datetime(2026, 12, 31 - back, 23, 59, tzinfo=datetime.timezone.utc) for back in (1, 0, 1)]

    def sign(signer: Presigner, at: datetime.datetime) -> str:
        return signer.sign("GET", "a/b", query={}, headers={}, expires_s=60, at=at)

    assert [sign(signer, at) for at in days] == [sign(Presigner(_settings(store), store), at) for at in days]


def test_addresses_are_signed_for_the_time_at_the_store() -> None:
    store, clock = STORES[0], StoreClock()
    signer = Presigner(_settings(store), store, clock)

    def says(ahead: datetime.timedelta) -> str:
        return format_datetime(datetime.datetime.now(datetime.timezone.utc) + ahead, usegmt=True)

    def ahead() -> datetime.timedelta:
        shown = parse_qs(urlsplit(signer.sign("GET", "a", query={}, headers={}, expires_s=60)).query)["X-Amz-Date"][0]
        signed = datetime.datetime.strptime(shown, "%Y%m%dT%H%M%S%z")
        return signed - datetime.datetime.now(datetime.timezone.utc)

    second, hour = datetime.timedelta(seconds=1), datetime.timedelta(hours=1)
    assert not clock.adjust(says(3 * second)), "what an answer takes to come is no difference"
    for away in (hour, -hour):
        assert clock.adjust(says(away))
        assert not clock.adjust(says(away)), "it is known by now"
        assert abs(ahead() - away) < 3 * second
    for nothing in (None, "", "yesterday", "Mon, 99 Feb 2026 00:00:00 GMT"):
        assert not clock.adjust(nothing)
    assert clock.adjust(says(0 * second))
    assert abs(ahead()) < 3 * second
