"""Runs over HTTP, with a runner played by the test."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest
import urllib3

from kleinkram.contract.access import Scope, TokenKind
from tests.integration import people
from tests.integration.api_server import Answer, Api
from tests.integration.conftest import StartApi
from tests.integration.upload_client import crc64, md5, send, sha256, upload

_POOL = urllib3.PoolManager(retries=False, timeout=30)
GB = 10**9


@dataclass
class Played:
    """A runner that says what a test wants. What it claims carries its label: no other's runs."""

    api: Api
    id: str = field(default_factory=lambda: str(uuid.uuid4()))
    labels: list[str] = field(default_factory=lambda: [f"only-{uuid.uuid4().hex[:8]}"])
    active_ids: list[str] = field(default_factory=list)

    def hello(self, **abilities: Any) -> Any:
        """Say what it is: a container engine, unless said otherwise."""
        usual = {
            "executor": "docker",
            "isolation": "container",
            "images": True,
            "networks": ["none", "api", "open"],
            "gpus": False,
            "bounds_memory": True,
            "bounds_disk": True,
        }
        values = {
            "id": self.id,
            "name": f"runner {self.id[:4]}",
            "labels": self.labels,
            "capacity": {"cores": 4, "memory_bytes": 16 * GB, "disk_bytes": 100 * GB, "gpus": 0},
            "abilities": usual | abilities,
            "default_image": "sha256:stock",
            "version": "0",
        }
        return self.api.post("/runners", values).ok()

    def claim(self, wait_s: float = 0, **free: Any) -> Any:
        """Ask for a run; None where there is none."""
        room = {"cores": 4, "memory_bytes": 16 * GB, "disk_bytes": 100 * GB, "gpus": 0} | free
        requested = {"free": room, "wait_s": wait_s, "active_run_ids": self.active_ids}
        result = self.api.post(f"/runners/{self.id}/claims", requested).ok()["run"]
        if result is not None:
            self.active_ids.append(result["run_id"])
        return result

    def heartbeat(self, claim: Mapping[str, Any], state: str = "running", **values: Any) -> str:
        """Say what a run is at; returns the verdict."""
        one = {"run_id": claim["run_id"], "attempt": claim["attempt"], "state": state, **values}
        (answer,) = self.api.post(f"/runners/{self.id}/heartbeats", {"runs": [one]}).ok()["runs"]
        return str(answer["status"])

    def write(self, claim: Mapping[str, Any], offset: int, data: bytes) -> None:
        """Store a piece of the log, and show it."""
        place = {"attempt": claim["attempt"], "offset": offset, "size_bytes": len(data)}
        sums = {"sha256": sha256(data), "crc64nvme": crc64(data), "md5": md5(data)}
        signed = self.api.post(f"/runner/runs/{claim['run_id']}/log-chunks", place | sums).ok()
        # Tried again, as runners do: a proxy may have just ended the connection that was kept.
        sent = _POOL.request("PUT", signed["url"], body=data, headers=signed["headers"], retries=3)
        # 412: the first try was kept, and its answer lost.
        assert sent.status in {200, 412}
        self.api.post(f"/runner/runs/{claim['run_id']}/log-chunks/confirm", place).ok(204)

    def begin(self, claim: Mapping[str, Any], path: str, data: bytes) -> Any:
        """Open the upload of an artifact."""
        expected = {"path": path, "size_bytes": len(data), "sha256": sha256(data)}
        body = {"attempt": claim["attempt"], "files": [expected]}
        (decision,) = self.api.post(f"/runner/runs/{claim['run_id']}/uploads", body).ok()["items"]
        assert decision["decision"] == "upload", decision
        return decision["upload"]

    def leave(self, claim: Mapping[str, Any], path: str, data: bytes) -> None:
        """Upload an artifact."""
        begun = self.begin(claim, path, data)
        send(self.api, begun, data)
        finish = {"upload_id": begun["id"], "sha256": sha256(data), "crc64nvme": crc64(data)}
        (outcome,) = self.api.post("/uploads/complete", {"uploads": [finish]}).ok()["items"]
        assert outcome["outcome"] == "completed", outcome

    def finish(self, claim: Mapping[str, Any], reason: str = "done", **values: Any) -> Answer:
        """Say how a run ended."""
        body = {"attempt": claim["attempt"], "reason": reason, "message": "", "exit_code": 0, **values}
        return self.api.post(f"/runner/runs/{claim['run_id']}/finish", body)


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    """An API of this module's own: its queue is nobody else's."""
    return start_api()


@pytest.fixture
def runner(lab: Api) -> Played:
    """A runner that has said hello."""
    admin = people.person(lab, admin=True)
    played = Played(lab.as_(people.token(lab, admin, [Scope.run], kind=TokenKind.runner).secret))
    played.hello()
    return played


def another(lab: Api, like: Played) -> Played:
    """Return a further runner with the same labels, and with a token of its own."""
    admin = people.person(lab, admin=True)
    token = people.token(lab, admin, [Scope.run], kind=TokenKind.runner)
    return Played(lab.as_(token.secret), labels=like.labels)


@dataclass(frozen=True)
class Place:
    """A mission with two files."""

    project: Any
    mission: Any
    files: dict[str, Any]


@pytest.fixture
def place(lab: Api) -> Place:
    """A mission with two files."""
    project = lab.project()
    mission = lab.mission(project["id"])
    bodies = {"drive.bin": uuid.uuid4().bytes, "notes/day.txt": uuid.uuid4().bytes}
    return Place(project, mission, {path: upload(lab, mission["id"], path, body) for path, body in bodies.items()})


def definition(runner: Played, **values: Any) -> dict[str, Any]:
    """An action that only this runner does."""
    resources = {"labels": runner.labels, **values.pop("resources", {})}
    return {"name": "count", "script": "print('hello')\n", "resources": resources, **values}


def launch(api: Api, runner: Played, mission: Any, *, force: bool = True, **values: Any) -> Any:
    """Put a run into the queue; returns it."""
    parameters = values.pop("given", {})
    expected = {"mission_ids": [mission["id"]], "definition": definition(runner, **values), "parameters": parameters}
    (made,) = api.post("/runs", expected | {"force": force}).ok()["items"]
    assert made["outcome"] == "created", made
    return made["run"]
