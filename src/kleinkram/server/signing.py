"""Signed addresses of one bucket and its objects: AWS Signature Version 4 in the query. Asks nobody, and is fast.

Every part that anybody sends needs an address. A test holds this and an S3 library to the same answer. Never signs the
body: where bytes must be the stated ones, a checksum header is among the signed headers.

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
# A date comes in whole seconds and some time after it was said; stores take signatures that are minutes off.
_TOLERATED = datetime.timedelta(seconds=20)
_DEFAULT_PORTS = {"http": 80, "https": 443}


class StoreClock:
    """What time it is at the store, as its answers tell: its clock is the one that signatures are judged by."""

    def __init__(self) -> None:
        self._ahead = datetime.timedelta(0)

    def now(self) -> datetime.datetime:
        """Return the time there, aware."""
        return datetime.datetime.now(datetime.timezone.utc) + self._ahead

    @property
    def ahead_s(self) -> float:
        """By how many seconds it is later there, as far as that is more than requests may take."""
        return self._ahead.total_seconds()

    def hear(self, date: str | None) -> bool:
        """Take note of an answer's Date; say whether it is another time there than was thought."""
        try:
            told = parsedate_to_datetime(date) if date else None
        except ValueError:  # a proxy's invention
            told = None
        if told is None or told.tzinfo is None or abs(told - self.now()) <= _TOLERATED:
            return False
        self._ahead = told - datetime.datetime.now(datetime.timezone.utc)
        if abs(self._ahead) <= _TOLERATED:
            self._ahead = datetime.timedelta(0)
            _log.info("the clocks of this server and of the store agree again")
            return True
        _log.warning(
            "the clocks of this server and of the store are apart: addresses are signed by the store's; set both (NTP)",
            extra={"fields": {"store_ahead_s": round(self._ahead.total_seconds())}},
        )
        return True


class Presigner:
    """Signs addresses of objects as one identity, at one address of the store. Keeps the signing key of the day."""

    def __init__(self, settings: Settings, url: str, clock: StoreClock | None = None) -> None:
        self.clock = clock or StoreClock()
        # In small letters, as it is signed: not every HTTP client makes a host's name so by itself.
        parts = urlsplit(url.rstrip("/"))
        parts = parts._replace(netloc=parts.netloc.lower())
        self._origin = f"{parts.scheme}://{parts.netloc}"
        self._path = f"{parts.path}/{settings.s3_bucket}/"
        # What an HTTP client sends: the port only where it is not the usual one.
        is_usual = parts.port in {None, _DEFAULT_PORTS.get(parts.scheme)}
        self._host = parts.netloc.rpartition(":")[0] if is_usual and parts.port else parts.netloc
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
        """Return an address good for one kind of request to the object `key`, which must carry exactly `headers`.

        An empty `key` is the bucket itself.

        It is good for `expires_s` from `at` (aware; by default now, by the store's clock).
        """
        time = (at or self.clock.now()).strftime("%Y%m%dT%H%M%SZ")
        scope = f"{time[:8]}/{self._region}/s3/aws4_request"
        signed = {"host": self._host, **{name.lower(): value.strip() for name, value in headers.items()}}
        names = ";".join(sorted(signed))
        asked = {
            **query,
            "X-Amz-Algorithm": _ALGORITHM,
            "X-Amz-Credential": f"{self._access_key}/{scope}",
            "X-Amz-Date": time,
            "X-Amz-SignedHeaders": names,
            "X-Amz-Expires": str(round(expires_s)),
        }
        path = quote(self._path + key, safe="/~")
        pairs = sorted((_quoted(name), _quoted(value)) for name, value in asked.items())
        text = "&".join(f"{name}={value}" for name, value in pairs)
        lines = "".join(f"{name}:{signed[name]}\n" for name in sorted(signed))
        request = hashlib.sha256(f"{method}\n{path}\n{text}\n{lines}\n{names}\nUNSIGNED-PAYLOAD".encode()).hexdigest()
        stated = f"{_ALGORITHM}\n{time}\n{scope}\n{request}"
        signature = hmac.digest(self._signing_key(time[:8]), stated.encode(), "sha256").hex()
        return f"{self._origin}{path}?{text}&X-Amz-Signature={signature}"

    def _signing_key(self, day: str) -> bytes:
        known, key = self._key_of_day
        if known != day:
            key = f"AWS4{self._secret_key}".encode()
            for step in (day, self._region, "s3", "aws4_request"):
                key = hmac.digest(key, step.encode(), "sha256")
            self._key_of_day = (day, key)
        return key


# Most of what is in an address is in the next one too.
@lru_cache(maxsize=1024)
def _quoted(text: str) -> str:
    return quote(text, safe="~")
