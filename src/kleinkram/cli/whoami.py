"""`klein whoami`"""

from kleinkram import connect
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import details, show_json


def whoami(as_json: AsJson = False) -> None:
    """Say who the server in use takes you for, and what your token is good for."""
    with connect() as client:
        me, endpoint = client.me.get(), client.endpoint
    if as_json:
        show_json({**me.model_dump(mode="json"), "endpoint": endpoint.name, "url": endpoint.url})
        return
    credential = me.credential
    details(
        [
            ("person", me.person.name),
            ("e-mail", me.emails),
            ("admin", "yes" if me.is_admin else None),
            ("by", f"{credential.kind.value} token {credential.name!r}"),
            ("good for", [scope.value for scope in credential.scopes]),
            ("limited", "to certain projects or missions" if credential.is_limited else None),
            ("until", credential.expires_at),
            ("server", endpoint.url),
            ("endpoint", endpoint.name),
        ]
    )
