"""What the state of a pod of Kubernetes says, how its output is copied, and what its networks are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.reports import Finding, Progress, Report, Severity
from kleinkram.contract.runners import RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import Ending
from kleinkram.runner.executors.kubernetes import pod_log
from kleinkram.runner.executors.kubernetes.api_objects import Pod
from kleinkram.runner.executors.kubernetes.cluster import Cluster, ClusterUnavailable
from kleinkram.runner.executors.kubernetes.endings import (
    ending_of,
    failed_start,
    queued_s,
    reason_waiting,
    with_history,
)
from kleinkram.runner.executors.kubernetes.manifests import Names
from kleinkram.runner.executors.kubernetes.network_probe import Reached, judge
from kleinkram.runner.executors.kubernetes.options import Toleration
from kleinkram.runner.executors.kubernetes.pod_log import PodLog
from kleinkram.runner.executors.kubernetes.transfer_output import FetchOutcome, finish_lines, read_finish

_RESOURCES = Resources(memory_bytes=10**8, disk_bytes=2 * 10**7, time_s=60)


def pod(state: Mapping[str, Any] | None = None, *, metadata: Mapping[str, Any] | None = None, **status: Any) -> Pod:
    """Return a pod on a node."""
    statuses = [{"name": "main", "state": state}] if state else []
    return Pod.model_validate(
        {
            "metadata": {"name": "a-pod", "creationTimestamp": "2026-01-01T11:59:00Z", **(metadata or {})},
            "spec": {"nodeName": "node-1"},
            "status": {"containerStatuses": statuses, **status},
        }
    )


def ended(exit_code: int, reason: str = "Error", message: str = "", **status: Any) -> Pod:
    terminated = {"terminated": {"exitCode": exit_code, "reason": reason, "message": message}}
    return pod(terminated, phase="Failed" if exit_code else "Succeeded", **status)


def exited(exit_code: int, *, phase: str, status_reason: str = "", words: str = "") -> Pod:
    """Return a pod whose node has ended it, and says how its program ended."""
    terminated = {"terminated": {"exitCode": exit_code, "reason": "Error" if exit_code else "Completed"}}
    return pod(terminated, phase=phase, reason=status_reason, message=words)


_SHUTDOWN = "Pod was terminated in response to imminent node shutdown."
_DELETED = {"deletionTimestamp": "2026-01-01T12:00:00Z"}
_PREEMPTED = [{"type": "DisruptionTarget", "status": "True", "message": "preempted by a pod of higher priority"}]


@pytest.mark.parametrize(
    ("state", "reason", "words"),
    [
        (ended(0, "Completed"), EndReason.done, ""),
        (ended(3), EndReason.exit_code, "3"),
        (ended(139), EndReason.signal, "SIGSEGV"),
        (ended(137, "OOMKilled"), EndReason.memory, "100 MB"),
        (ended(137, reason="Error", metadata=_DELETED), EndReason.lost, "drained"),
        # A program that handles SIGTERM may end well, with part of its results.
        (ended(0, "Completed", metadata=_DELETED), EndReason.lost, "drained"),
        (ended(0, "Completed", conditions=_PREEMPTED), EndReason.lost, "higher priority"),
        (ended(143, conditions=_PREEMPTED), EndReason.lost, "higher priority"),
        (exited(0, phase="Failed"), EndReason.lost, "node failed"),
        (exited(143, phase="Failed", status_reason="Preempting", words="Preempted"), EndReason.lost, "Preempted"),
        (ended(137, "ContainerStatusUnknown"), EndReason.lost, "node failed"),
        (ended(128, "StartError", 'exec: "x": executable file not found in $PATH'), EndReason.command_not_found, '"x"'),
        (ended(128, "StartError", "cannot set memory limit"), EndReason.not_possible, "cannot set memory limit"),
        (pod(phase="Failed", reason="DeadlineExceeded"), EndReason.time, "60 s"),
        (
            pod(phase="Failed", reason="Evicted", message="Pod ephemeral local storage usage exceeds the total limit"),
            EndReason.disk,
            "20 MB to disk. Pod ephemeral local storage",
        ),
        (
            pod(phase="Failed", reason="Evicted", message="The node was low on resource: ephemeral-storage."),
            EndReason.lost,
            "low on resource: ephemeral-storage",
        ),
        (exited(143, phase="Failed", status_reason="Terminated", words=_SHUTDOWN), EndReason.lost, "shutdown"),
        (exited(0, phase="Failed", status_reason="NodeShutdown", words=_SHUTDOWN), EndReason.lost, "shutdown"),
        (pod(phase="Failed", reason="UnexpectedAdmissionError", message="no device"), EndReason.lost, "no device"),
    ],
)
def test_the_end_of_a_pod_has_a_reason(state: Pod, reason: EndReason, words: str) -> None:
    ending = ending_of(with_history(state, None), _RESOURCES)
    assert ending.reason is reason
    assert words in ending.message


def test_a_pod_whose_end_was_requested_while_it_ran_did_not_end_by_itself() -> None:
    running = pod({"running": {}}, phase="Running")
    deleted = pod({"running": {}}, phase="Running", metadata=_DELETED)
    good, good_then_deleted = ended(0, "Completed"), ended(0, "Completed", metadata=_DELETED)
    for states, reason in [
        ([running, good], EndReason.done),
        ([running, good, good_then_deleted], EndReason.done),
        ([running, deleted, good_then_deleted], EndReason.lost),
        ([pod({"running": {}}, phase="Running", conditions=_PREEMPTED), good], EndReason.lost),
    ]:
        seen = None
        for state in states:
            seen = with_history(state, seen)
        assert seen is not None
        assert ending_of(seen, _RESOURCES).reason is reason


@pytest.mark.parametrize(
    ("reason", "message", "expected"),
    [
        ("InvalidImageName", "couldn't parse image name", EndReason.image_unavailable),
        ("ErrImagePull", "docker.io/lab/slam:1: not found", EndReason.image_unavailable),
        ("ImagePullBackOff", "Back-off pulling image: unauthorized", EndReason.image_unavailable),
        ("ErrImagePull", "dial tcp: i/o timeout", None),
        ("ContainerCreating", "", None),
        ("CreateContainerConfigError", "image will run as root", EndReason.not_possible),
        ("RunContainerError", "exec /bin/x: exec format error", EndReason.command_not_found),
    ],
)
def test_what_never_starts_is_ended(reason: str, message: str, expected: EndReason | None) -> None:
    ending = failed_start(pod({"waiting": {"reason": reason, "message": message}}), 30)
    assert (ending.reason if ending else None) is expected
    assert ending is None or message in ending.message


def test_a_registry_is_waited_for_two_minutes() -> None:
    waiting = {"waiting": {"reason": "ErrImagePull", "message": "i/o timeout"}}
    assert failed_start(pod(waiting), 119) is None
    ending = failed_start(pod(waiting), 121)
    assert ending is not None
    assert ending.reason is EndReason.image_unavailable


def test_a_pod_that_waits_says_why() -> None:
    words = "0/3 nodes are available: 3 Insufficient nvidia.com/gpu."
    unschedulable = [{"type": "PodScheduled", "status": "False", "reason": "Unschedulable", "message": words}]
    assert words in (reason_waiting(pod(conditions=unschedulable)) or "")
    unschedulable[0]["message"] = "0/300 nodes are available: " + 100 * "1 node had an untolerated taint, "
    progress = Progress.model_validate({"fraction": 0, "message": reason_waiting(pod(conditions=unschedulable))})
    assert "untolerated" in progress.message
    assert "node-1" in (reason_waiting(pod({"waiting": {"reason": "ContainerCreating"}})) or "")
    assert reason_waiting(pod({"running": {}}, phase="Running")) is None
    assert reason_waiting(ended(0)) is None


def test_the_wait_for_a_node_is_measured() -> None:
    scheduled = [{"type": "PodScheduled", "status": "True", "lastTransitionTime": "2026-01-01T12:00:30Z"}]
    assert queued_s(pod(conditions=scheduled)) == 90
    assert queued_s(pod()) is None


class Output(Cluster):
    """The output of a pod, whose connection breaks after some lines."""

    def __init__(self, lines: list[bytes], breaks_after: int) -> None:
        self._lines_left = lines
        self._breaks_after = breaks_after

    def follow_log(self, pod: str, since_s: int | None) -> Iterator[list[bytes]]:
        """Yield some lines at a time."""
        for start in range(0, len(self._lines_left), 7):
            if start > self._breaks_after:
                self._breaks_after += 50
                raise ClusterUnavailable(0, "the test breaks it")
            yield self._lines_left[start : start + 7]


def test_why_a_pull_failed_is_known_until_the_next_one() -> None:
    image = f"registry.lab.example/actions/slam@sha256:{'a' * 64}"
    cause = f'rpc error: code = NotFound desc = failed to pull "{image}": failed to resolve "{image}": not found'
    failed = pod({"waiting": {"reason": "ErrImagePull", "message": cause}})
    later = pod({"waiting": {"reason": "ImagePullBackOff", "message": f'Back-off pulling image "{image}"'}})
    known = with_history(later, with_history(later, failed))
    ending = failed_start(known, 0)
    assert ending is not None
    assert ending.message.endswith("not found")
    progress = reason_waiting(known) or ""
    assert (progress.endswith("not found"), len(progress) <= 200) == (True, True)
    assert with_history(failed, later) == failed
    assert failed_start(with_history(later, None), 0) is None


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pod_log, "_RETRY_S", 0.0)


def copied(log: PodLog) -> None:
    log.finish()
    log.follow()
    assert log._thread is not None
    log._thread.join(30)
    assert log.is_complete


def test_each_line_is_copied_once_though_the_connection_breaks(tmp_path: Path) -> None:
    lines = [f"2026-01-01T12:00:00.{n // 9:03d}Z line {n}\n".encode() for n in range(400)]
    (tmp_path / "log").write_bytes(b"of an earlier start\n")
    copied(PodLog(Output(lines, 30), "a-pod", tmp_path))
    expected = b"of an earlier start\n" + b"".join(f"line {n}\n".encode() for n in range(400))
    assert (tmp_path / "log").read_bytes() == expected
    copied(PodLog(Output(lines, 10**6), "a-pod", tmp_path))
    assert (tmp_path / "log").read_bytes() == expected


def test_output_that_the_node_deleted_before_it_was_copied_is_noted(tmp_path: Path) -> None:
    lines = [f"2026-01-01T12:00:00.{n:03d}Z line {n}\n".encode() for n in range(9)]
    copied(PodLog(Output(lines[:3], 10**6), "a-pod", tmp_path))
    copied(PodLog(Output(lines[6:], 10**6), "a-pod", tmp_path))
    text = (tmp_path / "log").read_text()
    assert text.startswith("line 0\nline 1\nline 2\n")
    assert text.endswith("line 6\nline 7\nline 8\n")
    assert text.count("lines may be missing here") == 1


def test_what_a_node_says_of_itself_is_not_output(tmp_path: Path) -> None:
    lines = [b"2026-01-01T12:00:00Z a\n", b"2026-01-01T12:00:01Z b\n"]
    words = b"rpc error: code = Unavailable desc = connect: connection refused"
    broken = PodLog(Output([lines[0], words], 10**6), "a-pod", tmp_path)
    cursor, is_whole = broken._copy(broken._read_cursor())
    assert (cursor.lines, is_whole, (tmp_path / "log").read_bytes()) == (1, False, b"a\n")
    copied(PodLog(Output(lines, 10**6), "a-pod", tmp_path))
    assert (tmp_path / "log").read_bytes() == b"a\nb\n"


def test_times_of_any_precision_are_compared(tmp_path: Path) -> None:
    lines = [b"2026-01-01T12:00:00Z a\n", b"2026-01-01T12:00:00.1Z b\n", b"2026-01-01T12:00:00.12Z c\n"]
    copied(PodLog(Output(lines[:2], 10**6), "a-pod", tmp_path))
    copied(PodLog(Output(lines, 10**6), "a-pod", tmp_path))
    assert (tmp_path / "log").read_bytes() == b"a\nb\nc\n"


def test_a_line_in_pieces_is_one_line(tmp_path: Path) -> None:
    pieces = [b"2026-01-01T12:00:00Z " + b"x" * 100, b"2026-01-01 y" * 10, b"end\n", b"2026-01-01T12:00:01Z last\n"]
    copied(PodLog(Output(pieces, 10**6), "a-pod", tmp_path))
    assert (tmp_path / "log").read_bytes() == b"x" * 100 + b"2026-01-01 y" * 10 + b"end\nlast\n"


def test_a_full_log_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pod_log, "LOG_BYTES", 1000)
    lines = [f"2026-01-01T12:00:00.{n:03d}Z {'x' * 99}\n".encode() for n in range(50)]
    copied(PodLog(Output(lines, 10**6), "a-pod", tmp_path))
    text = (tmp_path / "log").read_text()
    assert text.count("x" * 99) == 10
    assert text.count("the log is full") == 1


def test_a_report_is_written_as_lines_and_a_damaged_one_is_noticed() -> None:
    findings = [Finding(severity=Severity.warning, code="imu.gap", message=f"{n * 7919}") for n in range(5000)]
    finish = RunFinish(attempt=2, reason=EndReason.done, message="", report=Report(findings=findings))
    lines = [b"a warning of a library", *finish_lines(finish)]
    assert max(map(len, lines)) < 16 * 2**10
    assert read_finish(b"\n".join(lines) + b"\n") == finish
    for damaged in (lines[:-1], [*lines[:3], *lines[4:]], [lines[0]]):
        with pytest.raises(ValueError, match="its output"):
            read_finish(b"\n".join(damaged))


def test_a_termination_message_is_short_enough() -> None:
    outcome = FetchOutcome(ending=Ending(EndReason.inputs_unavailable, "ü" * 10_000))
    assert len(outcome.text().encode()) < 4096
    parsed = FetchOutcome.parse(outcome.text())
    assert parsed is not None
    assert parsed.ending is not None
    assert parsed.ending.reason is EndReason.inputs_unavailable
    assert FetchOutcome.parse("Killed") is None


_SEPARATED = {
    "none": Reached(server=False, other=False),
    "api": Reached(server=True, other=False),
    "open": Reached(server=True, other=True),
}
_ALL_OPEN = dict.fromkeys(_SEPARATED, Reached(server=True, other=True))
_ALL_CLOSED = dict.fromkeys(_SEPARATED, Reached(server=False, other=False))


@pytest.mark.parametrize(
    ("reached", "networks"),
    [
        (_SEPARATED, {Network.none, Network.api, Network.open}),
        # The network plugin ignores policies.
        (_ALL_OPEN, {Network.open}),
        # Nothing reaches anything: that `none` does not says nothing.
        (_ALL_CLOSED, {Network.open}),
        ({**_SEPARATED, "api": Reached(server=False, other=False)}, {Network.none, Network.open}),
        ({"open": _SEPARATED["open"]}, {Network.open}),
        ({}, set()),
        ({**_SEPARATED, "open": Reached(server=True, other=True, metadata=True)}, {Network.none, Network.api}),
        ({**_SEPARATED, "none": Reached(server=False, other=False, metadata=True)}, {Network.api, Network.open}),
    ],
)
def test_a_network_is_offered_once_it_was_seen_to_be_separated(
    reached: Mapping[str, Reached], networks: set[Network]
) -> None:
    assert judge(reached) == networks


def test_names_fit_into_labels() -> None:
    names = Names.of("00000000-0000-0000-0000-000000000000-2147483647")
    assert max(map(len, names)) <= 63
    for key in ("A", "a_b", "a" * 60):
        with pytest.raises(ValueError, match="name in Kubernetes"):
            Names.of(key)


def test_tolerations_are_read_as_taints_are_written() -> None:
    assert Toleration.split("nvidia.com/gpu") == {"key": "nvidia.com/gpu", "value": None, "effect": None}
    assert Toleration.split("team=slam:NoSchedule") == {"key": "team", "value": "slam", "effect": "NoSchedule"}
