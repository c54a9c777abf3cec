"""Why a job failed, kept in a sentence for admins. The log holds all of it; this, no secret and no signed address."""

import logging
import re
from collections.abc import Awaitable, Callable
from typing import Any

from procrastinate import JobContext
from procrastinate.worker import Worker
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import SQLAlchemyError

from kleinkram.contract.errors import KleinkramError
from kleinkram.server.jobs.context import site_of
from kleinkram.server.site import Site
from kleinkram.server.tables import job_error

_log = logging.getLogger("kleinkram.worker")
_MOST_CHARACTERS = 500
# What signs an address of the store stands in its query; a password stands before the host.
_QUERY = re.compile(r"\?\S+")
_PASSWORD = re.compile(r"(://[^\s/:@]*:)[^\s/@]+@")


async def keep_why(call_next: Callable[[], Awaitable[Any]], context: JobContext, _worker: Worker) -> Any:
    """Run a job; where it fails, keep why before the queue hears of it, whether it is tried again or not."""
    try:
        return await call_next()
    except Exception as error:
        if context.job.id is not None:
            await _keep(site_of(context), context.job.id, sentence_of(error))
        raise


def sentence_of(error: Exception) -> str:
    """Return one line that says what went wrong: an error's own sentence where it has one."""
    said = error.sentence() if isinstance(error, KleinkramError) else _named(error)
    shown = "".join(letter if letter.isprintable() else " " for letter in said)
    return _PASSWORD.sub(r"\1…@", _QUERY.sub("?…", shown))[:_MOST_CHARACTERS]


def _named(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


async def _keep(site: Site, job_id: int, sentence: str) -> None:
    row = upsert(job_error).values(job_id=job_id, sentence=sentence)
    try:
        async with site.database.begin() as db:
            await db.execute(row.on_conflict_do_update(index_elements=["job_id"], set_={"sentence": sentence}))
    except (SQLAlchemyError, KleinkramError) as error:  # what the job itself failed of must not be lost to this
        _log.warning("why a job failed was not kept", extra={"fields": {"id": job_id, "reason": str(error)}})
