"""Holding back what deletes objects, while somebody copies what the database named a while ago.

Whoever copies keeps a lock in the database for as long as it is connected. It goes with the process, however that ends,
with the connection, and with a process that stands still: the database ends a connection that says nothing for minutes.
"""

from sqlalchemy import text

from kleinkram.server.db import Connection

# A number that nobody else locks in this database.
HOLD = 0x6B6C_6261_636B
# Source: PostgreSQL, "pg_locks": a bigint's upper half is classid, its lower half objid, and objsubid is 1.
_HELD = text(
    "SELECT EXISTS (SELECT FROM pg_locks l JOIN pg_database d ON d.oid = l.database"
    " WHERE l.locktype = 'advisory' AND l.classid = :upper AND l.objid = :lower AND l.objsubid = 1 AND l.granted"
    " AND d.datname = current_database())"
)


async def is_held_back(db: Connection) -> bool:
    """Say whether objects must stay for now, even those that nothing refers to."""
    where = {"upper": HOLD >> 32, "lower": HOLD & 0xFFFF_FFFF}
    return bool((await db.execute(_HELD, where)).scalar_one())
