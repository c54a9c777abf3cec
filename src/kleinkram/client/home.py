"""What somebody finds when they come, for programs."""

from kleinkram.client._http import Api
from kleinkram.contract.home import HomeRead


class Home:
    """`client.home`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def get(self) -> HomeRead:
        """Return recent missions, your unfinished uploads, what needs attention, and what is stored."""
        return self._api.get("/home", HomeRead)
