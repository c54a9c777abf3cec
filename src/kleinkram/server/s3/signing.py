"""Presigned URLs for one bucket and its objects: AWS Signature Version 4 in the query, without any request.

Every part of an upload needs a URL, so signing must be fast; a test compares it with an S3 library. The body is never
signed: where the bytes must match, a checksum header is among the signed headers.

Source: AWS General Reference, "Authenticating Requests: Using Query Parameters (AWS Signature Version 4)".
"""

import datetime
import hashlib
import hmac
import logging
from collections.abc import Mapping
from email.utils import parsedate_to_datetime
from functools import lru_cache
from urllib.parse import quote, urlsplit

from kleinkram.server.settings import Settings

_log = logging.getLogger("kleinkram.signing")
_ALGORITHM = "AWS4-HMAC-SHA256"
# A Date header has whole seconds and arrives some time after it was written; stores accept minutes of difference.
_TOLERANCE = datetime.timedelta(seconds=20)
_DEFAULT_PORTS = {"http": 80, "https": 443}


class StoreClock:
    """The store's time, learned from its Date headers: the store checks signatures by its own clock."""

    def __init__(self) -> None:
        self._offset = datetime.timedelta(0)

    def now(self) -> datetime.datetime:
        """Return the time at the store (aware)."""
        return datetime.datetime.now(datetime.timezone.utc) + self._offset

    @property
    def offset_s(self) -> float:
        """Seconds by which the store's clock is ahead of ours; 0 within the tolerance."""
        return self._offset.total_seconds()

    def adjust(self, date_header: str | None) -> bool:
        """Compare with a Date header; return whether the estimate changed."""
        try:
            store_time = parsedate_to_datetime(date_header) if date_header else None
        except ValueError:  # a proxy's invention
            store_time = None
        if store_time is None or store_time.tzinfo is None or abs(store_time - self.now()) <= _TOLERANCE:
            return False
        self._offset = store_time - datetime.datetime.now(datetime.timezone.utc)
        if abs(self._offset) <= _TOLERANCE:
            self._offset = datetime.timedelta(0)
            _log.info("the clocks of this server and of the store agree again")
            return True
        _log.warning(
            "the clocks of this server and of the store differ: URLs are signed by the store's; synchronise both (NTP)",
            extra={"fields": {"store_ahead_s": round(self._offset.total_seconds())}},
        )
        return True


class Presigner:
    """Signs URLs as one identity, for one address of the store. Caches the signing key of the day."""

    def __init__(self, settings: Settings, url: str, clock: StoreClock | None = None) -> None:
        self.clock = clock or StoreClock()
        # In lower case, as it is signed: not every HTTP client lowers the host name.
        parts = urlsplit(url.rstrip("/"))
        parts = parts._replace(netloc=parts.netloc.lower())
        self._origin = f"{parts.scheme}://{parts.netloc}"
        self._path = f"{parts.path}/{settings.s3_bucket}/"
        # HTTP clients send the port only if it is not the default one.
        is_default_port = parts.port in {None, _DEFAULT_PORTS.get(parts.scheme)}
        self._host = parts.netloc.rpartition(":")[0] if is_default_port and parts.port else parts.netloc
        self._region = settings.s3_region
        self._access_key = settings.s3_access_key
        self._secret_key = settings.s3_secret_key.get_secret_value()
        self._key_of_day = ("", b"")

    def sign(
        self,
        method: str,
        key: str,
        *,
        query: Mapping[str, str],
        headers: Mapping[str, str],
        expires_s: float,
        at: datetime.datetime | None = None,
    ) -> str:
        """Return a URL for one kind of request to the object `key` (empty: the bucket), sent with exactly `headers`.

        It is valid for `expires_s` from `at` (aware; by default now, by the store's clock).
        """
        time = (at or self.clock.now()).strftime("%Y%m%dT%H%M%SZ")
        scope = f"{time[:8]}/{self._region}/s3/aws4_request"
        signed_headers = {"host": self._host, **{name.lower(): value.strip() for name, value in headers.items()}}
        names = ";".join(sorted(signed_headers))
        parameters = {
            **query,
            "X-Amz-Algorithm": _ALGORITHM,
            "X-Amz-Credential": f"{self._access_key}/{scope}",
            "X-Amz-Date": time,
            "X-Amz-SignedHeaders": names,
            "X-Amz-Expires": str(round(expires_s)),
        }
        path = quote(self._path + key, safe="/~")
        pairs = sorted((_quoted(name), _quoted(value)) for name, value in parameters.items())
        canonical_query = "&".join(f"{name}={value}" for name, value in pairs)
        canonical_headers = "".join(f"{name}:{signed_headers[name]}\n" for name in sorted(signed_headers))
        canonical_request = f"{method}\n{path}\n{canonical_query}\n{canonical_headers}\n{names}\nUNSIGNED-PAYLOAD"
        digest = hashlib.sha256(canonical_request.encode()).hexdigest()
        string_to_sign = f"{_ALGORITHM}\n{time}\n{scope}\n{digest}"
        signature = hmac.digest(self._signing_key(time[:8]), string_to_sign.encode(), "sha256").hex()
        return f"{self._origin}{path}?{canonical_query}&X-Amz-Signature={signature}"

    def _signing_key(self, day: str) -> bytes:
        cached_day, key = self._key_of_day
        if cached_day != day:
            key = f"AWS4{self._secret_key}".encode()
            for step in (day, self._region, "s3", "aws4_request"):
                key = hmac.digest(key, step.encode(), "sha256")
            self._key_of_day = (day, key)
        return key


@lru_cache(maxsize=1024)  # most of one URL is in the next one too
def _quoted(text: str) -> str:
    return quote(text, safe="~")
