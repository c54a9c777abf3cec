"""The link by which the owner of `klein up` signs a browser in, asked for from the API that runs here.

The owner's token goes with the question: to this machine only, and with TLS only to who has our own certificate.
"""

import http.client
import json
from pathlib import Path
from urllib.parse import urlsplit

from kleinkram.standalone.trust import just_this


def ask_owner_link(api_url: str, token: str, *, certificate: Path | None = None, timeout_s: float = 5) -> str | None:
    """Return a link that is good once, for some minutes; None where the API does not give one.

    Raises:
        OSError: it does not answer, or with another certificate.
        http.client.HTTPException: what answers speaks no HTTP.
    """
    host = urlsplit(api_url).netloc
    connection = (
        http.client.HTTPConnection(host, timeout=timeout_s)
        if certificate is None
        else http.client.HTTPSConnection(host, timeout=timeout_s, context=just_this(certificate))
    )
    try:
        headers = {"Authorization": f"Bearer {token}", "Content-Length": "0"}
        connection.request("POST", "/api/v1/auth/owner-link", headers=headers)
        answer = connection.getresponse()
        body = answer.read(65_536)
    finally:
        connection.close()
    return None if answer.status != 200 else str(json.loads(body)["url"])
