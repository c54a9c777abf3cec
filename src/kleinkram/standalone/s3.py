"""The few S3 words a supervisor needs, in the standard library only: a client library would cost it 40 MB.

Source: AWS Signature Version 4, "Authenticating Requests: Using Query Parameters".
"""

import hashlib
import hmac
import http.client
from dataclasses import dataclass
from datetime import datetime, timezone
from urllib.parse import quote, urlencode, urlsplit


@dataclass(frozen=True)
class StoreAccess:
    """An S3 endpoint (`http://host:port`) and one identity's keys."""

    endpoint: str
    access_key: str
    secret_key: str
    region: str = "us-east-1"


def presign(access: StoreAccess, *, method: str, path: str, now: datetime, lifetime_s: int = 60) -> str:
    """The query-signed request target (path and query) for one request; `path` begins with a slash."""
    date, stamp = now.strftime("%Y%m%d"), now.strftime("%Y%m%dT%H%M%SZ")
    scope = f"{date}/{access.region}/s3/aws4_request"
    query = urlencode(
        {
            "X-Amz-Algorithm": "AWS4-HMAC-SHA256",
            "X-Amz-Credential": f"{access.access_key}/{scope}",
            "X-Amz-Date": stamp,
            "X-Amz-Expires": str(lifetime_s),
            "X-Amz-SignedHeaders": "host",
        },
        quote_via=quote,
        safe="",
    )
    target = quote(path, safe="/~")
    host = urlsplit(access.endpoint).netloc
    request = "\n".join([method, target, query, f"host:{host}", "", "host", "UNSIGNED-PAYLOAD"])
    digest = hashlib.sha256(request.encode()).hexdigest()
    key = f"AWS4{access.secret_key}".encode()
    for part in (date, access.region, "s3", "aws4_request"):
        key = hmac.new(key, part.encode(), hashlib.sha256).digest()
    signature = hmac.new(key, f"AWS4-HMAC-SHA256\n{stamp}\n{scope}\n{digest}".encode(), hashlib.sha256).hexdigest()
    return f"{target}?{query}&X-Amz-Signature={signature}"


def request(
    access: StoreAccess, method: str, path: str, *, body: bytes = b"", timeout_s: float = 5
) -> tuple[int, bytes]:
    """Send one signed request over plain HTTP; returns status and body.

    Raises:
        OSError: no connection, or no answer in time.
        http.client.HTTPException: the answer is not HTTP.
    """
    connection = http.client.HTTPConnection(urlsplit(access.endpoint).netloc, timeout=timeout_s)
    try:
        connection.request(method, presign(access, method=method, path=path, now=datetime.now(timezone.utc)), body=body)
        response = connection.getresponse()
        return response.status, response.read()
    finally:
        connection.close()


def create_bucket(access: StoreAccess, bucket: str, *, timeout_s: float = 5) -> bool:
    """Make the bucket unless it is there; returns whether it is there now."""
    return request(access, "PUT", f"/{bucket}", timeout_s=timeout_s)[0] in (200, 409)


def proves_ready(access: StoreAccess, bucket: str, *, timeout_s: float = 5) -> bool:
    """Whether bytes written to the bucket come back and can be deleted: the only readiness worth the name."""
    path, body = f"/{bucket}/.kleinkram-probe", b"probe" * 1000
    try:
        if not create_bucket(access, bucket, timeout_s=timeout_s):
            return False
        if request(access, "PUT", path, body=body, timeout_s=timeout_s)[0] != 200:
            return False
        came_back = request(access, "GET", path, timeout_s=timeout_s) == (200, body)
        return request(access, "DELETE", path, timeout_s=timeout_s)[0] in (200, 204) and came_back
    except (OSError, http.client.HTTPException):
        return False
