"""Signed addresses of one bucket and its objects: AWS Signature Version 4 in the query. Asks nobody, and is fast.

Every part that anybody sends needs an address. A test holds this and an S3 library to the same answer. Never signs the
body: where bytes must be the stated ones, a checksum header is among the signed headers.

Source: AWS General Reference, "Authenticating Requests: Using Query Parameters (AWS Signature Version 4)".
"""

import datetime
import hashlib
import hmac
from collections.abc import Mapping
from urllib.parse import quote, urlsplit

from kleinkram.server.settings import Settings

_ALGORITHM = "AWS4-HMAC-SHA256"
_DEFAULT_PORTS = {"http": 80, "https": 443}


class Presigner:
    """Signs addresses of objects as one identity, at one address of the store. Keeps the signing key of the day."""

    def __init__(self, settings: Settings, url: str) -> None:
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

        It is good for `expires_s` from `at` (aware; by default now).
        """
        time = (at or datetime.datetime.now(datetime.timezone.utc)).strftime("%Y%m%dT%H%M%SZ")
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
        pairs = sorted((quote(name, safe="~"), quote(value, safe="~")) for name, value in asked.items())
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
