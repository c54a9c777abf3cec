"""The periodic job that checks accounts at their providers."""

from procrastinate import JobContext

from kleinkram.server.auth.provider_checks import check_accounts, forget_refresh_tokens
from kleinkram.server.auth.providers import open_providers
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.execution import app_context
from kleinkram.server.jobs.queue import Job, queue

_NAME = Job.check_provider_accounts.value


@queue.periodic(cron="*/10 * * * *")
@queue.task(name=_NAME, pass_context=True, queueing_lock=_NAME, lock=_NAME)
async def run_provider_checks(job_context: JobContext, timestamp: int = 0) -> None:
    """Check the accounts whose check is due."""
    await check_provider_accounts(app_context(job_context))


async def check_provider_accounts(context: AppContext) -> None:
    """Check the accounts whose check is due, of all providers that grant refresh tokens for it."""
    settings = context.settings
    checked = [provider for provider in settings.oidc_providers if provider.is_refreshable]
    checked = checked if settings.provider_check_hours else []
    await forget_refresh_tokens(context, except_issuers=[provider.issuer for provider in checked])
    if not checked:
        return
    async with open_providers(settings) as providers:
        for provider in checked:
            await check_accounts(context, providers[provider.name])
