"""The whole server, for programs of admins."""

from kleinkram.client._http import Api
from kleinkram.contract.admin import AdminHealth, AdminJobs, AdminSettings, AdminStorage


class Admin:
    """`client.admin`. Everything here takes an admin with a credential of scope admin."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def storage(self) -> AdminStorage:
        """Return what the store keeps."""
        return self._api.get("/admin/storage", AdminStorage)

    def jobs(self) -> AdminJobs:
        """Return the queue, and the jobs that were given up."""
        return self._api.get("/admin/jobs", AdminJobs)

    def retry_job(self, job_id: int) -> None:
        """Put a job that was given up back into the queue.

        Raises:
            NotFound: there is no such job, or it was not given up.
        """
        self._api.post_empty(f"/admin/jobs/{job_id}/retry")

    def health(self) -> AdminHealth:
        """Return how database, store and workers are."""
        return self._api.get("/admin/health", AdminHealth)

    def settings(self) -> AdminSettings:
        """Return the settings in force, secrets left out."""
        return self._api.get("/admin/settings", AdminSettings)
