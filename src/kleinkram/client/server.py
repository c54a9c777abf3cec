"""SDK resources of the whole server: settings, your account, events, audit log, trash, administration."""

import datetime
import time
import uuid
from collections.abc import Iterator

from pydantic import RootModel

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, Listing, Ref, known_id, pages, resolve_one
from kleinkram.client.errors import TimedOut
from kleinkram.contract import admin
from kleinkram.contract.accounts import AccountRead, IdentityRead, MeRead, OneTimeLink, SessionRead
from kleinkram.contract.audit import AuditFilter, AuditRead, Change, Refetch
from kleinkram.contract.home import HomeRead, HomeStorage
from kleinkram.contract.people import ServiceRead
from kleinkram.contract.projects import TrashRead, TrashResourceType


class Service(ApiResource):
    """`client.service`."""

    def get(self) -> ServiceRead:
        """Return the server's version and addresses, and the caller's account."""
        return self._api.get("/service", ServiceRead)

    def now(self) -> datetime.datetime:
        """Ask the server for its time: its clock decides what has expired."""
        self.get()
        return self._api.now()


class Home(ApiResource):
    """`client.home`."""

    def get(self) -> HomeRead:
        """Return recent missions, your unfinished uploads, and what needs attention."""
        return self._api.get("/home", HomeRead)

    def storage(self) -> HomeStorage:
        """Return the sizes of the largest projects; for admins also of the store."""
        return self._api.get("/home/storage", HomeStorage)


class _Identities(RootModel[list[IdentityRead]]):
    """A short list."""


class Me(ApiResource):
    """`client.me`."""

    def get(self) -> MeRead:
        """Return the account and the scopes of the token in use; NotAuthenticated where it is not valid."""
        return self._api.get("/me", MeRead)

    def account(self) -> AccountRead:
        """Return one's own account: name, addresses, affiliations, and whether there is a password."""
        return self._api.get("/me/account", AccountRead)

    def identities(self) -> list[IdentityRead]:
        """Return the providers that one signs in by."""
        return self._api.get("/me/identities", _Identities).root

    def unlink_identity(self, identity_id: uuid.UUID) -> None:
        """Stop signing in by a provider; LastSignInMethod for the last way. Sessions, tokens and addresses stay."""
        self._api.delete(f"/me/identities/{identity_id}")

    def sign_out(self) -> None:
        """Revoke the token in use, from the next request on. Tokens made with it stay."""
        self._api.delete(f"/tokens/{self.get().credential.id}", [("made", "valid")])

    def sessions(self) -> Listing[SessionRead]:
        """Yield the browsers that one is signed in with."""
        return pages(self._api, "/me/sessions", SessionRead, [])

    def end_session(self, session_id: uuid.UUID) -> None:
        """Sign one browser out."""
        self._api.delete(f"/me/sessions/{session_id}")

    def end_sessions(self) -> None:
        """Sign every browser out. Tokens stay as they are."""
        self._api.delete("/me/sessions")

    def owner_link(self) -> OneTimeLink:
        """Return a link that signs a browser in, once, as the owner of `klein up`. It replaces an earlier one."""
        return self._api.repeat("/auth/owner-link", OneTimeLink)


_PAUSE_S = 1.0
# An id that no event has: the server answers that changes were missed.
_NOWHERE = "nowhere"


class Events(ApiResource):
    """`client.events`."""

    def follow(self, *, for_s: float | None = None) -> Iterator[Change | Refetch]:
        """Yield changes of whatever you may see, as they happen, for `for_s` seconds or until you stop.

        A change names what changed, without its new content. A lost connection is made again and nothing is left out: a
        `Refetch` says that changes were missed, or that your rights changed, so that anything may differ.
        """
        ends_at = None if for_s is None else time.monotonic() + for_s
        after: str | None = None
        while True:
            left_s = None if ends_at is None else max(0.0, ends_at - time.monotonic())
            for name, value in self._api.events("/events", after=after, for_s=left_s):
                if name == "id":
                    after = value
                elif name == "change":
                    yield self._api.parse_response(Change, "GET /events", value.encode())
                elif name == "refetch":
                    yield self._api.parse_response(Refetch, "GET /events", value.encode())
            if ends_at is not None and time.monotonic() >= ends_at:
                return
            after = after or _NOWHERE
            time.sleep(_PAUSE_S if ends_at is None else min(_PAUSE_S, max(0.0, ends_at - time.monotonic())))


