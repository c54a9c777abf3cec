"""A slow link between two machines, made of two network namespaces and two TUN devices that this process connects.

The link has a rate, a delay and a queue, as a radio link has. It can go dark, and the robot's address can change: old
connections then hang without an answer, as when a robot moves from one access point to another.
"""

import contextlib
import fcntl
import itertools
import os
import selectors
import struct
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.requirements import missing, need

_TUN = Path("/dev/net/tun")
_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
_MAX_PACKET_BYTES = 65_536
# A packet that carries bytes of a file, and not only an acknowledgement or a short request.
_CARRYING_BYTES = 1_000
_QUEUE_S = 0.4


@dataclass
class _Direction:
    """Packets on their way from one device to the other."""

    rate_bytes_per_s: float
    delay_s: float
    sent_bytes: int = 0
    arrivals: list[float] = field(default_factory=list)
    port_at: int = 20
    ports: set[bytes] = field(default_factory=set)
    cut_ports: set[bytes] = field(default_factory=set)
    _free_at: float = 0.0
    _waiting: deque[tuple[float, bytes]] = field(default_factory=deque)

    def accept(self, packet: bytes, *, is_dark: bool) -> None:
        """Queue a packet, or drop it when the link is dark or the queue is full."""
        now = time.monotonic()
        self.sent_bytes += len(packet)
        self._free_at = max(self._free_at, now)
        port = packet[self.port_at : self.port_at + 2]  # the robot's; there is TCP alone, without IP options
        self.ports.add(port)
        if is_dark or port in self.cut_ports or self._free_at - now > _QUEUE_S:
            return
        self._free_at += len(packet) / self.rate_bytes_per_s
        self._waiting.append((self._free_at + self.delay_s, packet))

    def due_in_s(self) -> float | None:
        """Return how long the next packet still takes."""
        return max(0.0, self._waiting[0][0] - time.monotonic()) if self._waiting else None

    def deliver(self, device: int, *, is_dark: bool) -> None:
        """Write the packets that have arrived."""
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, packet = self._waiting.popleft()
            if is_dark:
                continue
            if len(packet) >= _CARRYING_BYTES:
                self.arrivals.append(time.monotonic())
            os.write(device, packet)


class SlowLink:
    """The link, and the namespaces `robot` and `lab` at its ends; the lab is at `lab_address`."""

    def __init__(self, number: int, rate_bytes_per_s: float, delay_s: float) -> None:
        self.robot, self.lab = f"klein-robot-{number}", f"klein-lab-{number}"
        self.lab_address = "10.232.0.1"
        self.address_changes = 0
        self.dark = threading.Event()
        self.up = _Direction(rate_bytes_per_s, delay_s)
        self.down = _Direction(rate_bytes_per_s, delay_s, port_at=22)
        self._robot_device, self._lab_device = f"klr{number}", f"kll{number}"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._carry, name="slow link")
        self._devices: list[int] = []

    @property
    def robot_address(self) -> str:
        """The robot's present address."""
        return f"10.232.0.{2 + self.address_changes % 250}"

    def command(self, namespace: str) -> tuple[str, ...]:
        """Return the beginning of the command line of a program that runs at one end."""
        return ("ip", "netns", "exec", namespace)

    def change_address(self) -> None:
        """Give the robot another address. Its old connections get no answer, without an error."""
        old = self.robot_address
        self.address_changes += 1
        _ip("-netns", self.robot, "address", "delete", f"{old}/24", "dev", self._robot_device)
        _ip("-netns", self.robot, "address", "add", f"{self.robot_address}/24", "dev", self._robot_device)

    def forget_connections(self) -> None:
        """Drop what belongs to connections that exist now, as a router does whose own address has changed."""
        for way in (self.up, self.down):
            way.cut_ports = {*self.up.ports}

    def longest_silence_s(self, since: float, until: float) -> float:
        """Return the longest time between two arrivals of file bytes at the lab between two moments."""
        return self._longest(self.up, since, until)

    def longest_silence_down_s(self, since: float, until: float) -> float:
        """Return the longest time between two arrivals of file bytes at the robot between two moments."""
        return self._longest(self.down, since, until)

    @staticmethod
    def _longest(direction: _Direction, since: float, until: float) -> float:
        moments = [since, *(moment for moment in direction.arrivals if since < moment < until), until]
        return max(later - earlier for earlier, later in itertools.pairwise(moments))

    def start(self) -> None:
        """Make the namespaces and connect them."""
        for namespace, device, address in (
            (self.robot, self._robot_device, self.robot_address),
            (self.lab, self._lab_device, self.lab_address),
        ):
            _ip("netns", "add", namespace)
            self._devices.append(_open_tun(device))
            _ip("link", "set", device, "netns", namespace)
            _ip("-netns", namespace, "link", "set", "lo", "up")
            _ip("-netns", namespace, "address", "add", f"{address}/24", "dev", device)
            _ip("-netns", namespace, "link", "set", device, "up")
        self._thread.start()

    def end(self) -> None:
        """Take all of it away."""
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join(10)
        for device in self._devices:
            os.close(device)
        for namespace in (self.robot, self.lab):
            subprocess.run(["ip", "netns", "delete", namespace], check=False, capture_output=True)

    def _carry(self) -> None:
        robot, lab = self._devices
        ways = {robot: (self.up, lab), lab: (self.down, robot)}
        with selectors.DefaultSelector() as ready:
            for device in ways:
                os.set_blocking(device, False)
                ready.register(device, selectors.EVENT_READ)
            while not self._over.is_set():
                waits = [wait for way, _ in ways.values() if (wait := way.due_in_s()) is not None]
                for key, _ in ready.select(min([0.1, *waits])):
                    with contextlib.suppress(BlockingIOError):
                        ways[key.fd][0].accept(os.read(key.fd, _MAX_PACKET_BYTES), is_dark=self.dark.is_set())
                for way, far_device in ways.values():
                    way.deliver(far_device, is_dark=self.dark.is_set())


@contextmanager
def slow_link(*, rate_bytes_per_s: float, delay_s: float = 0.02) -> Iterator[SlowLink]:
    """Make a slow link for as long as the context lasts; skip, or fail where all is required, without root."""
    if os.geteuid() != 0:
        missing("a slow link is made of network namespaces, which only root may make")
    need("ip")
    if not _TUN.exists():
        missing(f"a slow link needs {_TUN}")
    link = SlowLink(os.getpid() % 1_000_000, rate_bytes_per_s, delay_s)
    try:
        link.start()
        yield link
    finally:
        link.end()


def _open_tun(name: str) -> int:
    device = os.open(_TUN, os.O_RDWR | os.O_CLOEXEC)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN | _IFF_NO_PI))
    return device


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], check=False, capture_output=True, text=True)
    assert done.returncode == 0, f"ip {' '.join(arguments)}: {done.stderr}"
