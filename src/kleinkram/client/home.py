"""What somebody finds when they come, for programs."""

from kleinkram.client._http import Api
from kleinkram.contract.home import HomeRead, HomeStorage


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
