"""Tokens: creating, listing, revoking. Secrets leave the server once, in the response that creates them."""

import datetime
import enum
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, Select, exists, func, insert, literal, select, union_all, update

from kleinkram.contract import errors
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.base import Page
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import PersonRef
from kleinkram.contract.token_format import SecretKind
from kleinkram.contract.tokens import TokenCreate, TokenLimit, TokenMade, TokenRead, TokenRunner
from kleinkram.server.access.actor import Actor, NewSecret, new_secret
from kleinkram.server.access.rights import ensure_active_person, lock_person, require_fresh_sign_in
from kleinkram.server.access.visible import visible_missions, visible_projects
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, among
from kleinkram.server.pagination import Order, PageRequest, fetch_page
from kleinkram.server.settings import Settings
from kleinkram.server.tables import audit_event, mission, person, project, runner, session, token, token_limit

_TOKEN_ORDER = Order([token.c.created_at, token.c.id], descending=True)


class DerivedTokens(str, enum.Enum):
    """What happens to tokens that were created with a revoked token."""

    ended = "ended"
    valid = "valid"


async def create_token(db: Connection, actor: Actor, *, request: TokenCreate, settings: Settings) -> TokenMade:
    """Create a token for the actor and return it with its secret.

    Raises NotFound, Forbidden, TokenTooWide, InvalidRequest or SignInTooOld.
    """
    if Scope.admin in request.chosen_scopes:
        require_fresh_sign_in(actor, "create_token_with_the_scope_admin", within_s=settings.fresh_sign_in_s)
    if request.kind is TokenKind.runner and not actor.is_admin:
        raise errors.Forbidden(resource_type="server", operation="create a token for a runner", needs="admin rights")
    await _require_visible_limits(db, actor, request)
    expires_at = await _find_expiry(db, actor, request, settings)
    # Its scopes cannot be wider: creating tokens requires the scope that contains all.
    if actor.limits is not None and not request.is_limited:
        raise errors.TokenTooWide(reason="it is limited itself; limit the new token to what it can reach")
    token_id, secret = await issue_token(
        db, actor.person_id, request=request, expires_at=expires_at, made_by=actor.token_id
    )
    created = (await _read_tokens(db, actor, [await _get_row(db, actor, token_id)]))[0]
    shown = {"kind", "scopes", "limits", "expires_at", "prefix", "runner", "runner_labels"}
    after = created.model_dump(mode="json", include=shown)
    needs_admin = request.kind is TokenKind.runner
    await audit(db, actor, Event("token.create", "token", token_id, created.name, after=after, needs_admin=needs_admin))
    return TokenMade(token=created, secret=secret.text)


async def issue_token(
    db: Connection,
    person_id: uuid.UUID | None,
    *,
    request: TokenCreate,
    expires_at: datetime.datetime | None,
    made_by: uuid.UUID | None = None,
    approved_in: uuid.UUID | None = None,
) -> tuple[uuid.UUID, NewSecret]:
    """Insert a token for a person, created with the token `made_by`; the caller checks permissions and audits it.

    With `approved_in`, it depends on the provider account with which that session was started.

    Raises NotAuthenticated if the person was deactivated or `made_by` was revoked just now.
    """
    await ensure_active_person(db, person_id)
    revoked = select(token.c.id).where(token.c.id == made_by, token.c.revoked_at.is_not(None))
    if (await db.execute(revoked)).first() is not None:
        raise errors.NotAuthenticated(reason="the token is not valid here")
    token_id = uuid.uuid4()
    secret = new_secret(SecretKind[request.kind.name])
    await db.execute(
        insert(token).values(
            id=token_id,
            person_id=person_id,
            kind=request.kind.value,
            name=request.name,
            prefix=secret.prefix,
            secret_sha256=secret.sha256,
            scopes=[scope.value for scope in request.chosen_scopes],
            is_limited=request.is_limited,
            expires_at=expires_at,
            created_by_token_id=made_by,
            identity_id=select(session.c.identity_id).where(session.c.id == approved_in).scalar_subquery(),
            runner_id=request.runner_id,
            runner_labels=request.runner_labels,
        )
    )
    limits = [{"project_id": limit_id, "mission_id": None} for limit_id in dict.fromkeys(request.project_ids)]
    limits += [{"project_id": None, "mission_id": limit_id} for limit_id in dict.fromkeys(request.mission_ids)]
    if limits:
        await db.execute(insert(token_limit), [{"id": uuid.uuid4(), "token_id": token_id, **limit} for limit in limits])
    return token_id, secret


