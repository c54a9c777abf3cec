"""`klein account …`, `klein session …`, `klein token …` and `klein share …`: sign-in methods and credentials."""

import datetime
import uuid
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import Many, Subcommands, Text, argument, flag, option
from kleinkram.cli.render import Output, as_details, as_table, details, line, moment, note, plain, table
from kleinkram.cli.units import count, expiry, size
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.client.tokens import Reach, RunnerLimits
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.accounts import IdentityRead
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import FileFilter
from kleinkram.contract.names import is_id
from kleinkram.contract.tokens import ShareRead, TokenRead

app = Subcommands("Show your own account and how you sign in.")


@app.command("info")
def info(client: Client) -> Output:
    """Show your name, addresses, affiliations, and the providers that you sign in with."""
    account, identities = client.me.account(), client.me.identities()

    def show() -> None:
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
        if identities:
            table(
                ["provider", "address there", "linked", "last used", "identity"],
                [(_provider(row), row.email, row.created_at, row.last_used_at, row.id) for row in identities],
            )

    return Output({**account.model_dump(mode="json"), "identities": plain(identities)}, show)


@app.command("unlink")
def unlink(
    client: Client,
    provider: Annotated[str, argument("PROVIDER", "Name or id of the provider, as in `klein account info`.")],
    yes: options.Yes = False,
) -> Output:
    """Stop signing in with a provider. Sessions and tokens stay. The last way to sign in cannot be removed."""
    folded = provider.casefold()
    matches = [
        row
        for row in client.me.identities()
        if folded in {_provider(row).casefold(), row.issuer.casefold(), str(row.id)}
    ]
    if len(matches) > 1:
        raise InvalidInput(what=f"The provider {provider!r}", reason="you linked several of its accounts: give an id")
    if not matches:
        raise NotFound(resource_type="linked provider", ref=provider)
    name = _provider(matches[0])
    options.confirm(f"Stop signing in with {name}?", yes)
    client.me.unlink_identity(matches[0].id)
    note(f"{name} is unlinked. Browsers and tokens stay: `klein session list`, `klein token list`.")
    return Output({"unlinked": str(matches[0].id)})


def _provider(row: IdentityRead) -> str:
    return row.provider or row.issuer


session_app = Subcommands("Manage the browsers that you are signed in with.", no_args_is_help=False)


@session_app.command("list")
def list_sessions(client: Client) -> Output:
    """List the browsers that you are signed in with, latest use first."""
    return as_table(
        client.me.sessions(),
        ["session", "signed in", "last used", "until", "from", "browser"],
        lambda row: (row.id, row.created_at, row.last_used_at, row.expires_at, row.address, row.user_agent),
    )


@session_app.command("link")
def link(client: Client) -> Output:
    """Print a link that signs a browser in as the owner of `klein up`. It works once, for some minutes."""
    made = client.me.owner_link()

    def show() -> None:
        line(made.url)
        note(f"Valid once, until {moment(made.expires_at)}.")

    return Output(made, show)


@session_app.command("revoke")
def revoke_session(
    client: Client,
    session: Annotated[Text, argument("ID", "Id of the session, as in `klein session list`.")] = None,
    everywhere: Annotated[bool, flag("--all", "Sign every browser out.")] = False,
    yes: options.Yes = False,
) -> Output:
    """Sign a browser out, or all of them. Tokens stay (see `klein token revoke`)."""
    if (session is None) != everywhere:
        raise InvalidInput(what="The command", reason="specify a session or --all")
    if session is None:
        options.confirm("Sign every browser out?", yes)
        client.me.end_sessions()
    elif is_id(session):
        client.me.end_session(uuid.UUID(session))
    else:
        reason = "specify an id from `klein session list`"
        raise InvalidInput(what=f"The session {session!r}", reason=reason)
    note("Every browser is signed out." if session is None else "That browser is signed out.")
    return Output({"revoked": session or "all"})


token_app = Subcommands("Manage the tokens that scripts, robots and runners sign in with.")
Everybody = Annotated[bool, flag("--everybody", "Include those of others; for admins.")]


@token_app.command("create")
def create_token(
    client: Client,
    name: Annotated[str, argument("NAME", "Name of the token, such as its purpose.")],
    kind: Annotated[TokenKind, option("--kind", None, "Set who uses it.")] = TokenKind.personal,
    scope: Annotated[
        list[Scope] | None, option("--scope", None, "Allow this; repeatable. Default: write, for robots upload.")
    ] = None,
    project: Annotated[Many, option("--project -p", "PROJECT", "Limit it to this project; repeatable.")] = None,
    mission: Annotated[Many, option("--mission -m", "PROJECT/MISSION", "Limit it to this mission; repeatable.")] = None,
    runner: Annotated[
        uuid.UUID | None, option("--runner", "ID", "Limit it to this runner. Default: the first one that uses it.")
    ] = None,
    label: Annotated[Many, option("--label", "L", "Give the runner only runs that require L; repeatable.")] = None,
    until: options.Until = None,
    days: Annotated[int | None, option("--days", "N", "Let it expire in N days.", min=1, max=36_500)] = None,
    no_end: Annotated[bool, flag("--no-end", "Let it never expire, if the server allows that.")] = False,
) -> Output:
    """Create a token and print its secret, which is shown only once. The server sets its default end."""
    expires_at = expiry(until, days, client.service.now)
    missions = []
    for ref in mission or []:
        project_name, _, mission_name = ref.rpartition("/")
        missions.append(client.missions.get(mission_name, project=None if is_id(ref) else project_name or None).id)
    made = client.tokens.create(
        name,
        kind=kind,
        scopes=scope or None,
        reach=Reach([client.projects.get(ref).id for ref in project or []], missions),
        expires_at=expires_at,
        no_end=no_end,
        runner=RunnerLimits(runner, label or []) if runner or label else None,
    )

    def show() -> None:
        token = made.token
        line(made.secret)
        ends = f"until {token.expires_at:%Y-%m-%d %H:%M}Z" if token.expires_at else "until it is revoked"
        note(
            f"Save it now: it cannot be shown again. It allows {_scopes(token)} on {_limits(token)}, {ends}. "
            f"`klein token revoke {token.prefix}` ends it."
        )

    return Output(made, show)


