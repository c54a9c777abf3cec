"""A fake cluster: an API server over HTTP with the routes that runners use, and a node that runs pods as processes.

The API server refuses what the role does not allow, and bodies that the schemas of Kubernetes do not know. It is not a
cluster: its pods start at once, its network policies are only looked at, and its volumes are folders.
"""

from __future__ import annotations

import base64
import copy
import datetime
import itertools
import json
import re
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import kubernetes_validate

from tests.http_server import Server
from tests.integration.kubernetes.fake_http import ApiHandler
from tests.integration.kubernetes.fake_node import FakeNode

Body = dict[str, Any]
TOKEN = "the-token-of-a-service-account"
NAMESPACE = "runs"
VERSIONS = ("1.27", "1.37")
_PATH = re.compile(r"/(?:api/v1|apis/batch/v1)/namespaces/([^/]+)/([a-z]+)(?:/([^/]+))?(?:/(log))?")
_KINDS = {"Job": "jobs", "Secret": "secrets", "PersistentVolumeClaim": "persistentvolumeclaims"}


_REASONS = {403: "Forbidden", 404: "NotFound", 409: "AlreadyExists", 429: "TooManyRequests", 504: "Timeout"}
# In `fails`: the request is done, and its answer comes too late.
LATE = 504


class Refused(Exception):
    """An answer of the API server that is an error."""

    def __init__(self, code: int, message: str, reason: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.reason = _REASONS.get(code, "") if reason is None else reason


class FakeCluster:
    """A cluster with one namespace. Tests change its fields at any time.

    `rules` are those of a Role; None allows all. `unschedulable`: what the scheduler says while it finds no node.
    `image_errors`: reason and message by image. `folder_of` is where the volume of a claim is. `is_away`: the API
    server does not answer. With `folder_of`, every claim exists. `creates_pods`: its Job controller does.
    `replaces_deleted_pods`: it starts another pod for one that was deleted, as Kubernetes 1.20 does. `fails`: the
    answers to the next requests, by verb and resource, or for names with an ending (`create`, `jobs`, `-store`).
    `quotas`: what refuses new objects, by kind, or kind and ending of the name. `has_metadata`: nodes reach the
    metadata service of a cloud.
    """

    def __init__(self, folder: Path, *, folder_of: Callable[[str], Path] | None = None) -> None:
        self.folder = folder
        self.has_every_claim = folder_of is not None
        self.folder_of = folder_of or (lambda claim: folder / "claims" / claim)
        self.rules: Sequence[Mapping[str, Any]] | None = None
        self.requests: list[tuple[str, str]] = []
        self.created: list[Body] = []
        self.unschedulable: str | None = None
        self.image_errors: dict[str, tuple[str, str]] = {}
        self.network_policies: list[Body] = []
        self.ignores_policies = False
        self.fails: dict[tuple[str, ...], list[Refused | int]] = {}
        self.quotas: dict[tuple[str, ...], str] = {}
        self.has_metadata = False
        self.is_away = threading.Event()
        self.creates_pods = True
        self.replaces_deleted_pods = False
        self.objects: dict[str, dict[str, Body]] = {
            kind: {} for kind in ("jobs", "pods", "secrets", "persistentvolumeclaims")
        }
        self.changed = threading.Condition()
        self.is_closed = False
        self._versions = itertools.count(1)
        self._events: list[tuple[int, str, Body]] = []
        self._oldest_version = 0
        self.node = FakeNode(self)
        cluster = self

        class OfThis(ApiHandler):
            fake = cluster

        self._http = Server(("127.0.0.1", 0), OfThis)
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._http.server_port}"

    def kubeconfig(self) -> Path:
        """Write the file by which a client finds this cluster."""
        path = self.folder / "kubeconfig"
        content = {
            "apiVersion": "v1",
            "kind": "Config",
            "current-context": "fake",
            "contexts": [{"name": "fake", "context": {"cluster": "fake", "user": "fake", "namespace": NAMESPACE}}],
            "clusters": [{"name": "fake", "cluster": {"server": self.url}}],
            "users": [{"name": "fake", "user": {"token": TOKEN}}],
        }
        path.write_text(json.dumps(content))
        return path

    def close(self) -> None:
        """End all pods, and the API server."""
        with self.changed:
            self.is_closed = True
            self.changed.notify_all()
        self.node.close()
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    def forget_versions(self) -> None:
        """Compact the history: watches from earlier versions are refused."""
        with self.changed:
            self._oldest_version = next(self._versions)
            self._events.clear()
            self.changed.notify_all()

    def named(self, kind: str, suffix: str = "") -> list[Body]:
        """Return the objects of a kind whose names end so."""
        with self.changed:
            return [it for it in self.objects[kind].values() if it["metadata"]["name"].endswith(suffix)]

    # -- requests ------------------------------------------------------------------------------------------------------

    def answer(self, method: str, target: str, body: bytes, authorization: str | None) -> Body | Iterator[bytes]:
        """Answer a request by an object, or by the lines of a stream."""
        parts = urlsplit(target)
        query = dict(parse_qsl(parts.query))
        match = _PATH.fullmatch(parts.path)
        if authorization != f"Bearer {TOKEN}":
            raise Refused(401, "Unauthorized")
        if match is None or match[1] != NAMESPACE:
            raise Refused(403, f"forbidden: {parts.path}")
        _, kind, name, subresource = match.groups()
        verb = {"POST": "create", "DELETE": "delete"}.get(method) or (
            "get" if name else "watch" if "watch" in query else "list"
        )
        resource = f"{kind}/{subresource}" if subresource else kind
        self._authorize(verb, resource)
        content = json.loads(body) if body else {}
        failure = self._next_failure(verb, resource, name or content.get("metadata", {}).get("name", ""))
        if failure is not None and failure.code != LATE:
            raise failure
        answer = self._do(verb, kind, name, query, content) if not subresource else self.node.log(name, query)
        if failure is not None:
            raise failure
        return answer

    def _next_failure(self, verb: str, resource: str, name: str) -> Refused | None:
        for key, failures in self.fails.items():
            if failures and key[:2] == (verb, resource) and name.endswith(key[2] if len(key) > 2 else ""):
                failure = failures.pop(0)
                return failure if isinstance(failure, Refused) else Refused(failure, "the test has it fail")
        return None

    def _do(self, verb: str, kind: str, name: str, query: Mapping[str, str], content: Body) -> Body | Iterator[bytes]:
        if verb == "create":
            return self._create(kind, content)
        if verb == "watch":
            return self._watch(query)
        if verb == "list":
            return self._list(kind, query)
        if verb == "delete":
            return self._delete(kind, name)
        with self.changed:
            return copy.deepcopy(self._get(kind, name))

    def _authorize(self, verb: str, resource: str) -> None:
        self.requests.append((verb, resource))
        if self.rules is None:
            return
        if not any(verb in rule["verbs"] and resource in rule["resources"] for rule in self.rules):
            raise Refused(403, f'User "runner" cannot {verb} resource "{resource}" in the namespace "{NAMESPACE}"')

    def _get(self, kind: str, name: str) -> Body:
        if name not in self.objects[kind]:
            raise Refused(404, f'{kind} "{name}" not found')
        return self.objects[kind][name]

    def _create(self, kind: str, body: Body) -> Body:
        assert _KINDS[body["kind"]] == kind
        for version in VERSIONS:
            kubernetes_validate.validate(known_to(version, body), version, strict=True)
        name = body["metadata"]["name"]
        for key, message in self.quotas.items():
            if key[0] == kind and name.endswith(key[1] if len(key) > 1 else ""):
                raise Refused(403, f'{kind} "{name}" is forbidden: exceeded quota: {message}')
        assert re.fullmatch(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?", name), name
        with self.changed:
            if name in self.objects[kind]:
                raise Refused(409, f'{kind} "{name}" already exists')
            self.created.append(copy.deepcopy(body))
            made = copy.deepcopy(body)
            made["metadata"] |= {"uid": str(uuid.uuid4()), "creationTimestamp": now(), "namespace": NAMESPACE}
            self.objects[kind][name] = made
            if kind == "persistentvolumeclaims":
                self.folder_of(name).mkdir(parents=True, exist_ok=True)
            self.changed.notify_all()
        if kind == "jobs" and self.creates_pods:
            self.start_pod(made)
        return copy.deepcopy(made)

    def start_pod(self, job: Body) -> None:
        """Create a pod of a Job, as its controller does."""
        template = copy.deepcopy(job["spec"]["template"])
        name = f"{job['metadata']['name']}-{uuid.uuid4().hex[:5]}"
        pod = {
            "apiVersion": "v1",
            "kind": "Pod",
            "metadata": {
                "name": name,
                "uid": str(uuid.uuid4()),
                "creationTimestamp": now(),
                "labels": {**template["metadata"]["labels"], "job-name": job["metadata"]["name"]},
            },
            "spec": template["spec"],
            "status": {"phase": "Pending"},
        }
        with self.changed:
            self.objects["pods"][name] = pod
            self.announce("ADDED", pod)
        self.node.start(pod, job)

    def _list(self, kind: str, query: Mapping[str, str]) -> Body:
        with self.changed:
            items = [copy.deepcopy(it) for it in self.objects[kind].values() if selects(query["labelSelector"], it)]
            return {"metadata": {"resourceVersion": str(next(self._versions))}, "items": items}

    def _watch(self, query: Mapping[str, str]) -> Iterator[bytes]:
        version = int(query["resourceVersion"])
        if version < self._oldest_version:
            raise Refused(410, "too old resource version")

        return self._stream_events(version, query["labelSelector"])

    def _stream_events(self, version: int, selector: str) -> Iterator[bytes]:
        def has_news() -> bool:
            is_over = self.is_closed or self.is_away.is_set()
            return is_over or version < self._oldest_version or any(number > version for number, _, _ in self._events)

        while True:
            with self.changed:
                self.changed.wait_for(has_news, timeout=5)
                if self.is_closed or self.is_away.is_set():
                    return
                if version < self._oldest_version:
                    status = {"kind": "Status", "code": 410, "message": "too old resource version"}
                    yield json.dumps({"type": "ERROR", "object": status}).encode() + b"\n"
                    return
                fresh = [event for event in self._events if event[0] > version]
            for number, kind, pod in fresh:
                version = number
                if selects(selector, pod):
                    yield json.dumps({"type": kind, "object": pod}).encode() + b"\n"

    def _delete(self, kind: str, name: str) -> Body:
        with self.changed:
            removed = self._get(kind, name)
            pods = [pod for pod in self.objects["pods"].values() if pod["metadata"]["labels"].get("job-name") == name]
            if kind == "persistentvolumeclaims" and self._is_used(name):
                removed["metadata"].setdefault("deletionTimestamp", now())
            else:
                del self.objects[kind][name]
            self.changed.notify_all()
        if kind == "jobs":
            for pod in pods:
                self.delete_pod(pod["metadata"]["name"])
        return {"kind": "Status", "status": "Success"}

    def _is_used(self, claim: str) -> bool:
        return any(
            volume.get("persistentVolumeClaim", {}).get("claimName") == claim
            for pod in self.objects["pods"].values()
            for volume in pod["spec"]["volumes"]
            if pod["status"]["phase"] in {"Pending", "Running"}
        )

    # -- pods ----------------------------------------------------------------------------------------------------------

    def announce(self, kind: str, pod: Body) -> None:
        """Tell watches of a pod; called with the lock."""
        version = next(self._versions)
        pod["metadata"]["resourceVersion"] = str(version)
        self._events.append((version, kind, copy.deepcopy(pod)))
        self.changed.notify_all()

    def change_pod(self, name: str, status: Mapping[str, Any]) -> None:
        """Change the status of a pod, and that of its Job where it has ended."""
        with self.changed:
            pod = self.objects["pods"].get(name)
            if pod is None:
                return
            pod["status"] = {**pod["status"], **status}
            self.announce("MODIFIED", pod)
            job = self.objects["jobs"].get(pod["metadata"]["labels"]["job-name"])
            if job is not None and pod["status"]["phase"] == "Failed":
                self._on_failure(job)
            self._release_claims()

    def _on_failure(self, job: Body) -> None:
        status = job.setdefault("status", {})
        status["failed"] = status.get("failed", 0) + 1
        if status["failed"] <= job["spec"]["backoffLimit"]:
            threading.Thread(target=self.start_pod, args=(job,), daemon=True).start()
        else:
            message = "Job has reached the specified backoff limit"
            status["conditions"] = [
                {"type": "Failed", "status": "True", "reason": "BackoffLimitExceeded", "message": message}
            ]

    def _release_claims(self) -> None:
        claims = self.objects["persistentvolumeclaims"]
        for name in [name for name, it in claims.items() if "deletionTimestamp" in it["metadata"]]:
            if not self._is_used(name):
                del claims[name]

    def delete_pod(self, name: str) -> None:
        """Delete a pod with its grace period: by its Job, by a drain, or by hand."""
        with self.changed:
            pod = self.objects["pods"].get(name)
            if pod is None or "deletionTimestamp" in pod["metadata"]:
                return
            pod["metadata"]["deletionTimestamp"] = now()
            self.announce("MODIFIED", pod)
            job = self.objects["jobs"].get(pod["metadata"]["labels"]["job-name"])
        self.node.stop(name)
        if job is not None and self.replaces_deleted_pods:
            self.start_pod(job)

    def drop_pod(self, name: str) -> None:
        """Remove a pod that has ended."""
        with self.changed:
            pod = self.objects["pods"].pop(name, None)
            if pod is None:
                return
            self.announce("DELETED", pod)
            job = self.objects["jobs"].get(pod["metadata"]["labels"]["job-name"])
            if job is not None and pod["status"]["phase"] not in {"Succeeded", "Failed"}:
                self._on_failure(job)
            self._release_claims()

    def secret_files(self, name: str) -> dict[str, bytes] | None:
        """Return the content of a Secret; None where there is none yet."""
        with self.changed:
            secret = self.objects["secrets"].get(name)
        if secret is None:
            return None
        files = {key: base64.b64decode(value) for key, value in secret.get("data", {}).items()}
        return files | {key: value.encode() for key, value in secret.get("stringData", {}).items()}


def known_to(version: str, body: Body) -> Body:
    """Return a copy of an object without the fields that a version ignores."""
    copied = copy.deepcopy(body)
    if version == "1.27":
        copied["spec"] = {name: it for name, it in body.get("spec", {}).items() if name != "podReplacementPolicy"}
        copied = {name: it for name, it in copied.items() if name != "spec" or "spec" in body}
    return copied


def selects(selector: str, body: Mapping[str, Any]) -> bool:
    """Whether labels match a selector."""
    labels = body["metadata"].get("labels", {})
    return all(labels.get(name) == value for name, _, value in (part.partition("=") for part in selector.split(",")))


def now() -> str:
    """Return the time as Kubernetes writes it."""
    return datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds").replace("+00:00", "Z")
