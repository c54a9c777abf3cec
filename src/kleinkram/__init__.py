"""Kleinkram keeps every recording a robotics lab makes: organised, verified, findable down to the topic."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kleinkram.client import Client, connect

__version__ = "0.1.0"
__all__ = ["Client", "__version__", "connect"]


def __getattr__(name: str) -> object:
    """Import the client when it is first asked for, so that `import kleinkram` costs nothing."""
    if name in {"Client", "connect"}:
        from kleinkram import client

        return getattr(client, name)
    raise AttributeError(f"module 'kleinkram' has no attribute {name!r}")
