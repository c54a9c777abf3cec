"""The SDK: `connect()` returns a `Client` with one attribute per resource; `transfer` moves the bytes.

Talks HTTP to one server and nothing else; never prints, never asks, never exits.
"""

from kleinkram.client._client import Client, connect
from kleinkram.client.config import Endpoint, EndpointSource

__all__ = ["Client", "Endpoint", "EndpointSource", "connect"]
