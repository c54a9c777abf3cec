"""What services need across transactions: the database, the object store and the settings of one process."""

from dataclasses import dataclass

from kleinkram.server.db import Database
from kleinkram.server.s3.storage import Storage
from kleinkram.server.settings import Settings


@dataclass(frozen=True)
class AppContext:
    """The shared resources of one process."""

    database: Database
    storage: Storage
    settings: Settings
