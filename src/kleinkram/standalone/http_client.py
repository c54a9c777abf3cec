"""HTTP requests to this machine's own API and store, with the standard library: a client library needs 40 MB."""

import http.client
import json
import ssl
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

_MAX_BODY_BYTES = 1024 * 1024
RequestError = (OSError, http.client.HTTPException)
"""What `request` raises: no connection, no response in time, or a response that is not HTTP."""


class HttpResponse(NamedTuple):
    """Status, Date header and body of a response."""

    status: int
    date: str | None
    body: bytes


def request(
    method: str,
    url: str,
    *,
    body: bytes = b"",
    headers: Mapping[str, str] | None = None,
    certificate: Path | None = None,
    timeout_s: float = 5,
) -> HttpResponse:
    """Send a request and read the response; redirects are not followed.

    `certificate`: the only one trusted. Without it, TLS is not verified: send no secrets then.

    Raises:
        OSError, http.client.HTTPException: see `RequestError`.
    """
    parts = urlsplit(url)
    if parts.scheme == "https":
        connection: http.client.HTTPConnection = http.client.HTTPSConnection(
            parts.netloc, timeout=timeout_s, context=_tls_context(certificate)
        )
    else:
        connection = http.client.HTTPConnection(parts.netloc, timeout=timeout_s)
    try:
        connection.request(
            method, (parts.path or "/") + (f"?{parts.query}" if parts.query else ""), body, headers or {}
        )
        response = connection.getresponse()
        return HttpResponse(response.status, response.headers.get("Date"), response.read(_MAX_BODY_BYTES))
    finally:
        connection.close()


def request_with_token(
    method: str,
    url: str,
    token: str,
    *,
    values: Mapping[str, str] | None = None,
    certificate: Path | None = None,
    timeout_s: float = 5,
) -> HttpResponse:
    """Send a request to the API with a token and JSON; `certificate` is required with TLS.

    Raises:
        OSError, http.client.HTTPException: see `RequestError`.
    """
    if certificate is None and not url.startswith("http://"):
        raise ValueError("A token is sent over TLS only to the instance's own certificate.")
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    body = json.dumps(values).encode() if values else b""
    return request(method, url, body=body, headers=headers, certificate=certificate, timeout_s=timeout_s)


def responds(url: str) -> bool:
    """Whether an HTTP server responds there."""
    try:
        request("GET", url, timeout_s=2)
    except RequestError:
        return False
    return True


def is_ready(base_url: str) -> bool:
    """Whether the API reports that database, store and migrations are ready."""
    try:
        return request("GET", f"{base_url}/health/ready", timeout_s=2).status == 200
    except RequestError:
        return False


def create_owner_link(api_url: str, token: str, *, certificate: Path | None = None) -> str | None:
    """Return a link that signs the owner's browser in once; None where the API refuses.

    Raises:
        OSError, http.client.HTTPException: see `RequestError`; also if the certificate is another one.
    """
    response = request_with_token("POST", f"{api_url}/api/v1/auth/owner-link", token, certificate=certificate)
    return str(json.loads(response.body)["url"]) if response.status == 200 else None


def bundle_with(certificate: Path) -> str:
    """Return the certificates that this machine trusts, and one more, as PEM."""
    default = ssl.get_default_verify_paths().cafile
    trusted = Path(default).read_text() if default and Path(default).is_file() else ""
    return trusted + "\n" + certificate.read_text()


def _tls_context(certificate: Path | None) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=str(certificate) if certificate else None)
    context.check_hostname = False
    if certificate is None:
        context.verify_mode = ssl.CERT_NONE
    else:
        context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    return context
