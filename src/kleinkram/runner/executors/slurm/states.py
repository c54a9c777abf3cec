"""What the states and reasons of Slurm mean for a run."""

import enum

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import Ending


class Phase(enum.Enum):
    """What a state of Slurm says: the job waits, it runs or is about to end, or it has ended."""

    waiting = "waiting"
    running = "running"
    ended = "ended"


_WAITING = frozenset(
    {"PENDING", "CONFIGURING", "REQUEUED", "REQUEUE_FED", "REQUEUE_HOLD", "SPECIAL_EXIT", "RESV_DEL_HOLD"}
)
_ENDED = frozenset(
    {
        *("COMPLETED", "CANCELLED", "FAILED", "TIMEOUT", "NODE_FAIL", "PREEMPTED", "BOOT_FAIL", "DEADLINE"),
        *("OUT_OF_MEMORY", "REVOKED", "LAUNCH_FAILED", "RECONFIG_FAIL"),
    }
)
# Reasons of waiting jobs that no time and no free node resolves.
_NEVER = {
    "PartitionConfig": "it asks for more than a node of its partition has",
    "PartitionNodeLimit": "it asks for more nodes than its partition allows",
    "PartitionTimeLimit": "its time limit is longer than its partition allows",
    "BadConstraints": "no node has what it asks for",
    "AccountNotAllowed": "its partition does not allow its account",
    "QOSNotAllowed": "its partition or account does not allow its QOS",
    "InvalidAccount": "its account does not exist",
    "InvalidQOS": "its QOS does not exist",
    "DependencyNeverSatisfied": "a job that it depends on failed",
    "AssocMaxCpuPerJobLimit": "its account allows no job so many cores",
    "AssocMaxMemPerJob": "its account allows no job so much memory",
    "AssocMaxGRESPerJob": "its account allows no job so many GPUs",
    "AssocMaxWallDurationPerJobLimit": "its account allows no job such a time limit",
    "AssocMaxCPUMinutesPerJobLimit": "its account allows no job so many core minutes",
    "QOSMaxCpuPerJobLimit": "its QOS allows no job so many cores",
    "QOSMaxMemoryPerJob": "its QOS allows no job so much memory",
    "QOSMaxGRESPerJob": "its QOS allows no job so many GPUs",
    "QOSMaxWallDurationPerJobLimit": "its QOS allows no job such a time limit",
    "QOSMaxCPUMinutesPerJobLimit": "its QOS allows no job so many core minutes",
}
# Reasons that somebody has to know of, since they may last.
_EXPLAINED = {
    "None": "",
    "AssocGrpCPUMinutesLimit": "the budget of its account is used up",
    "AssocGrpBillingMinutes": "the budget of its account is used up",
    "AssocGrpGRESMinutes": "the GPU budget of its account is used up",
    "QOSGrpCPUMinutesLimit": "the budget of its QOS is used up",
    "QOSGrpBillingMinutes": "the budget of its QOS is used up",
    "JobHeldUser": "somebody holds it; scontrol release has it start",
    "JobHeldAdmin": "an administrator holds it",
    "JobArrayTaskLimit": "as many tasks of its job array run as may run at a time",
    "BeginTime": "Slurm starts it again in a moment",
    "PartitionDown": "its partition is down",
    "PartitionInactive": "its partition is inactive",
    "ReqNodeNotAvail": "nodes that it needs are not available",
}
_STUCK_AFTER_FAILURE = ("launch failed requeued held", "job requeued in held state", "requeued held")
_RETRY = "Run it again with klein run retry."
_SOMEBODY = Ending(EndReason.cancelled, "Somebody cancelled its job in Slurm, not in Kleinkram.")
_ENDS = {
    "PREEMPTED": Ending(EndReason.lost, f"Slurm preempted its job. {_RETRY}"),
    "NODE_FAIL": Ending(EndReason.lost, f"The node of its job failed. {_RETRY}"),
    "BOOT_FAIL": Ending(EndReason.lost, f"The node of its job could not be booted. {_RETRY}"),
    "REVOKED": Ending(EndReason.lost, "Another cluster of the federation took its job."),
    "TIMEOUT": Ending(EndReason.time, "Slurm ended its job at the time limit."),
    "DEADLINE": Ending(EndReason.time, "Slurm ended its job at its deadline."),
    "OUT_OF_MEMORY": Ending(EndReason.memory, "Slurm ended its job: it used more memory than its limit."),
    "CANCELLED": _SOMEBODY,
}


def phase_of(state: str) -> Phase:
    """Return the phase of a state. One that a later Slurm adds does not end a job."""
    if state in _WAITING:
        return Phase.waiting
    return Phase.ended if state in _ENDED else Phase.running


def is_stuck_after_failure(reason: str) -> bool:
    """Whether a job waits because a node failed to start it, until it is released."""
    return reason.lower().replace("_", " ") in _STUCK_AFTER_FAILURE


def waiting_sentence(reason: str) -> str:
    """Return why a job waits, for people."""
    word = reason.partition(",")[0]
    explanation = _EXPLAINED.get(word, _NEVER.get(word))
    if explanation == "":
        return "waits in the queue of Slurm"
    return (
        f"waits in the queue of Slurm: {reason}" if explanation is None else f"waits in Slurm: {explanation} ({word})"
    )


def never_starts(reason: str) -> Ending | None:
    """Return the ending of a job that waits for a reason that never resolves."""
    explanation = _NEVER.get(reason)
    if explanation is None:
        return None
    return Ending(EndReason.not_possible, f"Slurm never starts its job: {explanation} ({reason}).")


def ending_of(state: str, reason: str, job_id: str, node: str) -> Ending:
    """Return how a job ended that left no ending of its own."""
    if state in _ENDS:
        return _ENDS[state]
    if (impossible := never_starts(reason)) is not None:
        return impossible
    where = f" on {node}" if node else ""
    return Ending(
        EndReason.lost,
        f"Its job {job_id} ended{where} without a result: {state}{f' ({reason})' if reason != 'None' else ''}. "
        "Python could not run there, its folder was not visible, or its processes were killed.",
    )