class Audit(ApiResource):
    """`client.audit`."""

    def list(self, matching: AuditFilter | None = None, *, limit: int | None = None) -> Listing[AuditRead]:
        """Yield the events that match, latest first."""
        return pages(self._api, "/audit", AuditRead, query_of(matching), limit=limit)

    def export(self, matching: AuditFilter | None = None) -> Iterator[AuditRead]:
        """Yield all events that match, oldest first, as a stream; ServerUnreachable where it breaks off."""
        return self._api.stream("/audit/export", AuditRead, query_of(matching))


class Trash(ApiResource):
    """`client.trash`."""

    def list(self, resource_type: TrashResourceType | None = None) -> Listing[TrashRead]:
        """Yield what is in the trash, latest first."""
        return pages(
            self._api, "/trash", TrashRead, query_of(None, resource_type=resource_type.value if resource_type else None)
        )

    def get(self, ref: Ref, *, resource_type: TrashResourceType | None = None) -> TrashRead:
        """Return the thing in the trash with this id or name."""
        rows = self.list(resource_type)
        what = resource_type.value if resource_type else "deleted thing"
        if (resource_id := known_id(ref, what)) is not None:
            return resolve_one(what, str(resource_id), rows, name=lambda row: str(row.id), label=trash_label)
        return resolve_one(what, str(ref), rows, name=lambda row: row.name, label=trash_label)

    def restore(self, resource_type: TrashResourceType, ref: Ref) -> None:
        """Restore a deleted thing; NameTaken or FileExists where something else has its name now."""
        resource_id = known_id(ref, resource_type.value) or self.get(ref, resource_type=resource_type).id
        self._api.post(f"/trash/{resource_type.value}/{resource_id}/restore")


def trash_label(row: TrashRead) -> str:
    """Return a deleted thing as it is listed among candidates."""
    location = f"{row.location}/" if row.location else ""
    return f"{row.resource_type.value} {location}{row.name} ({row.id})"


_POLL_S = 1.0


class Admin(ApiResource):
    """`client.admin`. Everything here requires an admin with a credential of scope admin."""

    def storage(self) -> admin.AdminStorage:
        """Return the sizes of the store."""
        return self._api.get("/admin/storage", admin.AdminStorage)

    def jobs(self) -> admin.AdminJobs:
        """Return the queue, the jobs that will be retried, and those that failed permanently."""
        return self._api.get("/admin/jobs", admin.AdminJobs)

    def retry_job(self, job_id: int) -> None:
        """Requeue a job that failed permanently."""
        self._api.post(f"/admin/jobs/{job_id}/retry")

    def retry_jobs(self) -> int:
        """Requeue all jobs that failed permanently, and return how many."""
        return self._api.send("POST", "/admin/jobs/retry", admin.RetriedJobs).count

    def scrub(self) -> admin.ScrubState:
        """Return the results so far of the last comparison of the store with the database."""
        return self._api.get("/admin/scrub", admin.ScrubState)

    def begin_scrub(self, *, accept_losses: bool = False) -> admin.ScrubRead:
        """Start comparing the store with the database; return the scrub that is under way, or begins.

        Where very much is missing, a scrub marks nothing, since the store may be another one, unless `accept_losses`.
        """
        return self._api.repeat("/admin/scrub", admin.ScrubRead, admin.ScrubRequest(accept_losses=accept_losses))

    def watch_scrub(self, *, timeout_s: float) -> Iterator[admin.ScrubState]:
        """Yield the state of the last scrub, once a second, until it has ended. After TimedOut the server goes on."""
        deadline = time.monotonic() + timeout_s
        while True:
            state = self.scrub()
            yield state
            if state.last is None or state.last.ended_at is not None:
                return
            if time.monotonic() > deadline:
                raise TimedOut(what="The scrub", seconds=timeout_s)
            time.sleep(_POLL_S)

    def health(self) -> admin.AdminHealth:
        """Return the state of database, store and workers."""
        return self._api.get("/admin/health", admin.AdminHealth)

    def status(self) -> admin.AdminStatus:
        """Return whether the server is healthy, what is full and when it will be, and what needs an admin."""
        return self._api.get("/admin/status", admin.AdminStatus)

    def settings(self) -> admin.AdminSettings:
        """Return the settings in force, secrets left out."""
        return self._api.get("/admin/settings", admin.AdminSettings)
