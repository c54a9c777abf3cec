"""The whole server, for programs of admins."""

import time
from collections.abc import Iterator

from kleinkram.client._http import Api
from kleinkram.client.errors import TimedOut
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
