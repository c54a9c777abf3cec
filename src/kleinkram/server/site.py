"""What a flow over several transactions works with: database, store and settings of one process."""

from dataclasses import dataclass

from kleinkram.server.db import Database
from kleinkram.server.settings import Settings
from kleinkram.server.storage import Storage


@dataclass(frozen=True)
class Site:
    """One process's way to everything it may touch."""

    database: Database
    storage: Storage
    settings: Settings
