"""Runs over HTTP, with a fake runner."""

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
from tests.integration.upload_client import complete_all, crc64, md5, sha256, upload

_POOL = urllib3.PoolManager(retries=False, timeout=30)
GB = 10**9


@dataclass
class FakeRunner:
    """A runner that sends the requests of a test. Its own label keeps it from claiming runs of others."""

    api: Api
    id: str = field(default_factory=lambda: str(uuid.uuid4()))
    labels: list[str] = field(default_factory=lambda: [f"only-{uuid.uuid4().hex[:8]}"])
    active_ids: list[str] = field(default_factory=list)

    def registration(self, **abilities: Any) -> dict[str, Any]:
        """Return its description: a container engine, unless `abilities` differ."""
        usual = {
            "executor": "docker",
            "isolation": "container",
            "images": True,
            "networks": ["none", "api", "open"],
            "gpus": False,
            "bounds_memory": True,
            "bounds_disk": True,
        }
        return {
            "id": self.id,
            "name": f"runner {self.id[:4]}",
            "labels": self.labels,
            "capacity": {"cores": 4, "memory_bytes": 16 * GB, "disk_bytes": 100 * GB, "gpus": 0},
            "abilities": usual | abilities,
            "default_image": "sha256:stock",
            "version": "0",
        }

    def register(self, **abilities: Any) -> Any:
        """Register it, or update its description."""
        return self.api.post("/runners", self.registration(**abilities)).ok()

    def claim(self, wait_s: float = 0, **free: Any) -> Any:
        """Claim a run, as a runner does that knows of one at a time; None where there is none."""
        claims = self._claim(wait_s, free)
        assert len(claims) <= 1
        return claims[0] if claims else None

    def claim_several(self, max_runs: int, wait_s: float = 0, **free: Any) -> list[Any]:
        """Claim runs."""
        return self._claim(wait_s, free, max_runs=max_runs)

    def _claim(self, wait_s: float, free: Mapping[str, Any], **values: int) -> list[Any]:
        capacity = {"cores": 4, "memory_bytes": 16 * GB, "disk_bytes": 100 * GB, "gpus": 0, **free}
        requested = {"free": capacity, "wait_s": wait_s, "active_run_ids": self.active_ids, **values}
        reply = self.api.post(f"/runners/{self.id}/claims", requested).ok()
        claims = [] if reply["run"] is None else [reply["run"], *reply["more"]]
        self.active_ids += [claim["run_id"] for claim in claims]
        return claims

    def heartbeat(self, claim: Mapping[str, Any], state: str = "running", **values: Any) -> str:
        """Send the state of a run; return the status of its lease."""
        one = {"run_id": claim["run_id"], "attempt": claim["attempt"], "state": state, **values}
        (answer,) = self.api.post(f"/runners/{self.id}/heartbeats", {"runs": [one]}).ok()["runs"]
        return str(answer["status"])

    def write(self, claim: Mapping[str, Any], offset: int, data: bytes) -> None:
        """Upload and confirm a chunk of the log."""
        place = {"attempt": claim["attempt"], "offset": offset, "size_bytes": len(data)}
        sums = {"sha256": sha256(data), "crc64nvme": crc64(data), "md5": md5(data)}
        signed = self.api.post(f"/runner/runs/{claim['run_id']}/log-chunks", place | sums).ok()
        # Repeated, as runners do: a proxy may have just closed the connection.
        sent = _POOL.request("PUT", signed["url"], body=data, headers=signed["headers"], retries=3)
        # 412: the first request was stored, and its response lost.
        assert sent.status in {200, 412}
        self.api.post(f"/runner/runs/{claim['run_id']}/log-chunks/confirm", place).ok(204)

    def begin(self, claim: Mapping[str, Any], path: str, data: bytes) -> Any:
        """Open the upload of an artifact."""
        return self._begin(claim, {path: data})[path]

    def _begin(self, claim: Mapping[str, Any], files: Mapping[str, bytes]) -> dict[str, Any]:
        expected = [{"path": path, "size_bytes": len(data), "sha256": sha256(data)} for path, data in files.items()]
        body = {"attempt": claim["attempt"], "files": expected}
        decisions = self.api.post(f"/runner/runs/{claim['run_id']}/uploads", body).ok()["items"]
        assert {decision["decision"] for decision in decisions} == {"upload"}, decisions
        return {path: decision["upload"] for path, decision in zip(files, decisions, strict=True)}

    def upload_artifact(self, claim: Mapping[str, Any], path: str, data: bytes) -> None:
        """Upload an artifact."""
        self.upload_artifacts(claim, {path: data})

    def upload_artifacts(self, claim: Mapping[str, Any], files: Mapping[str, bytes]) -> None:
        """Upload artifacts with few requests."""
        complete_all(self.api, self._begin(claim, files), files)

    def finish(self, claim: Mapping[str, Any], reason: str = "done", **values: Any) -> Answer:
        """Report the end of a run."""
        body = {"attempt": claim["attempt"], "reason": reason, "message": "", "exit_code": 0, **values}
        return self.api.post(f"/runner/runs/{claim['run_id']}/finish", body)


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    """An API of this module alone, so that its queue has no other runs."""
    return start_api()


@pytest.fixture
def runner(lab: Api) -> FakeRunner:
    """A registered runner."""
    admin = people.person(lab, admin=True)
    fake_runner = FakeRunner(lab.as_(people.token(lab, admin, [Scope.run], kind=TokenKind.runner).secret))
    fake_runner.register()
    return fake_runner


def another(lab: Api, like: FakeRunner) -> FakeRunner:
    """Return a further runner with the same labels, and with a token of its own."""
    admin = people.person(lab, admin=True)
    token = people.token(lab, admin, [Scope.run], kind=TokenKind.runner)
    return FakeRunner(lab.as_(token.secret), labels=like.labels)


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


def definition(runner: FakeRunner, **values: Any) -> dict[str, Any]:
    """Return an action that only this runner is eligible for."""
    resources = {"labels": runner.labels, **values.pop("resources", {})}
    return {"name": "count", "script": "print('hello')\n", "resources": resources, **values}


def launch(api: Api, runner: FakeRunner, mission: Any, *, force: bool = True, **values: Any) -> Any:
    """Launch a run and return it."""
    parameters = values.pop("given", {})
    expected = {"mission_ids": [mission["id"]], "definition": definition(runner, **values), "parameters": parameters}
    (made,) = api.post("/runs", expected | {"force": force}).ok()["items"]
    assert made["outcome"] == "created", made
    return made["run"]