async def list_tokens(
    db: Connection, actor: Actor, *, person_id: uuid.UUID | None, with_ended: bool, page: PageRequest
) -> Page[TokenRead]:
    """Return a page of the tokens of a person (None: of all), latest first. Raises Forbidden or InvalidCursor."""
    if person_id != actor.person_id and not _sees_others(actor):
        raise errors.Forbidden(resource_type="server", operation="list tokens of others", needs="admin rights")
    stmt = _tokens_of(person_id)
    if not with_ended:
        is_unexpired = func.coalesce(token.c.expires_at > func.now(), True)
        stmt = stmt.where(token.c.revoked_at.is_(None), is_unexpired)
    rows = await fetch_page(db, stmt, _TOKEN_ORDER, page)
    return Page(items=await _read_tokens(db, actor, rows.items), next=rows.next, total=rows.total)


async def revoke_token(
    db: Connection, actor: Actor, *, token_id: uuid.UUID, derived: DerivedTokens = DerivedTokens.ended
) -> None:
    """Revoke a token and, recursively, those that were created with it, from the next request on.

    Any token may revoke itself; another one requires the scope admin and no limits. Raises NotFound or ScopeMissing.
    """
    if token_id != actor.token_id and Scope.admin not in actor.scopes:
        raise errors.ScopeMissing(operation="revoke another token", needs="a token with the scope `admin`")
    if token_id != actor.token_id and actor.limits is not None:
        raise errors.ScopeMissing(operation="revoke another token", needs="a token without limits")
    row = await _get_row(db, actor, token_id)
    await lock_person(db, row.person_id)
    token_ids = select(token.c.id).where(token.c.id == token_id)
    if derived is DerivedTokens.ended:
        tree = token_ids.cte("line", recursive=True)
        tree = tree.union(select(token.c.id).join(tree, token.c.created_by_token_id == tree.c.id))
        token_ids = select(tree.c.id)
    needs_admin = row.person_id != actor.person_id
    events = []
    for revoked in await _revoke(db, token_ids):
        after: Metadata = {"prefix": revoked.prefix, "person": row.person_name}
        if revoked.id != token_id:
            after["made_with"] = row.name
        events.append(Event("token.revoke", "token", revoked.id, revoked.name, after=after, needs_admin=needs_admin))
    await audit(db, actor, *events)


async def end_personal_tokens(db: Connection, actor: Actor) -> int:
    """Revoke the personal tokens that were created in the actor's name, such as by `klein login`; returns the number.

    Tokens of robots and runners stay valid, and so does the token that the server itself created for its local owner.
    """
    was_created_by_person = exists().where(
        audit_event.c.resource_id == token.c.id,
        audit_event.c.operation == "token.create",
        audit_event.c.actor_id.is_not(None),
    )
    is_own = (token.c.person_id == actor.person_id) & (token.c.kind == TokenKind.personal.value)
    revoked = await _revoke(db, select(token.c.id).where(is_own, was_created_by_person))
    events = [
        Event("token.revoke", "token", row.id, row.name, after={"prefix": row.prefix, "person": actor.name})
        for row in revoked
    ]
    await audit(db, actor, *events)
    return len(revoked)


async def _revoke(db: Connection, chosen: Select[tuple[uuid.UUID]]) -> Sequence[Row[Any]]:
    stmt = update(token).where(token.c.id.in_(chosen), token.c.revoked_at.is_(None)).values(revoked_at=func.now())
    return (await db.execute(stmt.returning(token.c.id, token.c.name, token.c.prefix))).all()


def _sees_others(actor: Actor) -> bool:
    return actor.is_admin and actor.limits is None


def _tokens_of(person_id: uuid.UUID | None) -> Select[Any]:
    columns = [column for column in token.c if column is not token.c.secret_sha256]
    names = person.c.name.label("person_name"), runner.c.name.label("runner_name")
    stmt = select(*columns, *names).join_from(token, person).outerjoin(runner, runner.c.id == token.c.runner_id)
    stmt = stmt.where(token.c.kind != TokenKind.run.value)
    return stmt if person_id is None else stmt.where(token.c.person_id == person_id)


async def _get_row(db: Connection, actor: Actor, token_id: uuid.UUID) -> Row[Any]:
    stmt = _tokens_of(None if _sees_others(actor) else actor.person_id)
    row = (await db.execute(stmt.where(token.c.id == token_id))).one_or_none()
    if row is None:
        raise errors.NotFound(resource_type="token", ref=str(token_id))
    return row


