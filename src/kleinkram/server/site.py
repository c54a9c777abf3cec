"""What a flow over several transactions works with: database, store and settings of one process."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from kleinkram.server.db import Database, Transactions
from kleinkram.server.settings import Settings
from kleinkram.server.storage import CurrentStorage, Storage


@dataclass(frozen=True)
class Site:
    """One process's way to everything it may touch."""

    database: Database
    storage: Storage
    settings: Settings


def _current_site(request: Request, database: Transactions, storage: CurrentStorage) -> Site:
    return Site(database, storage, request.app.state.settings)


CurrentSite = Annotated[Site, Depends(_current_site)]
