"""Kleinkram keeps every recording a robotics lab makes: organised, verified, findable down to the topic."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kleinkram.client import Client, connect

__version__ = "0.1.0"
__all__ = ["Client", "__version__", "connect"]


def __getattr__(name: str) -> object:
    """Import the client on first use, so that `klein --help` and the server do not load it."""
    if name in {"Client", "connect"}:
        from kleinkram import client

        return getattr(client, name)
    raise AttributeError(f"module 'kleinkram' has no attribute {name!r}")
