"""Messages to systemd: this process is ready, is alive, or stops. No effect where systemd does not wait for them.

A ping is to be sent by the loop that does the work, so that systemd restarts a process whose loop hangs. Imports no
other module of ours, because small processes use it.

Source: sd_notify(3), sd_watchdog_enabled(3).
"""

import asyncio
import os
import socket
import time
from contextlib import suppress

# A busy process may be late: there are several pings in each interval of the watchdog.
_PINGS = 4
# While systemd is busy, its queue may be full, and sending waits.
_SEND_TIMEOUT_S = 1.0


def notify_ready(status: str) -> None:
    """Report that this process has started; `status` is shown by `systemctl status`."""
    _send(f"READY=1\nSTATUS={status}")


def notify_status(status: str) -> None:
    """Report what this process does."""
    _send(f"STATUS={status}")


def notify_stopping() -> None:
    """Report that this process begins to stop."""
    _send("STOPPING=1\nSTATUS=stopping")


class Watchdog:
    """The watchdog of this process's service, if it has one."""

    def __init__(self) -> None:
        self._interval_s = _ping_interval_s()
        self._pinged_s = float("-inf")

    def ping(self) -> None:
        """Report that this process is alive. Cheap: most calls send nothing."""
        if self._interval_s is not None and time.monotonic() - self._pinged_s >= self._interval_s:
            self._pinged_s = time.monotonic()
            _send("WATCHDOG=1")

    async def ping_from_event_loop(self) -> None:
        """Ping as long as the event loop runs tasks; returns at once if the service has no watchdog."""
        while self._interval_s is not None:
            self.ping()
            await asyncio.sleep(self._interval_s)


def _ping_interval_s() -> float | None:
    """Return the time between two pings; None if systemd expects none from this process."""
    microseconds, pid = os.environ.get("WATCHDOG_USEC", ""), os.environ.get("WATCHDOG_PID")
    if not microseconds.isdecimal() or int(microseconds) == 0 or pid not in (None, str(os.getpid())):
        return None
    return int(microseconds) / 1e6 / _PINGS


def _send(text: str) -> None:
    """Send a datagram. systemd notices a message that is lost; the work goes on."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):  # an abstract socket
        address = "\0" + address[1:]
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
        sender.settimeout(_SEND_TIMEOUT_S)
        sender.connect(address)
        sender.sendall(text.encode())