async def _read_tokens(db: Connection, actor: Actor, rows: Sequence[Row[Any]]) -> list[TokenRead]:
    limits: dict[uuid.UUID, list[TokenLimit]] = {row.id: [] for row in rows if row.is_limited}
    if limits:
        projects = visible_projects(actor).subquery("seen_project")
        missions = visible_missions(actor).with_only_columns(mission.c.id, mission.c.name).subquery("seen_mission")
        name = func.coalesce(projects.c.name, missions.c.name).label("name")
        stmt = (
            select(token_limit.c.token_id, token_limit.c.project_id, token_limit.c.mission_id, name)
            .outerjoin(projects, projects.c.id == token_limit.c.project_id)
            .outerjoin(missions, missions.c.id == token_limit.c.mission_id)
            .where(among(token_limit.c.token_id, limits))
        )
        for row in await db.execute(stmt.order_by(token_limit.c.token_id, token_limit.c.id)):
            resource_type = "project" if row.project_id else "mission"
            limit = TokenLimit(resource_type=resource_type, id=row.project_id or row.mission_id, name=row.name)
            limits[row.token_id].append(limit)
    return [
        TokenRead(
            id=row.id,
            person=PersonRef(id=row.person_id, name=row.person_name),
            name=row.name,
            kind=TokenKind(row.kind),
            prefix=row.prefix,
            scopes=[Scope(scope) for scope in row.scopes],
            limits=limits.get(row.id),
            created_at=row.created_at,
            expires_at=row.expires_at,
            last_used_at=row.last_used_at,
            revoked_at=row.revoked_at,
            runner=None if row.runner_id is None else TokenRunner(id=row.runner_id, name=row.runner_name),
            runner_labels=row.runner_labels,
        )
        for row in rows
    ]


async def _require_visible_limits(db: Connection, actor: Actor, request: TokenCreate) -> None:
    if not request.is_limited:
        return
    projects = visible_projects(actor).with_only_columns(literal("project").label("resource_type"), project.c.id)
    missions = visible_missions(actor).with_only_columns(
        literal("mission").label("resource_type"), mission.c.id, maintain_column_froms=True
    )
    stmt = union_all(
        projects.where(among(project.c.id, request.project_ids)),
        missions.where(among(mission.c.id, request.mission_ids)),
    )
    visible = {(row.resource_type, row.id) for row in await db.execute(stmt)}
    for resource_type, ids in (("project", request.project_ids), ("mission", request.mission_ids)):
        for limit_id in ids:
            if (resource_type, limit_id) not in visible:
                raise errors.NotFound(resource_type=resource_type, ref=str(limit_id))


async def _find_expiry(
    db: Connection, actor: Actor, request: TokenCreate, settings: Settings
) -> datetime.datetime | None:
    """Return when a token ends: as requested, else by the settings; never after the token it is created with."""
    creator_expiry = select(token.c.expires_at).where(token.c.id == actor.token_id).scalar_subquery()
    now, latest = (await db.execute(select(func.now(), creator_expiry))).one()
    max_days = settings.token_days_max
    # A minute of tolerance: the client computed the days a little earlier.
    longest = now + datetime.timedelta(days=max_days, minutes=1)
    if max_days and (request.no_end or (request.expires_at is not None and request.expires_at > longest)):
        message = f"a token of this server is good for {max_days} days at most (KLEINKRAM_TOKEN_DAYS_MAX)"
        field = "no_end" if request.no_end else "expires_at"
        raise errors.InvalidRequest(problems=[errors.FieldProblem(field=field, message=message)])
    if request.expires_at is not None and request.expires_at <= now:
        problem = errors.FieldProblem(field="expires_at", message="is in the past; a token must expire later than now")
        raise errors.InvalidRequest(problems=[problem])
    if request.expires_at is not None and latest is not None and request.expires_at > latest:
        raise errors.TokenTooWide(
            reason=f"the new token would outlive it; it ends at {latest.isoformat(timespec='seconds')}"
        )
    if request.expires_at is not None or request.no_end:
        return request.expires_at or latest
    days = default_days(request.kind, settings)
    default_expiry = None if days is None else now + datetime.timedelta(days=days)
    return min((end for end in (default_expiry, latest) if end is not None), default=None)


def default_days(kind: TokenKind, settings: Settings) -> int | None:
    """Return how many days a token is valid by default; None for no end."""
    most = settings.token_days_max or None
    # Runners work unattended for long, and only on their own runs.
    if kind is TokenKind.runner:
        return most
    return settings.token_days_default if most is None else min(settings.token_days_default, most)
