"""Client for the few resources of a Kubernetes namespace that runs need, by the official client library.

The library finds the API server and the credentials, and sends requests. Answers are read here, as typed values: the
library's own types are checked nowhere. It is imported only when a runner starts on a cluster.
"""

import contextlib
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar, cast

import urllib3
from pydantic import Field, ValidationError

from kleinkram.client.errors import InvalidInput
from kleinkram.runner.executors.kubernetes.api_objects import ApiObject, ClusterJob, ObjectMetadata, Pod, PodEvent

Kind = Literal["jobs", "pods", "persistentvolumeclaims", "secrets"]
Body = dict[str, Any]
_GROUPS: Mapping[Kind, str] = {"jobs": "/apis/batch/v1"}
_CORE = "/api/v1"
_CONNECT_S = 10.0
_READ_S = 30.0
# A watch that brings nothing for so long is asked for again; the API server ends it first.
_WATCH_S = 60
_SERVICE_ACCOUNT = Path("/var/run/secrets/kubernetes.io/serviceaccount/token")
_LOG_S = 60.0
_LONGEST_EVENT_BYTES = 8 * 2**20
_LONGEST_LINE_BYTES = 2**16
_EXISTS = "AlreadyExists"


class ClusterError(Exception):
    """The API server refused a request. The text is its message."""

    def __init__(self, status: int, message: str, reason: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.reason = reason

    @property
    def is_missing(self) -> bool:
        """Whether the object does not exist."""
        return self.status == HTTPStatus.NOT_FOUND

    @property
    def is_existing(self) -> bool:
        """Whether an object of this name exists."""
        return self.reason == _EXISTS

    @property
    def is_over_quota(self) -> bool:
        """Whether a ResourceQuota of the namespace has no room for it at the moment."""
        return self.status == HTTPStatus.FORBIDDEN and "exceeded quota" in str(self)


class ClusterUnavailable(ClusterError):
    """The API server does not answer, is overloaded, or met a conflict: the same request may succeed later."""


class _NamedObject(ApiObject):
    metadata: ObjectMetadata


class _ListMetadata(ApiObject):
    resource_version: str = ""
    continue_: str = Field("", alias="continue")


class _PodList(ApiObject):
    metadata: _ListMetadata = _ListMetadata()
    items: tuple[Pod, ...] = ()


class _NamedObjectList(ApiObject):
    metadata: _ListMetadata = _ListMetadata()
    items: tuple[_NamedObject, ...] = ()


class _StatusAnswer(ApiObject):
    message: str = ""
    reason: str = ""
    code: int = 0


class _WatchEvent(ApiObject):
    type: str
    object: dict[str, Any]


class _LibraryResponse(Protocol):
    @property
    def data(self) -> bytes: ...

    def stream(self, amt: int) -> Iterator[bytes]: ...

    def close(self) -> None: ...


class _Library(Protocol):
    """The part of `kubernetes.client.ApiClient` that is used."""

    def call_api(self, resource_path: str, method: str, **options: object) -> _LibraryResponse: ...


_Object = TypeVar("_Object", bound=ApiObject)


class Cluster:
    """One namespace of a cluster. Thread-safe."""

    def __init__(self, library: _Library, namespace: str) -> None:
        self._library = library
        self.namespace = namespace

    def create(self, kind: Kind, body: Body) -> None:
        """Create an object."""
        self._send("POST", self._path(kind), body=body)

    def find_job(self, name: str) -> ClusterJob | None:
        """Return a Job."""
        return self._find("jobs", name, ClusterJob)

    def has_volume(self, name: str) -> bool:
        """Whether a claim of a volume exists."""
        return self._find("persistentvolumeclaims", name, _NamedObject) is not None

    def list_names(self, kind: Kind, selector: str) -> list[ObjectMetadata]:
        """Return the metadata of the objects with labels."""
        objects: list[ObjectMetadata] = []
        more = ""
        while True:
            query = {"labelSelector": selector, "limit": "500", **({"continue": more} if more else {})}
            page = _parse(self._send("GET", self._path(kind), query=query), _NamedObjectList)
            objects += [item.metadata for item in page.items]
            more = page.metadata.continue_
            if not more:
                return objects

    def delete(self, kind: Kind, name: str) -> bool:
        """Delete an object and what belongs to it; return whether there was one."""
        body = {"apiVersion": "v1", "kind": "DeleteOptions", "propagationPolicy": "Background"}
        try:
            self._send("DELETE", f"{self._path(kind)}/{name}", body=body)
        except ClusterError as error:
            if error.is_missing:
                return False
            raise
        return True

    def list_pods(self, selector: str) -> tuple[list[Pod], str]:
        """Return the pods with labels, and the version to watch from."""
        page = _parse(self._send("GET", self._path("pods"), query={"labelSelector": selector}), _PodList)
        return [*page.items], page.metadata.resource_version

    def watch_pods(self, selector: str, version: str) -> Iterator[PodEvent]:
        """Yield changes after a version, until the API server ends the watch.

        Raises:
            ClusterError: the version is too old, among others.
        """
        query = {
            "labelSelector": selector,
            "watch": "true",
            "resourceVersion": version,
            "timeoutSeconds": str(_WATCH_S),
            "allowWatchBookmarks": "true",
        }
        for lines in self._lines("pods", "", query, timeout_s=_WATCH_S + _READ_S, longest=_LONGEST_EVENT_BYTES):
            for line in lines:
                event = _parse(line, _WatchEvent)
                if event.type == "ERROR":
                    status = _checked(event.object, _StatusAnswer)
                    raise ClusterError(status.code, status.message)
                if event.type == "BOOKMARK":
                    metadata = event.object.get("metadata", {})
                    yield PodEvent(version=metadata.get("resourceVersion", ""))
                else:
                    pod = _checked(event.object, Pod)
                    version = pod.metadata.resource_version
                    yield PodEvent(version=version, is_deleted=event.type == "DELETED", pod=pod)

    def follow_log(self, pod: str, since_s: int | None) -> Iterator[list[bytes]]:
        """Yield the lines of a pod's output with their times, as they arrive, until it has ended.

        Very long lines come in pieces, of which the first has the time.

        Raises:
            ClusterError: the pod has no output, or none came for a minute: then again from the last line.
        """
        query = {"follow": "true", "timestamps": "true"}
        if since_s is not None:
            query["sinceSeconds"] = str(max(1, since_s))
        return self._lines("pods", f"/{pod}/log", query, timeout_s=_LOG_S, longest=_LONGEST_LINE_BYTES)

    def read_output(self, pod: str) -> bytes:
        """Return the whole output of an ended pod."""
        return self._send("GET", f"{self._path('pods')}/{pod}/log")

    def _find(self, kind: Kind, name: str, model: type[_Object]) -> _Object | None:
        try:
            return _parse(self._send("GET", f"{self._path(kind)}/{name}"), model)
        except ClusterError as error:
            if error.is_missing:
                return None
            raise

    def _path(self, kind: Kind) -> str:
        return f"{_GROUPS.get(kind, _CORE)}/namespaces/{self.namespace}/{kind}"

    def _send(
        self, method: str, path: str, *, query: Mapping[str, str] | None = None, body: Body | None = None
    ) -> bytes:
        response = self._open(method, path, query or {}, body, _READ_S)
        try:
            return response.data
        except urllib3.exceptions.HTTPError as error:
            raise ClusterUnavailable(0, f"the API server of Kubernetes does not answer: {error}") from error
        finally:
            response.close()

    def _open(
        self, method: str, path: str, query: Mapping[str, str], body: Body | None, read_timeout_s: float | None
    ) -> _LibraryResponse:
        from kubernetes.client.exceptions import ApiException
        from kubernetes.config import ConfigException

        try:
            return self._library.call_api(
                path,
                method,
                query_params=[*query.items()],
                header_params={"Accept": "application/json", "Content-Type": "application/json"},
                body=body,
                auth_settings=["BearerToken"],
                _preload_content=False,
                _return_http_data_only=True,
                _request_timeout=(_CONNECT_S, read_timeout_s),
            )
        except ApiException as error:
            raise _refusal(error.status or 0, error.body or "") from error
        except ConfigException as error:  # such as a token file that is just being replaced
            raise ClusterUnavailable(0, f"the credentials of Kubernetes cannot be read: {error}") from error
        except (urllib3.exceptions.HTTPError, OSError) as error:
            raise ClusterUnavailable(0, f"the API server of Kubernetes does not answer: {error}") from error

    def _lines(
        self, kind: Kind, rest: str, query: Mapping[str, str], *, timeout_s: float, longest: int
    ) -> Iterator[list[bytes]]:
        """Yield lines with their line breaks as they arrive; lines that are longer, in pieces."""
        response = self._open("GET", self._path(kind) + rest, query, None, timeout_s)
        pending = b""
        try:
            for data in response.stream(2**16):
                *lines, pending = (pending + data).split(b"\n")
                batch = [line + b"\n" for line in lines]
                if len(pending) > longest:
                    batch.append(pending)
                    pending = b""
                yield batch
            yield [pending] if pending else []
        except (urllib3.exceptions.HTTPError, OSError) as error:
            raise ClusterUnavailable(0, f"the connection to the API server of Kubernetes broke: {error}") from error
        finally:
            response.close()


def _checked(value: dict[str, Any], model: type[_Object]) -> _Object:
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise ClusterUnavailable(0, f"the API server of Kubernetes gave an unexpected answer: {error}") from error


def _parse(data: bytes, model: type[_Object]) -> _Object:
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        raise ClusterUnavailable(0, f"the API server of Kubernetes gave an unexpected answer: {error}") from error


def _refusal(status: int, body: str | bytes) -> ClusterError:
    text, reason = body.decode(errors="replace") if isinstance(body, bytes) else body, ""
    with contextlib.suppress(ValidationError):
        answer = _StatusAnswer.model_validate_json(text)
        text, reason = answer.message or text, answer.reason
    # Such as two changes of a ResourceQuota at the same moment.
    is_conflict = status == HTTPStatus.CONFLICT and reason != _EXISTS
    is_overloaded = status == HTTPStatus.TOO_MANY_REQUESTS or status >= HTTPStatus.INTERNAL_SERVER_ERROR
    kind = ClusterUnavailable if is_conflict or is_overloaded else ClusterError
    return kind(status, text.strip() or f"HTTP status {status}", reason)


def connect(namespace: str, kubeconfig: Path | None = None, context: str | None = None) -> Cluster:
    """Return a namespace of the cluster of a kubeconfig, or of this pod.

    Raises:
        InvalidInput: the library is not installed, or there is no usable configuration.
    """
    try:
        from kubernetes import client, config
    except ImportError:
        reason = "it needs another package: pip install 'open-kleinkram[kubernetes]'"
        raise InvalidInput(what="A runner on Kubernetes", reason=reason) from None
    configuration = client.Configuration()
    try:
        if kubeconfig is None and context is None and _SERVICE_ACCOUNT.exists():
            config.load_incluster_config(client_configuration=configuration)
        else:
            file = None if kubeconfig is None else str(kubeconfig)
            config.load_kube_config(file, context, client_configuration=configuration)
    except config.ConfigException as error:
        raise InvalidInput(what="The configuration of Kubernetes", reason=str(error)) from error
    # One connection per log that is followed.
    configuration.connection_pool_maxsize = 256
    return Cluster(cast(_Library, client.ApiClient(configuration)), namespace)
