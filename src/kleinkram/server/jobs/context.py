"""What the worker gives its jobs to work with, and how often they try."""

from procrastinate import JobContext, RetryStrategy

from kleinkram.server.site import Site

ATTEMPTS = 5
# Waits of 4, 16, 64, 256 s: a store that is away for minutes costs nothing but patience.
PATIENTLY = RetryStrategy(max_attempts=ATTEMPTS, exponential_wait=4)


def site_of(context: JobContext) -> Site:
    """Return what the worker gave its jobs to work with."""
    site = context.additional_context["site"]
    if not isinstance(site, Site):
        raise TypeError("the worker was started without its site")
    return site
