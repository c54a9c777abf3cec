"""`klein account …`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, Yes, confirm
from kleinkram.cli.render import details, note, plain, show_json, table
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.accounts import IdentityRead
from kleinkram.contract.errors import NotFound

app = Noun("Your own account: what you are known by, and how you sign in.")


@app.command("info")
def info(as_json: AsJson = False) -> None:
    """Show your name, addresses, affiliations, and the providers that you sign in by."""
    with connect() as client:
        account, linked = client.me.account(), client.me.identities()
    if as_json:
        show_json({**account.model_dump(mode="json"), "identities": plain(linked)})
        return
    details(
        [
            ("person", account.person.name),
            ("id", account.person.id),
            ("addresses", [address.email for address in account.addresses]),
            ("affiliations", account.affiliations),
            ("password", account.has_password),
            ("since", account.created_at),
        ]
    )
    if linked:
        table(
            ["provider", "address there", "linked", "last used", "identity"],
            [(_name(row), row.email, row.created_at, row.last_used_at, row.id) for row in linked],
        )


@app.command("unlink")
def unlink(
    provider: Annotated[
        str,
        typer.Argument(metavar="PROVIDER", show_default=False, help="Its name or id, as `klein account info` says."),
    ],
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Sign in by a provider no more. Sessions and tokens stay; the last way to sign in does too."""
    with connect() as client:
        matches = _find(provider, client.me.identities())
        confirm(f"Sign in by {_name(matches)} no more?", yes)
        client.me.unlink_identity(matches.id)
    if as_json:
        show_json({"unlinked": str(matches.id)})
    note(f"{_name(matches)} is unlinked. Browsers and tokens stay: `klein session list`, `klein token list`.")


def _name(row: IdentityRead) -> str:
    return row.provider or row.issuer


def _find(text: str, linked: list[IdentityRead]) -> IdentityRead:
    """Return the identity that somebody means.

    Raises:
        NotFound: there is none.
        InvalidInput: there are several of that provider.
    """
    folded = text.casefold()
    matches = [row for row in linked if folded in {_name(row).casefold(), row.issuer.casefold(), str(row.id)}]
    if len(matches) > 1:
        raise InvalidInput(what=f"The provider {text!r}", reason="you linked several of its accounts: give an id")
    if not matches:
        raise NotFound(noun="linked provider", ref=text)
    return matches[0]
