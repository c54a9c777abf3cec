"""What a server says of itself, for programs."""

import datetime

from kleinkram.client._http import Api
from kleinkram.contract.people import ServiceRead


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
