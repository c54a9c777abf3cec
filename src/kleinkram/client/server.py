"""The server as a whole: its settings, the caller's account, events, the audit log, the trash and administration."""

import datetime
import time
import uuid
from collections.abc import Iterator

from pydantic import RootModel

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import Listing, Ref, known_id, pages, resolve_one
from kleinkram.client.errors import TimedOut
from kleinkram.contract.accounts import AccountRead, IdentityRead, MeRead, OneTimeLink, SessionRead
from kleinkram.contract.admin import (
    AdminHealth,
    AdminJobs,
    AdminSettings,
    AdminStorage,
    RetriedJobs,
    ScrubRead,
    ScrubRequest,
    ScrubState,
)
from kleinkram.contract.audit import AuditFilter, AuditRead, Change, Refetch
from kleinkram.contract.home import HomeRead, HomeStorage
from kleinkram.contract.people import ServiceRead
from kleinkram.contract.projects import TrashNoun, TrashRead


class Service:
    """`client.service`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def get(self) -> ServiceRead:
        """Return the server's version, addresses, and whom it takes the caller for."""
        return self._api.get("/service", ServiceRead)

    def now(self) -> datetime.datetime:
        """Return what time it is at the server, which asks it: what ends, ends by its clock."""
        self.get()
        return self._api.now()


class Home:
    """`client.home`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def get(self) -> HomeRead:
        """Return recent missions, your unfinished uploads, and what needs attention."""
        return self._api.get("/home", HomeRead)

    def storage(self) -> HomeStorage:
        """Return what the largest projects take; to admins also what the store holds."""
        return self._api.get("/home/storage", HomeStorage)


class _Identities(RootModel[list[IdentityRead]]):
    """The answer of a list that is never long."""


class Me:
    """`client.me`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def get(self) -> MeRead:
        """Return whose the token in use is, and what it is good for.

        Raises:
            NotAuthenticated: it is unknown, expired or revoked.
        """
        return self._api.get("/me", MeRead)

    def account(self) -> AccountRead:
        """Return one's own account: name, addresses, affiliations, and whether there is a password."""
        return self._api.get("/me/account", AccountRead)

    def identities(self) -> list[IdentityRead]:
        """Return under which providers' word one signs in."""
        return self._api.get("/me/identities", _Identities).root

    def unlink_identity(self, identity_id: uuid.UUID) -> None:
        """Take a provider's word for oneself no more. Sessions, tokens and addresses stay.

        Raises:
            NotFound: none of one's own has that id.
            LastSignInMethod: without it there would be no way to sign in.
        """
        self._api.delete(f"/me/identities/{identity_id}")

    def sign_out(self) -> None:
        """Revoke the token in use: from the next request on it is good for nothing. Those made with it stay.

        Raises:
            NotAuthenticated: it already was.
        """
        self._api.delete(f"/tokens/{self.get().credential.id}", [("made", "kept")])

    def sessions(self) -> Listing[SessionRead]:
        """Yield the browsers that one is signed in with."""
        return pages(self._api, "/me/sessions", SessionRead, [])

    def end_session(self, session_id: uuid.UUID) -> None:
        """Sign one browser out.

        Raises:
            NotFound: none of one's own has that id.
        """
        self._api.delete(f"/me/sessions/{session_id}")

    def end_sessions(self) -> None:
        """Sign every browser out. Tokens stay as they are."""
        self._api.delete("/me/sessions")

    def owner_link(self) -> OneTimeLink:
        """Return a link that signs a browser in, once, as the owner of `klein up`. One made before is good no more.

        Raises:
            Forbidden: the token in use is not the owner's.
        """
        return self._api.understood(OneTimeLink, "POST /auth/owner-link", self._api.post_empty("/auth/owner-link"))


# The server says something, if only that it is still there, every 15 s.
_PAUSE_S = 1.0
# After no event that there ever was: to who comes with it, the server says that changes were missed.
_NOWHERE = "nowhere"


