"""The weekly report: the status of the server as a mail to the addresses of `report_to`."""

import asyncio
import datetime

from sqlalchemy import select

from kleinkram.contract.admin import AdminStatus, CapacityForecast, CapacityUnit, StatusItem, StatusSeverity
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.units import format_size
from kleinkram.server.admin.status import describe_use, get_status
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.mail import send_mail
from kleinkram.server.settings import Settings
from kleinkram.server.tables import audit_event

_HOUR = 6  # of Mondays, UTC


async def send_due_report(context: AppContext) -> bool:
    """Send the report of this week unless that was done; return whether it was sent.

    The audit log has an entry of each report. A process that ends between the two sends the report again.

    Raises:
        MailNotSent: the mail server failed. The next round tries again.
        DatabaseUnavailable: the database does not answer.
    """
    settings = context.settings
    if not settings.report_to:
        return False
    due_at = last_due_time(datetime.datetime.now(datetime.timezone.utc))
    async with context.database.begin() as db:
        if await _was_sent(db, due_at):
            return False
    status = await get_status(context)
    subject, text = report_subject(status, settings), report_text(status, settings)
    await asyncio.to_thread(send_mail, settings, subject=subject, text=text)
    after: Metadata = {"recipients": len(settings.report_to), "items": len(status.items)}
    async with context.database.begin() as db:
        await audit(db, None, Event("report.send", "report", None, "status", after=after))
    return True


def last_due_time(now: datetime.datetime) -> datetime.datetime:
    """Return the latest Monday at 6:00 UTC that is not after `now`."""
    monday = (now - datetime.timedelta(days=now.weekday())).replace(hour=_HOUR, minute=0, second=0, microsecond=0)
    return monday if monday <= now else monday - datetime.timedelta(days=7)


async def _was_sent(db: Connection, since: datetime.datetime) -> bool:
    sent = select(audit_event.c.id).where(audit_event.c.at >= since, audit_event.c.operation == "report.send")
    return (await db.execute(sent.limit(1))).first() is not None


def report_subject(status: AdminStatus, settings: Settings) -> str:
    """Return the subject, which says whether there is something to do."""
    problems = sum(item.severity is StatusSeverity.problem for item in status.items)
    counts = {"problems": problems, "warnings": len(status.items) - problems}
    summary = ", ".join(f"{name}: {number}" for name, number in counts.items() if number) or "healthy"
    return f"{settings.lab_name}: {summary}"


def report_text(status: AdminStatus, settings: Settings) -> str:
    """Return the status as plain text."""
    lines = [
        f"{settings.lab_name} at {settings.public_url}, {status.now:%Y-%m-%d %H:%M} UTC, version {status.version}.",
        "",
    ]
    lines += [_item_line(item) for item in status.items] or ["Healthy: nothing needs your attention."]
    stored, per_day = format_size(status.stored_bytes), format_size(status.stored_bytes_per_day)
    lines += ["", f"Stored: {stored}; {per_day} more a day (mean of the last 30 days)."]
    lines += [_capacity_line(row) for row in status.capacities]
    lines += ["", f"Details: {settings.public_url.rstrip('/')}/admin?tab=health, or `klein admin status`."]
    return "\n".join(lines) + "\n"


def _item_line(item: StatusItem) -> str:
    return f"{item.severity.value.upper()} {item.subject}: {item.message} {item.remedy}".rstrip()


def _capacity_line(row: CapacityForecast) -> str:
    name = "Store" if row.project is None else f"Quota of {row.project.name}"
    per_day = f"{row.per_day} files" if row.unit is CapacityUnit.files else format_size(row.per_day)
    full = f"full on {row.full_at:%Y-%m-%d}" if row.full_at is not None else "not full within ten years"
    return f"{name}: {describe_use(row)}; {per_day} more a day; {full}."
