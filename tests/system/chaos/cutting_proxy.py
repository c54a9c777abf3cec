"""A proxy that ends every connection after a fixed time, like proxies with a limit of one minute."""

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from urllib.parse import urlsplit

_PIECE_BYTES = 65_536


@dataclass
class Cutter:
    """Passes bytes on to `target`, and cuts each connection `after_s` seconds after it was made."""

    url: str
    target: tuple[str, int]
    after_s: float
    bytes_per_s: float | None
    cuts: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _free_at: float = 0.0

    def pass_on(self, near: socket.socket) -> None:
        """Serve one connection until either side ends it, or its time is over."""
        ends_at = time.monotonic() + self.after_s
        with near, socket.create_connection(self.target, timeout=10) as far, selectors.DefaultSelector() as ready:
            ready.register(near, selectors.EVENT_READ, far)
            ready.register(far, selectors.EVENT_READ, near)
            while (left_s := ends_at - time.monotonic()) > 0:
                for key, _ in ready.select(left_s):
                    piece = key.fileobj.recv(_PIECE_BYTES)  # type: ignore[union-attr]  # sockets are registered
                    if not piece:
                        return
                    self._take_time(len(piece), ends_at)
                    key.data.sendall(piece)
            with self._lock:
                self.cuts += 1

    def _take_time(self, size_bytes: int, ends_at: float) -> None:
        """Wait as long as the line, which all connections share, needs for some bytes."""
        if self.bytes_per_s is None:
            return
        with self._lock:
            now = time.monotonic()
            self._free_at = max(now, self._free_at) + size_bytes / self.bytes_per_s
            free_at = min(self._free_at, ends_at)
        time.sleep(max(0.0, free_at - now))


@contextmanager
def cutting(url: str, *, after_s: float, bytes_per_s: float | None = None) -> Iterator[Cutter]:
    """Forward a free port of this machine to an address; `bytes_per_s` is the total rate of all connections."""
    where = urlsplit(url)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        cutter = Cutter(f"http://127.0.0.1:{port}", (where.hostname or "", where.port or 80), after_s, bytes_per_s)
        over = threading.Event()
        thread = threading.Thread(target=_accept, args=(listener, cutter, over), name="cutter")
        thread.start()
        try:
            yield cutter
        finally:
            over.set()
            thread.join(20)


def _accept(listener: socket.socket, cutter: Cutter, over: threading.Event) -> None:
    listener.settimeout(0.05)
    serving: list[threading.Thread] = []
    while not over.is_set():
        with contextlib.suppress(TimeoutError):
            near, _ = listener.accept()
            near.settimeout(10)
            serving.append(threading.Thread(target=_serve, args=(cutter, near), name="cut"))
            serving[-1].start()
    for thread in serving:
        thread.join(20)


def _serve(cutter: Cutter, near: socket.socket) -> None:
    with contextlib.suppress(OSError):  # who talks through it may leave at any time
        cutter.pass_on(near)
