"""The web server, told to end its streams before it waits for requests to end: they would not end by themselves."""

import socket

import uvicorn
from fastapi import FastAPI


class ApiServer(uvicorn.Server):
    """Serves one app."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams, wait for other requests, then stop."""
        hub = getattr(self._app.state, "hub", None)
        if hub is not None:
            hub.end()
        await super().shutdown(sockets)