@token_app.command("list")
def list_tokens(
    client: Client, everybody: Everybody = False, ended: options.Ended = False, limit: options.Limit = None
) -> Output:
    """List tokens, latest first."""
    return as_table(
        client.tokens.list(everybody=everybody, ended=ended, limit=limit),
        ["name", "begins", "kind", "scopes", "reaches", "runner", "of", "last used", "until", "revoked", "id"],
        _token_cells,
    )


@token_app.command("revoke")
def revoke_token(
    client: Client,
    ref: Annotated[str, argument("TOKEN", "Name, id, or beginning of the token.")],
    everybody: Everybody = False,
) -> Output:
    """Revoke a token, and all that were made with it, from the next request on."""
    token = client.tokens.get(ref, everybody=everybody)
    client.tokens.revoke(token.id)
    return _revoked(token)


def _revoked(revoked: TokenRead | ShareRead) -> Output:
    pairs = [("revoked", revoked.name), ("begins", revoked.prefix), ("id", revoked.id)]
    return as_details({"revoked": revoked}, pairs)


def _token_cells(row: TokenRead) -> tuple[object, ...]:
    runner = None
    if row.kind is TokenKind.runner:
        runner = (row.runner.name or str(row.runner.id)) if row.runner else "the first that uses it"
        runner += f", only {' or '.join(row.runner_labels)}" if row.runner_labels else ""
    of, prefix = row.person.name, row.prefix or None
    dates = (row.last_used_at, row.expires_at, row.revoked_at)
    return row.name, prefix, row.kind.value, _scopes(row), _limits(row), runner, of, *dates, row.id


def _scopes(token: TokenRead) -> str:
    return ", ".join(scope.value for scope in token.scopes)


def _limits(token: TokenRead) -> str:
    if token.limits is None:
        return "all runs" if token.kind is TokenKind.runner else "everything that its person may see"
    return ", ".join(f"{limit.resource_type} {limit.name or limit.id}" for limit in token.limits) or "nothing any more"


share_app = Subcommands("Manage links to a mission, or to some of its files, for people without an account.")
_DEFAULT_DAYS = 14


@share_app.command("create")
def create_share(
    client: Client,
    files: Annotated[Many, argument("FILES", "Paths, globs or ids of files. Default: all of the mission.")] = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    name: Annotated[Text, option("--name", None, "Name the link, such as by its purpose.")] = None,
    until: options.Until = None,
    days: Annotated[
        int | None, option("--days", "N", f"Let it expire in N days. Default: {_DEFAULT_DAYS}.", min=1, max=3650)
    ] = None,
) -> Output:
    """Create a link and print its address, which is shown only once. Everybody who has it can read what it shows."""
    now = client.service.now
    expires_at = expiry(until, days, now) or now() + datetime.timedelta(days=_DEFAULT_DAYS)
    target = client.missions.get(options.the_ref("mission", None, mission), project=project)
    file_ids = None
    if files:
        chosen = [client.files.get(ref).id for ref in files if is_id(ref)]
        for path in (ref for ref in files if not is_id(ref)):
            matches = [file.id for file in client.files.list(FileFilter(mission_id=target.id, path=[path]))]
            chosen += matches or [client.files.get(path, mission=target.id).id]
        file_ids = [*dict.fromkeys(chosen)]
    made = client.shares.create(target.id, name or target.name, expires_at=expires_at, file_ids=file_ids)

    def show() -> None:
        line(made.url)
        what = "all of" if file_ids is None else f"{count(len(file_ids), 'file')} of"
        note(
            f"Save it now: it cannot be shown again. It shows {what} {target.name} until "
            f"{made.share.expires_at:%Y-%m-%d %H:%M}Z; `klein share revoke {made.share.prefix}` ends it."
        )

    return Output(made, show)


@share_app.command("list")
def list_shares(
    client: Client,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    ended: options.Ended = False,
    limit: options.Limit = None,
) -> Output:
    """List the links that you can revoke, latest first, with what was downloaded by each."""
    mission_id = None if mission is None else client.missions.get(mission, project=project).id
    return as_table(
        client.shares.list(mission_id=mission_id, ended=ended, limit=limit),
        ["name", "begins", "mission", "files", "by", "until", "revoked", "last used", "fetched", "bytes", "id"],
        _share_cells,
    )


def _share_cells(row: ShareRead) -> tuple[object, ...]:
    mission = f"{row.mission.project.name}/{row.mission.name}"
    files = "all" if row.file_count is None else row.file_count
    dates = (row.expires_at, row.revoked_at, row.last_used_at)
    downloaded = (row.download_count, size(row.download_bytes))
    return row.name, row.prefix, mission, files, row.created_by.name, *dates, *downloaded, row.id


@share_app.command("revoke")
def revoke_share(
    client: Client, ref: Annotated[str, argument("LINK", "Name, id, address, or beginning of the link.")]
) -> Output:
    """Revoke a link, from the next request on."""
    share = client.shares.get(ref)
    client.shares.revoke(share.id)
    return _revoked(share)
