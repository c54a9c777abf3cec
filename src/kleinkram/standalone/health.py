"""Asking a running API how it is, without a client library."""

import http.client
import ssl
from dataclasses import dataclass
from urllib.parse import urlsplit


@dataclass(frozen=True)
class Answer:
    """An HTTP answer: status, Date header, body."""

    status: int
    date: str | None
    body: bytes


def get(url: str, *, timeout_s: float = 2) -> Answer:
    """GET a URL and read the answer; redirects are not followed.

    Raises:
        OSError: no connection, or no answer in time.
        http.client.HTTPException: the answer is not HTTP.
    """
    parts = urlsplit(url)
    connection: http.client.HTTPConnection
    if parts.scheme == "https":
        # The caller asks for health, sends no secret and believes nothing: a certificate for another name will do.
        context = ssl.create_default_context()
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
        connection = http.client.HTTPSConnection(parts.netloc, timeout=timeout_s, context=context)
    else:
        connection = http.client.HTTPConnection(parts.netloc, timeout=timeout_s)
    try:
        connection.request("GET", parts.path or "/")
        response = connection.getresponse()
        return Answer(response.status, response.headers.get("Date"), response.read(65_536))
    finally:
        connection.close()


def answers(url: str, *, timeout_s: float = 2) -> bool:
    """Whether anything that speaks HTTP answers there."""
    try:
        get(url, timeout_s=timeout_s)
    except (OSError, http.client.HTTPException):
        return False
    return True


def is_ready(base_url: str, *, timeout_s: float = 2) -> bool:
    """Whether the API answers that database, store and migrations are all right."""
    try:
        return get(f"{base_url}/health/ready", timeout_s=timeout_s).status == 200
    except (OSError, http.client.HTTPException):
        return False
