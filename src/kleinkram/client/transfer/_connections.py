"""Connections to the store that send slices of files: where they can, without taking the bytes into this process.

A slice goes from the page cache to the socket by `sendfile`, which spares an upload about a tenth of its CPU time.
Over TLS, and where the file system or the kernel cannot do it, it is read and sent.
"""

import errno
import os
import ssl
from typing import Any

import urllib3
from urllib3.connection import HTTPConnection, HTTPSConnection
from urllib3.connectionpool import HTTPConnectionPool, HTTPSConnectionPool
from urllib3.util.wait import wait_for_write

from kleinkram.client.transfer._source import FileSlice

CONNECT_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 120.0
# The last two are the disk's: reading says so in words that are the file's.
_CANNOT = frozenset({errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EIO, errno.ESTALE})


class _SendsSlices(HTTPConnection):
    """A connection that knows slices of files, and gives sending as much time as receiving."""

    def connect(self) -> None:
        super().connect()
        if self.sock:  # urllib3 would send the first request with the time that connecting has
            self.sock.settimeout(READ_TIMEOUT_S)

    def send(self, data: Any) -> None:
        if isinstance(data, FileSlice) and self.sock:
            _send_slice(self.sock, data)
        else:
            super().send(data)


class _PlainConnection(_SendsSlices):
    pass


class _TlsConnection(_SendsSlices, HTTPSConnection):
    pass


class _PlainPool(HTTPConnectionPool):
    ConnectionCls = _PlainConnection


class _TlsPool(HTTPSConnectionPool):
    ConnectionCls = _TlsConnection


def open_connections(most: int) -> urllib3.PoolManager:
    """Return a pool of so many connections to a host; it tries nothing twice by itself."""
    timeout = urllib3.Timeout(connect=CONNECT_TIMEOUT_S, read=READ_TIMEOUT_S)
    pool = urllib3.PoolManager(maxsize=most, retries=False, timeout=timeout)
    pool.pool_classes_by_scheme = {"http": _PlainPool, "https": _TlsPool}
    return pool


def _send_slice(sock: Any, piece: FileSlice) -> None:
    sent = 0 if isinstance(sock, ssl.SSLSocket) else _send_by_kernel(sock, piece)
    for view in piece.from_byte(sent).read():
        sock.sendall(view)


def _send_by_kernel(sock: Any, piece: FileSlice) -> int:
    """Send a slice, and return how much of it; not all only where the kernel cannot, or the file ends before."""
    sent = 0
    while sent < piece.length:
        try:
            count = os.sendfile(sock.fileno(), piece.handle, piece.offset + sent, piece.length - sent)
        except BlockingIOError:
            if not wait_for_write(sock, sock.gettimeout()):
                raise TimeoutError(f"the store took nothing for {sock.gettimeout():.0f} s") from None
            continue
        except OSError as error:
            if error.errno in _CANNOT:
                return sent
            raise
        if count == 0:
            return sent
        sent += count
    return sent
