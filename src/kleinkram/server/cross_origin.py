"""Which pages may talk to the store: ours send and fetch, a viewer's fetch. Who may do what, signatures decide alone.

Browsers let no page talk to another place than its own unless that place agrees (CORS). So the store is told so when
the API starts, and asked as a browser would ask whether it does.
"""

import logging
from collections.abc import Collection
from xml.sax.saxutils import escape

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.settings import Settings
from kleinkram.server.storage import Storage, StoreRefused

_log = logging.getLogger("kleinkram.store")
# What pages read of an answer beside its body: checksum of a part, and which bytes of how many came.
_TOLD = ("ETag", "Content-Length", "Content-Range", "Accept-Ranges")
_GOOD_FOR_S = 3600


async def open_to_pages(storage: Storage, settings: Settings) -> bool:
    """Tell the store that pages may talk to it, unless that is left to others; return whether ours then may.

    A store that does not let itself be told is used all the same: only browsers cannot send and fetch.
    """
    reason = "somebody else is to write the CORS rules of its bucket (KLEINKRAM_S3_CORS=leave)"
    if settings.s3_cors == "set":
        reason = "it took the CORS rules of its bucket, and does not keep to them"
        viewers = {each.origin for each in settings.viewers} - {settings.public_origin}
        try:
            await storage.set_cross_origin(cors_document(settings.public_origin, viewers))
        except (StoreRefused, StoreUnavailable) as error:
            reason = str(error)
    may_send = await storage.lets_page(settings.public_origin, "PUT")
    if not may_send:
        _log.warning(
            "the store lets no page of ours send: uploads by browser will fail; see docs/running.md, browsers",
            extra={"fields": {"origin": settings.public_origin, "reason": reason}},
        )
    return may_send


def cors_document(own: str, viewers: Collection[str]) -> bytes:
    """Return the rules of a bucket for the origin of our pages and those of viewers.

    Source: Amazon S3 API Reference, PutBucketCors.
    """
    rules = [_rule([own], ["GET", "HEAD", "PUT"])]
    if viewers:
        rules.append(_rule(sorted(viewers), ["GET", "HEAD"]))
    return f'<CORSConfiguration xmlns="http://s3.amazonaws.com/doc/2006-03-01/">{"".join(rules)}</CORSConfiguration>'.encode()


def _rule(origins: Collection[str], methods: Collection[str]) -> str:
    said = [
        *(f"<AllowedOrigin>{escape(origin)}</AllowedOrigin>" for origin in origins),
        *(f"<AllowedMethod>{method}</AllowedMethod>" for method in methods),
        "<AllowedHeader>*</AllowedHeader>",
        *(f"<ExposeHeader>{name}</ExposeHeader>" for name in _TOLD),
        f"<MaxAgeSeconds>{_GOOD_FOR_S}</MaxAgeSeconds>",
    ]
    return f"<CORSRule>{''.join(said)}</CORSRule>"
