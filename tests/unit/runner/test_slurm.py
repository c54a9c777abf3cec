"""What Slurm's commands write, what its states mean, and which options a job gets."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import ClusterRequest, Resources
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart
from kleinkram.runner.executors.slurm.commands import (
    ClusterNode,
    JobAccount,
    QueueEntry,
    count_gpus,
    parse_accounts,
    parse_duration,
    parse_job,
    parse_node,
    reason_of,
)
from kleinkram.runner.executors.slurm.options import SlurmOptions, reserved_names, sbatch_options
from kleinkram.runner.executors.slurm.probe import largest_node
from kleinkram.runner.executors.slurm.states import (
    Phase,
    ending_of,
    is_stuck_after_failure,
    never_starts,
    phase_of,
    waiting_sentence,
)

MIB = 2**20


def test_a_line_of_squeue() -> None:
    running = "4711|RUNNING|1795960656|1795960660|node[1-2]|klein-a-b|N/A|None"
    assert parse_job(running) == QueueEntry("4711", "RUNNING", 1795960656, 1795960660, "node[1-2]", "klein-a-b", "None")
    waiting = parse_job("12_3|PENDING|1795960656|N/A||klein-a-b|3|ReqNodeNotAvail, UnavailableNodes:a|b")
    assert (waiting.job_id, waiting.name, waiting.started_s) == ("12_3", "klein-a-b_3", None)
    assert waiting.reason == "ReqNodeNotAvail, UnavailableNodes:a|b"


def test_a_line_of_sinfo() -> None:
    node = parse_node("node1|128|515000|gpu:a100:4(S:0-1),nvme:2|main*|1-00:00:00|mixed")
    assert node == ClusterNode("node1", 128, 515000 * MIB, 4, "main", True, 86400)
    assert parse_node("node2|8+|16000+|(null)|short|infinite|down*").time_s is None


@pytest.mark.parametrize(
    ("gres", "count"),
    [("(null)", 0), ("gpu:2", 2), ("gpu", 1), ("gpu:a100:4(S:0-1),gpu:t4:2,nvme:1", 6), ("shard:8", 0)],
)
def test_gpus_are_counted_by_their_resources(gres: str, count: int) -> None:
    assert count_gpus(gres) == count


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("2:00", 120), ("1:00:00", 3600), ("2-01:00:30", 176430), ("00:01.500", 1.5), ("infinite", None), ("n/a", None)],
)
def test_durations_of_slurm(text: str, seconds: float | None) -> None:
    assert parse_duration(text) == seconds


def test_accounts_join_a_job_and_its_steps() -> None:
    text = (
        "7|klein-a|CANCELLED by 1000|00:02.500|\n7.batch|batch|CANCELLED|00:02.500|1536K\n"
        "8_3|klein-b|COMPLETED|01:00:00|\n8_3.0|python|COMPLETED|00:01|2G\n"
    )
    assert parse_accounts(text) == {
        "7": JobAccount("klein-a", "CANCELLED", 2.5, 1536 * 1024),
        "8_3": JobAccount("klein-b_3", "COMPLETED", 3600, 2 * 2**30),
    }


def test_the_reason_of_a_refusal_is_one_sentence() -> None:
    errors = (
        "sbatch: error: Memory specification can not be satisfied\n"
        "sbatch: error: Batch job submission failed: Requested node configuration is not available\n"
    )
    assert (
        reason_of(errors) == "Memory specification can not be satisfied; Requested node configuration is not available"
    )


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        ("PREEMPTED", EndReason.lost),
        ("NODE_FAIL", EndReason.lost),
        ("BOOT_FAIL", EndReason.lost),
        ("TIMEOUT", EndReason.time),
        ("DEADLINE", EndReason.time),
        ("OUT_OF_MEMORY", EndReason.memory),
        ("CANCELLED", EndReason.cancelled),
        ("COMPLETED", EndReason.lost),
        ("FAILED", EndReason.lost),
    ],
)
def test_ends_without_a_result(state: str, reason: EndReason) -> None:
    assert phase_of(state) is Phase.ended
    ending = ending_of(state, "None", "4711", "node1")
    assert ending.reason is reason
    assert ending.message.endswith(".")


def test_a_job_that_slurm_found_impossible_says_why() -> None:
    ending = ending_of("FAILED", "BadConstraints", "4711", "")
    assert (ending.reason, "no node has what it asks for" in ending.message) == (EndReason.not_possible, True)


def test_states_of_jobs_that_go_on() -> None:
    assert {phase_of(state) for state in ("PENDING", "CONFIGURING", "REQUEUED", "REQUEUE_HOLD")} == {Phase.waiting}
    assert {phase_of(state) for state in ("RUNNING", "COMPLETING", "SUSPENDED", "STAGE_OUT", "A_NEW_STATE")} == {
        Phase.running
    }


@pytest.mark.parametrize(
    ("reason", "sentence"),
    [
        ("None", "waits in the queue of Slurm"),
        ("Resources", "waits in the queue of Slurm: Resources"),
        ("AssocGrpCPUMinutesLimit", "waits in Slurm: the budget of its account is used up (AssocGrpCPUMinutesLimit)"),
        (
            "ReqNodeNotAvail, UnavailableNodes:node1",
            "waits in Slurm: nodes that it needs are not available (ReqNodeNotAvail)",
        ),
    ],
)
def test_why_a_job_waits(reason: str, sentence: str) -> None:
    assert waiting_sentence(reason) == sentence
    assert never_starts(reason) is None


def test_reasons_that_never_resolve() -> None:
    ending = never_starts("PartitionNodeLimit")
    assert ending is not None
    assert ending.reason is EndReason.not_possible
    assert is_stuck_after_failure("launch failed requeued held")
    assert not is_stuck_after_failure("JobHeldUser")


def test_the_options_of_a_job() -> None:
    options = SlurmOptions(
        5,
        partition="gpu",
        account="lab",
        qos="low",
        constraint="a100",
        extra={"reservation": "night"},
        allowed=frozenset({"comment"}),
    )
    resources = Resources(cores=1.5, memory_bytes=1000 * MIB, gpus=2, time_s=61)
    request = ClusterRequest(constraint="ib", exclusive=True, options={"comment": "--wrap=x"})
    assert sbatch_options(options, resources, request) == [
        "--nodes=1",
        "--ntasks=1",
        "--cpus-per-task=2",
        "--mem=1128M",
        "--time=5",
        "--partition=gpu",
        "--account=lab",
        "--qos=low",
        "--constraint=a100&ib",
        "--reservation=night",
        "--comment=--wrap=x",
        "--gres=gpu:2",
        "--exclusive",
    ]


@pytest.mark.parametrize(
    ("own", "requested", "both"),
    [
        ("op", "fast", "op&fast"),
        ("op", "x|fast", "op&(x|fast)"),  # without parentheses, a node with `fast` alone would do
        ("a100|h100", "ib", "(a100|h100)&ib"),
        ("op", "(x|fast)&ib", "op&(x|fast)&ib"),
        ("op", None, "op"),
        (None, "[x|fast]*1", "[x|fast]*1"),
    ],
)
def test_nodes_meet_the_constraints_of_runner_and_action(own: str | None, requested: str | None, both: str) -> None:
    options = sbatch_options(SlurmOptions(5, constraint=own), Resources(), ClusterRequest(constraint=requested))
    assert [option for option in options if option.startswith("--constraint")] == [f"--constraint={both}"]


@pytest.mark.parametrize(
    "requested", ["x)|(fast", "a|(b&c)", "[x|fast]", "x*2", "(a&(b|c))", "x,fast", "&".join("a" * 99) + "("]
)
def test_a_constraint_that_could_escape_that_of_the_runner_is_refused(requested: str) -> None:
    with pytest.raises(CannotStart, match="combined"):
        sbatch_options(SlurmOptions(5, constraint="op"), Resources(), ClusterRequest(constraint=requested))


def test_an_action_sets_only_options_that_its_runner_allows() -> None:
    with pytest.raises(CannotStart, match="--nice, --reservation of sbatch, which its runner does not allow") as caught:
        sbatch_options(SlurmOptions(5), Resources(), ClusterRequest(options={"reservation": "x", "nice": "0"}))
    assert caught.value.ending.reason is EndReason.not_possible
    assert reserved_names(["output", "comment", "wrap"]) == ["output", "wrap"]


@pytest.mark.parametrize(
    "values",
    [
        {"options": {"comment": "a\nb"}},
        {"options": {"Comment": "a"}},
        {"options": {"-p": "a"}},
        {"options": {"a=b": "c"}},
        {"options": {"comment": "$(id)"}},
        {"constraint": "a b"},
        {"constraint": "--wrap=x y"},
        {"constraint": ""},
    ],
)
def test_a_request_carries_no_other_flags(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ClusterRequest.model_validate(values)


def test_the_largest_node_of_a_partition() -> None:
    nodes = [
        ClusterNode("a", 64, 256 * 2**30, 0, "cpu", True, None),
        ClusterNode("b", 32, 512 * 2**30, 0, "cpu", True, None),
        ClusterNode("c", 16, 128 * 2**30, 4, "gpu", False, None),
    ]
    default, gpu = largest_node(nodes, None), largest_node(nodes, "gpu")
    assert (default.cores, default.memory_bytes, default.gpus) == (64, 512 * 2**30 - 128 * MIB, 0)
    assert (gpu.cores, gpu.gpus) == (16, 4)
    with pytest.raises(InvalidInput, match="it does not exist, or has no nodes; there are: cpu, gpu"):
        largest_node(nodes, "large")
