"""Forward a TCP port to the store: `python -m kleinkram.standalone.tcp_proxy ADDRESS PORT TARGET_PORT`.

SeaweedFS binds all its services to one address, and those beside S3 have no authentication, so it stays on loopback and
this process forwards one port to its S3 port. The kernel moves bytes between the sockets (splice); TLS passes through.
"""

import contextlib
import os
import resource
import socket
import sys
import threading
import time

_SPLICE_BYTES = 1024 * 1024
_STACK_BYTES = 256 * 1024


def main() -> None:
    """Listen and forward until killed."""
    address, port, target_port = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    threading.stack_size(_STACK_BYTES)
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.create_server((address, port), family=family, backlog=256) as listener:
        while True:
            try:
                client, _ = listener.accept()
            except OSError as error:  # no descriptors left: some connection will end
                print(f"cannot accept: {error}", file=sys.stderr, flush=True)  # noqa: T201  (goes to the service's log)
                time.sleep(0.1)
                continue
            threading.Thread(target=_connect, args=(client, target_port), daemon=True).start()


def _connect(client: socket.socket, target_port: int) -> None:
    """Connect one client with the store until both sides have closed."""
    with (
        client,
        contextlib.suppress(OSError),
        socket.create_connection(("127.0.0.1", target_port), timeout=10) as store,
    ):
        for end in (client, store):
            end.settimeout(None)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            end.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        responses = threading.Thread(target=_forward, args=(store, client), daemon=True)
        responses.start()
        _forward(client, store)
        responses.join()


def _forward(source: socket.socket, target: socket.socket) -> None:
    """Move bytes one way until the source closes, then close the target; an error closes both ways."""
    out, into = os.pipe()
    try:
        while moved := os.splice(source.fileno(), into, _SPLICE_BYTES):
            while moved:
                moved -= os.splice(out, target.fileno(), moved)
        target.shutdown(socket.SHUT_WR)
    except OSError:
        for end in (source, target):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
    finally:
        os.close(out)
        os.close(into)


if __name__ == "__main__":
    main()