class Events:
    """`client.events`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def follow(self, *, for_s: float | None = None) -> Iterator[Change | Refetch]:
        """Yield what changes of whatever you may see, as it changes, for `for_s` seconds or until you stop.

        Tells what changed, never what it says now. Where the connection breaks it is made again and nothing is left
        out: a `Refetch` says that changes were missed, or that your rights are others now, so that anything may differ.

        Raises:
            NotAuthenticated: the token is not good any more.
            ServerUnreachable: the server is away for longer than a restart takes.
            TooManyStreams: your account has as many streams open as it gets.
        """
        ends_at = None if for_s is None else time.monotonic() + for_s
        after: str | None = None
        while True:
            left_s = None if ends_at is None else max(0.0, ends_at - time.monotonic())
            for name, value in self._api.events("/events", after=after, for_s=left_s):
                if name == "id":
                    after = value
                elif name == "change":
                    yield self._api.understood(Change, "GET /events", value.encode())
                elif name == "refetch":
                    yield self._api.understood(Refetch, "GET /events", value.encode())
            if ends_at is not None and time.monotonic() >= ends_at:
                return
            after = after or _NOWHERE
            time.sleep(_PAUSE_S if ends_at is None else min(_PAUSE_S, max(0.0, ends_at - time.monotonic())))


class Audit:
    """`client.audit`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(self, matching: AuditFilter | None = None, *, limit: int | None = None) -> Listing[AuditRead]:
        """Yield the events that match, latest first."""
        return pages(self._api, "/audit", AuditRead, query_of(matching), limit=limit)

    def export(self, matching: AuditFilter | None = None) -> Iterator[AuditRead]:
        """Yield all events that match, oldest first, as the server sends them: of any number, few in memory.

        Raises:
            ServerUnreachable: the connection broke; what was yielded is not all.
        """
        return self._api.stream("/audit/export", AuditRead, query_of(matching))


class Trash:
    """`client.trash`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(self, noun: TrashNoun | None = None) -> Listing[TrashRead]:
        """Yield what lies in the trash, latest first."""
        return pages(self._api, "/trash", TrashRead, query_of(None, noun=noun.value if noun else None))

    def get(self, ref: Ref, *, noun: TrashNoun | None = None) -> TrashRead:
        """Return the thing in the trash with this id or name.

        Raises:
            NotFound: there is none.
            AmbiguousName: several have that name.
        """
        rows = self.list(noun)
        what = noun.value if noun else "deleted thing"
        if (noun_id := known_id(ref, what)) is not None:
            return resolve_one(what, str(noun_id), rows, name=lambda row: str(row.id), label=trash_label)
        return resolve_one(what, str(ref), rows, name=lambda row: row.name, label=trash_label)

    def restore(self, noun: TrashNoun, ref: Ref) -> None:
        """Put a deleted thing, by its id or name, back where it was.

        Raises:
            NameTaken, FileExists: something else has its name now.
            NotFound: it is not in the trash.
        """
        self._api.post_empty(f"/trash/{noun.value}/{known_id(ref, noun.value) or self.get(ref, noun=noun).id}/restore")


def trash_label(row: TrashRead) -> str:
    """Return how a deleted thing is listed among candidates."""
    return (
        f"{row.noun.value} {row.place}/{row.name} ({row.id})"
        if row.place
        else f"{row.noun.value} {row.name} ({row.id})"
    )


_POLL_S = 1.0


class Admin:
    """`client.admin`. Everything here takes an admin with a credential of scope admin."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def storage(self) -> AdminStorage:
        """Return what the store keeps."""
        return self._api.get("/admin/storage", AdminStorage)

    def jobs(self) -> AdminJobs:
        """Return the queue, the jobs that wait for another attempt, and those that were given up."""
        return self._api.get("/admin/jobs", AdminJobs)

    def retry_job(self, job_id: int) -> None:
        """Put a job that was given up back into the queue.

        Raises:
            NotFound: there is no such job, or it was not given up.
        """
        self._api.post_empty(f"/admin/jobs/{job_id}/retry")

    def retry_jobs(self) -> int:
        """Put all jobs that were given up back into the queue, and return how many."""
        return self._api.send("POST", "/admin/jobs/retry", RetriedJobs).count

    def scrub(self) -> ScrubState:
        """Return what the last comparison of the store with the database found, or has found so far."""
        return self._api.get("/admin/scrub", ScrubState)

    def begin_scrub(self, *, believe: bool = False) -> ScrubRead:
        """Have what the store lists compared with the database; return the scrub that is under way, or begins.

        Where very much is missing, a scrub marks nothing, since the store looks like another one; with `believe`,
        what is missing is marked as lost all the same.
        """
        return self._api.repeat("/admin/scrub", ScrubRead, ScrubRequest(believe=believe))

    def watch_scrub(self, *, timeout_s: float) -> Iterator[ScrubState]:
        """Yield how the last scrub stands, once a second, until it has ended.

        Raises:
            TimedOut: it took longer; the server goes on.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            state = self.scrub()
            yield state
            if state.last is None or state.last.ended_at is not None:
                return
            if time.monotonic() > deadline:
                raise TimedOut(what="The scrub", seconds=timeout_s)
            time.sleep(_POLL_S)

    def health(self) -> AdminHealth:
        """Return how database, store and workers are."""
        return self._api.get("/admin/health", AdminHealth)

    def settings(self) -> AdminSettings:
        """Return the settings in force, secrets left out."""
        return self._api.get("/admin/settings", AdminSettings)
