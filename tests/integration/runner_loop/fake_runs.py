"""The runs of the fake server."""

from __future__ import annotations

import hashlib
import uuid
from dataclasses import dataclass, field
from typing import Any

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.reports import Progress
from kleinkram.contract.runners import LEASE_S, AssignedInput, RunAssignment, RunFinish
from kleinkram.contract.runs import ActionRef, RunPlacement, RunState


@dataclass
class FakeRun:
    """A run on the server: its assignment, and what its runner reported and uploaded."""

    claim: RunAssignment
    inputs: dict[str, bytes]
    state: RunState = RunState.queued
    runner_id: uuid.UUID | None = None
    attempt: int = 0
    is_cancelled: bool = False
    finishes: list[RunFinish] = field(default_factory=list)
    artifacts: dict[str, bytes] = field(default_factory=dict)
    segments: list[tuple[int, bytes]] = field(default_factory=list)
    states: list[RunState] = field(default_factory=list)
    progress: list[Progress] = field(default_factory=list)
    digest: str | None = None
    placement: RunPlacement | None = None

    @property
    def shown_log(self) -> bytes:
        """The log as people saw it while the run lasted; pieces follow each other without gap."""
        shown = b""
        for offset, piece in self.segments:
            assert offset == len(shown), "a piece of the log is missing or there twice"
            shown += piece
        return shown


def queued(code: str, input_bytes: dict[str, bytes], changes: dict[str, Any]) -> FakeRun:
    """Return a queued run of a script with some inputs, with changes."""
    resources = {"cores": 1, "memory_bytes": 200_000_000, "disk_bytes": 50_000_000, "time_s": 60}
    resources |= changes.pop("resources", {})
    values: dict[str, Any] = {
        "run_id": uuid.uuid4(),
        "attempt": 1,
        "project_id": uuid.uuid4(),
        "mission_id": uuid.uuid4(),
        "action": ActionRef(name="an-action", version=1),
        "image": None,
        "image_digest": None,
        "command": [],
        "script": code,
        "dependencies": [],
        "parameters": {},
        "resources": Resources.model_validate(resources),
        "network": Network.none,
        "inputs": [
            AssignedInput(path=path, size_bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
            for path, data in input_bytes.items()
        ],
        "token": None,
        "lease_s": LEASE_S,
    }
    return FakeRun(RunAssignment.model_validate({**values, **changes}), input_bytes)
