"""The node of the fake cluster: pods of Kleinkram are processes, actions are jobs of a `ProcessExecutor`."""

from __future__ import annotations

import datetime
import ipaddress
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, Ending, RunJob
from kleinkram.runner.executors.kubernetes.network_probe import METADATA_SERVICE
from kleinkram.runner.executors.process import ProcessExecutor

if TYPE_CHECKING:
    from tests.integration.kubernetes.fake_cluster import FakeCluster

Body = dict[str, Any]
NODE = "node-1"
_POLL_S = 0.02
_EPOCH = datetime.datetime(2026, 1, 1, tzinfo=datetime.timezone.utc)
# Where the API server is, whatever a pod asks for.
_OF_EVERY_POD = {"KUBERNETES_SERVICE_HOST": "10.96.0.1", "KUBERNETES_SERVICE_PORT": "443"}
# So many lines have the same time.
_LINES_PER_TIME = 20


class FakeNode:
    """Runs the pods of a cluster."""

    def __init__(self, cluster: FakeCluster) -> None:
        self._cluster = cluster
        self._executor = ProcessExecutor()
        self._stops: dict[str, threading.Event] = {}
        self._threads: list[threading.Thread] = []
        self._jobs: dict[str, RunJob] = {}
        self._ended: set[str] = set()
        self.ignores_deletions = False
        # So many pods of Kleinkram end without saying how.
        self.silent_ends = 0
        # So many pods of Kleinkram crash.
        self.crashes = 0
        # So many outputs of ended pods are answered with the words of a node that cannot read them.
        self.unreadable_outputs = 0
        self._imposed: dict[str, Body] = {}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, pod: Body, job: Body) -> None:
        """Run a pod in a thread."""
        name = pod["metadata"]["name"]
        self._stops[name] = threading.Event()
        thread = threading.Thread(target=self._run, args=(name, pod, job), daemon=True)
        self._threads.append(thread)
        thread.start()

    def stop(self, name: str) -> None:
        """Have a pod ended and removed."""
        if not self.ignores_deletions:
            self._stops[name].set()

    def end(self, name: str, status: Body) -> None:
        """End an action from outside: its pod then has this status."""
        self._imposed[name] = status

    def kill(self, name: str) -> None:
        """Kill the process of a pod of Kleinkram."""
        self._processes[name].kill()

    def close(self) -> None:
        """End all pods."""
        for stop in self._stops.values():
            stop.set()
        for thread in self._threads:
            thread.join(20)

    def _run(self, name: str, pod: Body, job: Body) -> None:
        stop, spec = self._stops[name], pod["spec"]
        try:
            if not self._prepare(name, spec, stop):
                return
            if pod["metadata"]["labels"]["kleinkram.step"] == "action":
                status = self._run_action(name, pod, stop)
            else:
                status = self._run_transfer(name, pod, stop)
            self._ended.add(name)
            self._cluster.change_pod(name, status)
        finally:
            self._ended.add(name)
            if stop.is_set() or self._cluster.is_closed:
                self._cluster.drop_pod(name)
            else:
                threading.Thread(target=self._drop_once_deleted, args=(name,), daemon=True).start()

    def _drop_once_deleted(self, name: str) -> None:
        self._stops[name].wait()
        self._cluster.drop_pod(name)

    def _prepare(self, name: str, spec: Body, stop: threading.Event) -> bool:
        """Schedule a pod and wait for what it needs; return whether it can start."""
        cluster = self._cluster
        while (words := cluster.unschedulable) is not None:
            scheduled = {"type": "PodScheduled", "status": "False", "reason": "Unschedulable", "message": words}
            cluster.change_pod(name, {"conditions": [scheduled]})
            if stop.wait(_POLL_S):
                return False
        spec["nodeName"] = NODE
        scheduled = {"type": "PodScheduled", "status": "True", "lastTransitionTime": _time()}
        creating = _status({"waiting": {"reason": "ContainerCreating"}})
        cluster.change_pod(name, {"conditions": [scheduled], "startTime": _time(), "containerStatuses": creating})
        while error := cluster.image_errors.get(spec["containers"][0]["image"]):
            waiting = {"waiting": {"reason": error[0], "message": error[1]}}
            cluster.change_pod(name, {"containerStatuses": _status(waiting)})
            # The cause is told for a moment only.
            waiting = {"waiting": {"reason": "ImagePullBackOff", "message": "Back-off pulling image"}}
            cluster.change_pod(name, {"containerStatuses": _status(waiting)})
            if stop.wait(_POLL_S):
                return False
        return all(self._wait_for(volume, stop) for volume in spec["volumes"])

    def _wait_for(self, volume: Body, stop: threading.Event) -> bool:
        def is_there() -> bool:
            with self._cluster.changed:
                if "secret" in volume:
                    return volume["secret"]["secretName"] in self._cluster.objects["secrets"]
                claim = volume.get("persistentVolumeClaim", {}).get("claimName")
                if claim is None or self._cluster.has_every_claim:
                    return True
                return claim in self._cluster.objects["persistentvolumeclaims"]

        while not is_there():
            if stop.wait(_POLL_S):
                return False
        return True

    # -- pods of Kleinkram ---------------------------------------------------------------------------------------------

    def _run_transfer(self, name: str, pod: Body, stop: threading.Event) -> Body:
        folder = self._folder(name)
        container = pod["spec"]["containers"][0]
        places: dict[str, str] = {}
        for volume in pod["spec"]["volumes"]:
            mounts = [it["mountPath"] for it in container["volumeMounts"] if it["name"] == volume["name"]]
            places |= dict.fromkeys(mounts, str(self._place(folder, volume)))
        words = [_replaced(word, places) for word in container["command"][1:]]
        outcome = folder / "termination-log"
        command = [sys.executable, *[word.replace("$$", "$") for word in words], "--outcome", str(outcome)]
        environment = {it["name"]: _replaced(it["value"], places) for it in container["env"]}
        if pod["metadata"]["labels"]["kleinkram.step"] == "probe":
            targets = [word.split() for word in words if " " in word]
            outcome.write_text(json.dumps([self._is_reachable(pod, host) for host, _ in targets]))
            return _ended({"exitCode": 0, "reason": "Completed", "message": outcome.read_text()})
        started_at = _time()
        if self.crashes:
            self.crashes -= 1
            output = "Traceback (most recent call last):\nOSError: [Errno 28] No space left on device"
            return _ended({"exitCode": 1, "reason": "Error", "message": output, "startedAt": started_at})
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(
                command, env={"PATH": os.defpath, **environment}, stdout=log, stderr=subprocess.STDOUT
            )
            self._processes[name] = process
            running = _status({"running": {"startedAt": started_at}})
            self._cluster.change_pod(name, {"phase": "Running", "containerStatuses": running})
            while process.poll() is None:
                if stop.wait(_POLL_S):
                    process.kill()
        message = outcome.read_text() if outcome.exists() and not self.silent_ends else ""
        self.silent_ends = max(0, self.silent_ends - 1)
        code = process.wait()
        reason = "Completed" if code == 0 else "Error"
        return _ended({"exitCode": code & 255, "reason": reason, "message": message, "startedAt": started_at})

    def _is_reachable(self, pod: Body, host: str) -> bool:
        """Whether the policies that select a pod let it reach an address; without any, it reaches all."""
        labels = pod["metadata"]["labels"]
        policies = [
            policy["spec"]
            for policy in self._cluster.network_policies
            if policy["spec"]["podSelector"]["matchLabels"].items() <= labels.items()
            and "Egress" in policy["spec"]["policyTypes"]
        ]
        is_metadata = host == METADATA_SERVICE[0]
        if is_metadata and not self._cluster.has_metadata:
            return False
        if not policies or self._cluster.ignores_policies:
            return True
        # Names are those of addresses that no rule excepts.
        address = ipaddress.ip_address(host if re.fullmatch(r"[0-9.]+", host) else "10.96.0.1")
        blocks = [
            peer["ipBlock"]
            for policy in policies
            for rule in policy.get("egress", [])
            if {port["port"] for port in rule.get("ports", [])} != {53}
            for peer in rule["to"]
            if "ipBlock" in peer
        ]
        return any(
            address in ipaddress.ip_network(block["cidr"])
            and not any(address in ipaddress.ip_network(it) for it in block.get("except", []))
            for block in blocks
        )

    def _place(self, folder: Path, volume: Body) -> Path:
        if "persistentVolumeClaim" in volume:
            place: Path = self._cluster.folder_of(volume["persistentVolumeClaim"]["claimName"])
            return place
        place = folder / volume["name"]
        place.mkdir(exist_ok=True)
        if "secret" in volume:
            for file, data in (self._cluster.secret_files(volume["secret"]["secretName"]) or {}).items():
                (place / file).write_bytes(data)
        return place

    # -- actions -------------------------------------------------------------------------------------------------------

    def _run_action(self, name: str, pod: Body, stop: threading.Event) -> Body:
        job = self._job_of(name, pod)
        self._jobs[name] = job
        try:
            self._executor.submit(job)
        except CannotStart as error:
            return _ended({"exitCode": 128, "reason": "StartError", "message": str(error)})
        started_at = _time()
        running = _status({"running": {"startedAt": started_at}})
        self._cluster.change_pod(name, {"phase": "Running", "containerStatuses": running})
        is_cancelled = False
        while (ending := self._executor.poll(job)) is None:
            if name in self._imposed:
                self._executor.remove(job)
                return {**_ended({"exitCode": 137, "reason": "Error"}), **self._imposed[name]}
            if not is_cancelled and stop.is_set():
                is_cancelled = True
                self._executor.cancel(job)
            time.sleep(_POLL_S)
        return _status_of(ending, started_at)

    def _job_of(self, name: str, pod: Body) -> RunJob:
        folder, spec = self._folder(name), pod["spec"]
        container = spec["containers"][0]
        (claim,) = [it["persistentVolumeClaim"]["claimName"] for it in spec["volumes"] if "persistentVolumeClaim" in it]
        inside, outside = (self._cluster.folder_of(claim) / part for part in ("in", "out"))
        inside.mkdir(exist_ok=True)
        # The sandbox mounts no links for reading.
        shutil.copytree(inside, folder / "in")
        outside.mkdir(exist_ok=True)
        (folder / "out").symlink_to(outside)
        limits = container["resources"]["limits"]
        environment = {**_OF_EVERY_POD, **{it["name"]: it["value"] for it in container["env"]}}
        for source in container.get("envFrom", []):
            files = self._cluster.secret_files(source["secretRef"]["name"]) or {}
            environment |= {key: value.decode() for key, value in files.items()}
        label = pod["metadata"]["labels"]["kleinkram.network"]
        return RunJob(
            key=name,
            directory=folder,
            command=[_in_image(word.replace("$$", "$")) for word in container["args"]],
            image=None,
            resources=Resources(
                cores=float(limits["cpu"].removesuffix("m")) / 1000,
                memory_bytes=int(limits["memory"]),
                disk_bytes=int(limits["ephemeral-storage"]),
                time_s=spec["activeDeadlineSeconds"],
            ),
            network=Network.none if label == "none" else Network.open,
            environment={key: value for key, value in environment.items() if key not in {"HOME", "TMPDIR"}},
        )

    def _folder(self, name: str) -> Path:
        folder = self._cluster.folder / "pods" / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def log(self, name: str, query: Mapping[str, str]) -> Iterator[bytes]:
        """Yield the output of a pod, with times that its lines keep."""
        from tests.integration.kubernetes.fake_cluster import Refused

        path = self._cluster.folder / "pods" / name / "log"
        if name not in self._cluster.objects["pods"]:
            raise Refused(404, f'pods "{name}" not found')
        if "follow" not in query and self.unreadable_outputs:
            self.unreadable_outputs -= 1
            return iter([b"unable to retrieve container logs for containerd://0123"])

        def pieces() -> Iterator[bytes]:
            number, pending, offset, stamp = 0, b"", 0, b""
            while True:
                is_over = name in self._ended or "follow" not in query
                data = _read(path, offset)
                offset += len(data)
                *lines, pending = (pending + data).split(b"\n")
                if is_over and not data and pending:
                    lines, pending = [pending], b""
                answer: list[bytes] = []
                for line in lines:
                    if number % _LINES_PER_TIME == 0:
                        at = _EPOCH + datetime.timedelta(milliseconds=number // _LINES_PER_TIME)
                        stamp = re.sub(r"\.?0+Z$", "Z", f"{at:%Y-%m-%dT%H:%M:%S.%f}Z").encode() + b" "
                    answer.append((stamp if "timestamps" in query else b"") + line + b"\n")
                    number += 1
                yield b"".join(answer)
                if is_over and not data:
                    return
                if not data:
                    time.sleep(_POLL_S)

        return pieces()


def _status_of(ending: Ending, started_at: str) -> Body:
    """Return what a cluster says of an action that ended so."""
    if ending.reason is EndReason.time:
        return {**_ended({"exitCode": 137, "reason": "Error"}), "phase": "Failed", "reason": "DeadlineExceeded"}
    if ending.reason is EndReason.disk:
        words = 'Usage of EmptyDir volume "tmp" exceeds the limit "20M".'
        return {**_ended({"exitCode": 137, "reason": "Error"}), "reason": "Evicted", "message": words}
    if ending.reason is EndReason.command_not_found:
        words = f"failed to create containerd task: exec: {ending.message}: no such file or directory"
        return _ended({"exitCode": 128, "reason": "StartError", "message": words})
    code, reason = ending.exit_code, "Error"
    if ending.reason is EndReason.memory:
        code, reason = 137, "OOMKilled"
    elif ending.reason is EndReason.cancelled:
        # Also one that handles the signal, and ends well.
        code, reason = (0, "Completed") if ending.exit_code == 0 else (143, reason)
    elif ending.reason is EndReason.done:
        reason = "Completed"
    return _ended({"exitCode": 255 if code is None else code, "reason": reason, "startedAt": started_at})


def _ended(terminated: Body) -> Body:
    phase = "Succeeded" if terminated["exitCode"] == 0 else "Failed"
    return {"phase": phase, "containerStatuses": _status({"terminated": {"finishedAt": _time(), **terminated}})}


def _status(state: Body) -> list[Body]:
    return [{"name": "main", "state": state}]


def _replaced(word: str, places: Mapping[str, str]) -> str:
    for inside, outside in places.items():
        if word == inside or word.startswith(inside + "/"):
            return outside + word[len(inside) :]
    return word


def _time() -> str:
    return datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds").replace("+00:00", "Z")


def _read(path: Path, offset: int) -> bytes:
    if not path.exists():
        return b""
    with path.open("rb") as stream:
        stream.seek(offset)
        return stream.read(2**18)


def _in_image(word: str) -> str:
    """Return the Python of this machine for that of an image."""
    return sys.executable if word == "python3" else word
