"""The job that replaces the names of an erased person in the audit log."""

import uuid

from procrastinate import JobContext

from kleinkram.server.jobs.execution import RETRY_STRATEGY, app_context
from kleinkram.server.jobs.queue import Job, queue
from kleinkram.server.people import erasure


@queue.task(name=Job.redact_audit_log.value, pass_context=True, retry=RETRY_STRATEGY)
async def redact_audit_log(job_context: JobContext, ref: str) -> None:
    """Redact the events of the erased person `ref`."""
    await erasure.redact_audit_log(app_context(job_context), uuid.UUID(ref))
