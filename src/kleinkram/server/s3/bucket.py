"""`python -m kleinkram.server create-bucket`: creates the bucket in a store that may still be starting."""

import asyncio
import time

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings

_PAUSE_S = 1.0


async def create_bucket(settings: Settings, *, timeout_s: float) -> bool:
    """Create the bucket unless it exists, and return whether it was created. Tries again until the time is over.

    Raises:
        StoreUnavailable: the store does not answer in time, or refuses.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            async with open_storage(settings) as storage:
                return await storage.create_bucket(settings.s3_region)
        except StoreUnavailable:
            if time.monotonic() > deadline:
                raise
        await asyncio.sleep(_PAUSE_S)
