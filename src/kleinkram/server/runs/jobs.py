"""The job that starts the actions that a project names on a mission."""

import uuid

from procrastinate import JobContext

from kleinkram.server.jobs.execution import RETRY_STRATEGY, app_context
from kleinkram.server.jobs.queue import Job, queue
from kleinkram.server.runs.automatic import start_due_runs


@queue.task(name=Job.start_automatic_runs.value, pass_context=True, retry=RETRY_STRATEGY)
async def start_automatic_runs(job_context: JobContext, ref: str) -> None:
    """Start the actions that are due on a mission."""
    context = app_context(job_context)
    async with context.database.begin() as db:
        await start_due_runs(db, uuid.UUID(ref), weakest=context.settings.weakest_isolation)
