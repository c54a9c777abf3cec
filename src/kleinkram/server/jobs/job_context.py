"""What the worker gives its jobs to work with, and how often they try."""

from typing import TypeVar

from procrastinate import JobContext, RetryStrategy

from kleinkram.server.context import AppContext
from kleinkram.server.jobs.courtesy import Courtesy

T = TypeVar("T")
ATTEMPTS = 5
# Waits of 4, 16, 64, 256 s: a store that is away for minutes costs nothing but patience.
PATIENTLY = RetryStrategy(max_attempts=ATTEMPTS, exponential_wait=4)


def given(job_context: JobContext, name: str, kind: type[T]) -> T:
    """Return one of the things that the worker gave its jobs to work with."""
    thing = job_context.additional_context[name]
    if not isinstance(thing, kind):
        raise TypeError(f"the worker was started without its {name}")
    return thing


def app_context(job_context: JobContext) -> AppContext:
    """Return the job's way to database and store."""
    return given(job_context, "site", AppContext)


def courtesy_of(job_context: JobContext) -> Courtesy:
    """Return what makes the job wait while uploads come in."""
    return given(job_context, "courtesy", Courtesy)
