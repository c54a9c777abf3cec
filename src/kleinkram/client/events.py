"""What changes on the server, as it changes, for programs that show it or wait for it."""

import time
from collections.abc import Iterator

from kleinkram.client._http import Api
from kleinkram.contract.events import Change, Refetch

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
