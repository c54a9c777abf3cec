"""A run cannot be made, or is not whose one says it is."""

from dataclasses import dataclass

from kleinkram.contract.errors.base import ErrorCode, KleinkramError


@dataclass(eq=False)
class RunGone(KleinkramError):
    """The run {run_id} is not this runner's (any more): it was given to another one, cancelled or deleted, or it is over. What this runner still does for it is to be ended."""  # noqa: E501  one sentence

    code = ErrorCode.run_gone
    status = 409
    run_id: str


@dataclass(eq=False)
class NoInputs(KleinkramError):
    """No file of the mission {mission!r} is an input of {action}, which reads {wanted}. Upload such a file, or choose another mission or action."""  # noqa: E501  one sentence

    code = ErrorCode.no_inputs
    status = 409
    mission: str
    action: str
    wanted: str


@dataclass(eq=False)
class NoRunner(KleinkramError):
    """The action {action} was not started, because it would wait for ever. {reason}"""

    code = ErrorCode.no_runner
    status = 409
    action: str
    reason: str
