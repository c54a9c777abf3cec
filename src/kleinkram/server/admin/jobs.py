"""The periodic job that mails the status of the server."""

from procrastinate import JobContext

from kleinkram.server.admin.report import send_due_report
from kleinkram.server.jobs.execution import app_context
from kleinkram.server.jobs.queue import Job, queue


# Every hour, so that the report of a Monday on which no worker ran, or the mail server was away, is sent later.
@queue.periodic(cron="5 * * * *")
@queue.task(
    name=Job.send_status_report.value,
    pass_context=True,
    queueing_lock="send_status_report",
    lock="send_status_report",
)
async def run_status_report(job_context: JobContext, timestamp: int = 0) -> None:
    """Mail the status if that is due."""
    await send_due_report(app_context(job_context))
