"""Runs jobs as containers of an engine with Docker's API: Docker or Podman.

A container outlives the runner. A later runner finds it by name, and continues its log and limits.
"""

import contextlib
import json
import logging
import os
import select
import signal
import socket
import threading
import time
import uuid
from collections.abc import Collection, Mapping, Sequence
from http import HTTPStatus
from pathlib import Path
from typing import Any

from kleinkram.contract.actions import Network
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runners import ExecutorAbilities
from kleinkram.contract.runs import EndReason, Usage
from kleinkram.environments.cache import EnvironmentCache
from kleinkram.environments.python import PROBE, Python, PythonUnknown, parse_python
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors import port_forward
from kleinkram.runner.executors.base import CannotStart, Ending, PinnedImage, RunJob
from kleinkram.runner.executors.docker import container as containers
from kleinkram.runner.executors.docker import device_requests
from kleinkram.runner.executors.docker.client import (
    UNSEEN_EXIT,
    ContainerInfo,
    DockerClient,
    EngineError,
    EngineUnavailable,
    ImageInfo,
    digest_of,
)
from kleinkram.runner.executors.gpus import Gpu
from kleinkram.runner.executors.local import LocalExecutor, Machine, cannot_start, limits_of, make_directories
from kleinkram.runner.executors.supervision import (
    CANCELLED,
    DISK_FULL,
    LOG,
    LimitMonitor,
    boot_time_s,
    command_not_found,
    out_of_memory,
    reason_of_exit_code,
    start_ticks,
    write_atomically,
)
from kleinkram.runner.images.names import ImageName, ImageNotAllowed, Pull, check_allowed, credentials_for

_log = logging.getLogger("kleinkram.runner")
_STOP_REASON = "stop-reason.json"
_RETRY_EVERY_S = 0.2
_TOOL_TIMEOUT_S = 600.0
_TOOL_CHECK_S = 0.05
# A restarted engine is back by then.
_ENGINE_BACK_S = 60.0
_LOG_COMPLETE_S = 120.0
# Engines learn a moment after the end, or not at all, that the kernel killed a process for its memory.
_OUT_OF_MEMORY_REPORTED_S = 0.5
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_KILLED = 128 + signal.SIGKILL
_LOST = Ending(
    EndReason.lost, "Its container was ended from outside: by a restart of the engine or machine, or by hand."
)


class DockerExecutor(LocalExecutor):
    """Runs jobs as containers. `runner` separates its containers from those of other runners.

    `allowed`: the registries, or namespaces of registries, that images may come from; None for all.
    """

    def __init__(
        self,
        client: DockerClient,
        machine: Machine | None = None,
        *,
        runner: str = "local",
        pull: Pull = Pull.missing,
        allowed: Sequence[str] | None = None,
        environments: EnvironmentCache | None = None,
    ) -> None:
        super().__init__(machine, environments)
        self._client = client
        self._runner = runner
        self._is_root = os.geteuid() == 0
        self._engine = client.info()
        if not self._engine.bounds_memory:
            _log.warning(
                "the engine at %s limits neither memory, cores nor processes of runs: a rootless one needs control "
                "groups of version 2, delegated to its user",
                client.path,
            )
        self._images = Images(client, self._engine.architecture, pull=pull, allowed=allowed)
        self._monitors: dict[str, ContainerMonitor] = {}
        self._pythons: dict[str, Python] = {}
        self._lock = threading.Lock()

    @property
    def abilities(self) -> ExecutorAbilities:
        """Supported features. Only root may open sockets in the network of a container."""
        networks = {Network.none, Network.open} | ({Network.api} if self._is_root else set())
        return ExecutorAbilities(
            executor="docker",
            isolation=Isolation.container,
            images=True,
            networks=frozenset(networks),
            gpus=self._gpus is not None,
            bounds_memory=self._engine.bounds_memory,
            bounds_disk=True,
            environments=self._environments is not None,
        )

    def prepare_image(self, image: str) -> PinnedImage:
        """Pull an image where that is needed and allowed."""
        return self._images.prepare(image)

    def submit(self, job: RunJob) -> None:
        """Create and start the container of a job, whose image must be present."""
        if job.image is None:
            raise cannot_start("A container needs an image, and the action names none.")
        network = job.network.value
        self._check_network(job, f"A runner that is not root cannot give a run the network {network!r}.")
        try:
            image = self._client.find_image(job.image)
            exists = self._client.find_container(containers.container_name(job)) is not None
        except (EngineUnavailable, EngineError) as error:
            raise cannot_start(f"{error}.") from error
        if image is None:
            raise cannot_start(f"The image {job.image} is not on this runner.", EndReason.image_unavailable)
        if exists:
            # It still writes to directories that are replaced, and its end would be taken for the end of this start.
            raise cannot_start("The container engine does not remove the container of an earlier start.")
        gpus = self._assign_gpus(job, self._gpus_in_use() if job.resources.gpus else ())
        user = self._make_directories(job)
        for number, _ in enumerate(image.volumes):
            directory = containers.volume_directory(job, number)
            directory.mkdir(exist_ok=True)
            if not self._engine.is_rootless:
                os.chown(directory, user, -1)
        try:
            self._start(job, image, f"{user}:{user}", gpus)
        except (EngineUnavailable, EngineError, OSError) as error:
            raise CannotStart(_start_failure(error)) from error

    def _make_directories(self, job: RunJob) -> int:
        """Create the directories of a job, and return the uid that it has in its container."""
        if self._engine.is_rootless:
            # Root of the container is the user of the engine, and the only one there with access to the directories.
            make_directories(job, own_uid=False)
            return 0
        user = make_directories(job, own_uid=self._is_root)
        return os.getuid() if user is None else user

    def gpu_obstacle(self, gpu: Gpu) -> str | None:
        """Return what the engine lacks to give a GPU to containers."""
        return device_requests.gpu_obstacle(gpu, self._engine)

    def _gpus_in_use(self) -> set[str]:
        """Return the GPUs of containers that nobody here knows: another runner's, or one that is not to be removed."""
        try:
            running = self._client.list_labelled(device_requests.GPUS_LABEL, only_running=True)
        except (EngineUnavailable, EngineError) as error:
            raise cannot_start(f"{error}.") from error
        unknown = [
            labels
            for _, labels in running
            if self._gpus is None or not self._gpus.has_record(labels.get(containers.JOB_LABEL, ""))
        ]
        return {gpu_id for labels in unknown for gpu_id in labels[device_requests.GPUS_LABEL].split(",")}

    def _start(self, job: RunJob, image: ImageInfo, user: str, gpus: Sequence[Gpu]) -> None:
        name, log = containers.container_name(job), job.directory / LOG
        (job.directory / containers.LOG_CURSOR).unlink(missing_ok=True)
        labels = {
            containers.JOB_LABEL: job.key,
            containers.RUNNER_LABEL: self._runner,
            containers.LOG_LABEL: str(log.stat().st_size if log.exists() else 0),
        }
        description = containers.describe(
            job,
            user=user,
            volumes=image.volumes,
            labels=labels,
            is_podman=self._engine.is_podman,
            python_path=image.python_path,
        )
        description = device_requests.with_gpus(description, gpus, self._engine)
        if job.port_forwards:
            self._create(name, containers.with_barrier(description, job, image))
            if not self._client.has_file(name, containers.SHELL):
                self._client.remove(name)
                self._create(name, description)
        else:
            self._create(name, description)
        self._client.start(name)
        self._forget(job)
        self._monitor(job, is_reattached=False).poll()

    def _create(self, name: str, description: Mapping[str, Any]) -> None:
        if self._engine.is_podman and description["HostConfig"].get("DeviceRequests"):
            self._client.create_by_libpod(device_requests.libpod_description(name, description))
        else:
            self._client.create(name, description)

    def _find_python(self, image: str | None) -> Python:
        if image is None:
            raise PythonUnknown("There is no image.")
        if image not in self._pythons:
            output = self._run_tool(image, ["python3", "-I", "-c", PROBE], lambda _: None)
            self._pythons[image] = parse_python(output)
        return self._pythons[image]

    def _compile_packages(self, image: str | None, folder: Path, wait: Wait) -> None:
        if image is not None:
            self._run_tool(image, ["python3", "-I", "-m", "compileall", "-q", "-q", containers.PACKAGES], wait, folder)

    def _run_tool(self, image: str, command: Sequence[str], wait: Wait, folder: Path | None = None) -> str:
        """Run a command of the runner's own in an image, without network, and return its output.

        Raises:
            PythonUnknown: it cannot be run.
        """
        name = f"kleinkram-tool-{uuid.uuid4().hex}"
        labels = {containers.RUNNER_LABEL: self._runner}
        user = "0:0" if self._engine.is_rootless else f"{os.getuid()}:{os.getgid()}"
        until_s = time.monotonic() + _TOOL_TIMEOUT_S
        try:
            description = containers.describe_tool(
                image, command, user=user, labels=labels, folder=folder, is_podman=self._engine.is_podman
            )
            self._client.create(name, device_requests.with_gpus(description, (), self._engine))
            try:
                self._client.start(name)
                while (container := self._client.find_container(name)) is not None and container.status != "exited":
                    wait(0)
                    if time.monotonic() > until_s:
                        raise PythonUnknown("The image does not answer.")
                    time.sleep(_TOOL_CHECK_S)
                pieces = [piece for batch in self._client.log(name, follow=False) for piece in batch]
                return b"".join(piece.data for piece in pieces if piece.stream == 1).decode(errors="replace")
            finally:
                self._client.remove(name)
        except EngineUnavailable as error:
            raise PythonUnknown(f"{error}.") from error
        except EngineError as error:
            raise PythonUnknown(f"The image has no python3 that can be started: {error}.") from error

    def poll(self, job: RunJob) -> Ending | None:
        """Look at the container of a job, and enforce its limits."""
        return self._monitor(job).poll()

    def cancel(self, job: RunJob) -> None:
        """Send SIGTERM to a container, and SIGKILL later."""
        self._monitor(job).stop(CANCELLED)

    def usage(self, job: RunJob) -> Usage | None:
        """Return the last usage that `poll` measured."""
        return self._monitor(job).usage

    def remove(self, job: RunJob) -> None:
        """Kill and remove a container; one that the engine does not remove is left for `remove_others`."""
        self._forget(job)
        (job.directory / _STOP_REASON).unlink(missing_ok=True)
        with contextlib.suppress(EngineUnavailable):
            self._remove(containers.container_name(job))
        self._release_gpus(job)

    def remove_others(self, known_keys: Collection[str]) -> None:
        """Remove the containers of this runner with other keys."""
        try:
            for name, labels in self._client.list_labelled(f"{containers.RUNNER_LABEL}={self._runner}"):
                if labels.get(containers.JOB_LABEL) not in known_keys:
                    self._remove(name)
        except (EngineUnavailable, EngineError) as error:
            _log.warning("containers of earlier runs were not removed: %s", error)

    def _remove(self, name: str) -> None:
        try:
            self._client.remove(name)
        except EngineError as error:
            _log.warning("the container %s was not removed: %s", name, error)

    def _monitor(self, job: RunJob, *, is_reattached: bool = True) -> "ContainerMonitor":
        with self._lock:
            if job.key not in self._monitors:
                self._monitors[job.key] = ContainerMonitor(
                    self._client, job, is_reattached=is_reattached, can_follow=not self._engine.is_podman
                )
            return self._monitors[job.key]

    def _forget(self, job: RunJob) -> None:
        with self._lock:
            monitor = self._monitors.pop(job.key, None)
        if monitor is not None:
            monitor.close()


class Images:
    """The images that a runner may use. `allowed`: None for all."""

    def __init__(self, client: DockerClient, architecture: str, *, pull: Pull, allowed: Sequence[str] | None) -> None:
        self._client = client
        self._architecture = architecture
        self._pull = pull
        self._allowed = allowed

    def prepare(self, text: str) -> PinnedImage:
        """Pull an image where that is needed and allowed.

        Raises:
            CannotStart: it is not allowed, not available, or for another architecture.
        """
        try:
            name = check_allowed(text, self._allowed)
        except ImageNotAllowed as error:
            raise _image_unavailable(str(error)) from error
        try:
            image = self._find(text, name)
            is_outdated = self._pull is Pull.always and not name.digest
            if (image is None or is_outdated) and self._pull is not Pull.never:
                self._fetch(text, name)
                image = self._find(text, name)
        except EngineUnavailable as error:
            raise _image_unavailable(f"{error}.") from error
        if image is None:
            raise _image_unavailable(f"The image {text} is not on this runner, which does not pull images.")
        if image.architecture != self._architecture:
            message = f"The image {text} is for {image.architecture}; this runner is {self._architecture}."
            raise cannot_start(message)
        return PinnedImage(reference=image.id, digest=digest_of(image, name))

    def _find(self, text: str, name: ImageName) -> ImageInfo | None:
        image = self._client.find_image(text)
        if image is None and name.digest:
            # The digest of an image that was built here is its id.
            return self._client.find_image(name.digest)
        return image

    def _fetch(self, text: str, name: ImageName) -> None:
        registry = name.repository.partition("/")[0]
        credentials = credentials_for(registry)
        try:
            tag = name.digest or name.tag
            self._client.pull(name.repository, tag, architecture=self._architecture, credentials=credentials)
        except EngineError as error:
            raise _image_unavailable(f"The image {text} cannot be pulled from {registry}: {error}.") from error


def _image_unavailable(message: str) -> CannotStart:
    return cannot_start(message, EndReason.image_unavailable)


class ContainerMonitor:
    """Watches one container: its log, limits, port forwards and end. `is_reattached`: an earlier runner started it."""

    def __init__(self, client: DockerClient, job: RunJob, *, is_reattached: bool, can_follow: bool) -> None:
        self._client = client
        self._job = job
        self._name = containers.container_name(job)
        self._is_reattached = is_reattached
        self._limits = LimitMonitor(job.directory, limits_of(job))
        with contextlib.suppress(FileNotFoundError, ValueError):
            reason, message = json.loads((job.directory / _STOP_REASON).read_text())
            self._limits.reason = reason, message
        self._log = containers.ContainerLog(client, job, can_follow=can_follow)
        self._pid = self._start_ticks = 0
        self._groups: dict[str, str] = {}
        self._was_oom_killed = False
        self._unavailable_since_s: float | None = None
        self._was_unavailable = False
        self._exited_at_s: float | None = None
        self._listeners: list[socket.socket] = []
        self._barrier: int | None = None
        self._ending: Ending | None = None
        self._lock = threading.Lock()
        self.usage: Usage | None = None

    def poll(self) -> Ending | None:
        """Return how the container ended, or None while it runs or its log is incomplete."""
        with self._lock:
            if self._ending is None:
                self._ending = self._poll()
            return self._ending

    def stop(self, reason: tuple[str, str]) -> None:
        """Have the container stopped."""
        self._limits.stop(reason)
        self._send_signal()

    def close(self) -> None:
        """End all threads of this monitor."""
        self._log.close()
        port_forward.close(self._listeners)
        if self._barrier is not None:
            os.close(self._barrier)
            self._barrier = None

    def _poll(self) -> Ending | None:
        try:
            container = self._client.find_container(self._name)
            self._unavailable_since_s = None
        except EngineUnavailable:
            return self._poll_without_engine()
        except EngineError as error:
            _log.warning("the engine does not describe the container %s: %s", self._name, error)
            return None
        if container is None or container.status == "created":
            return Ending.of(self._limits.reason) if self._limits.reason else _LOST
        self._log.follow(container)
        if container.status != "exited" and container.status != "dead":
            self._exited_at_s = None
            self._observe(container)
            self._enforce_limits()
            return None
        return self._poll_exited(container)

    def _poll_without_engine(self) -> Ending | None:
        """Enforce limits while the engine is unavailable; containers continue unless it ends them."""
        self._was_unavailable = True
        now = time.monotonic()
        self._unavailable_since_s = self._unavailable_since_s or now
        self._enforce_limits()
        return _LOST if now > self._unavailable_since_s + _ENGINE_BACK_S and not self._is_alive() else None

    def _poll_exited(self, container: ContainerInfo) -> Ending | None:
        now = time.monotonic()
        self._exited_at_s = self._exited_at_s or now
        self._log.finish()
        if not self._log.is_complete and now < self._exited_at_s + _LOG_COMPLETE_S:
            return None
        if not self._log.has_space:
            self._limits.stop(DISK_FULL, grace_s=0)
        self._limits.check_disk()
        try:
            return self._ending_of(container)
        except EngineUnavailable:
            return None

    def _observe(self, container: ContainerInfo) -> None:
        """Look at the first process of the container from outside, once, and measure usage."""
        if container.pid and container.pid != self._pid:
            self._start_ticks = start_ticks(container.pid) or 0
            with contextlib.suppress(OSError):
                groups = containers.cgroups_of(container.pid)
                # Else it is another process: of a machine where the engine is, or one that got the number later.
                if any(container.id in path for path in groups.values()):
                    self._pid, self._groups = container.pid, groups
                    threading.Thread(target=self._await_death, daemon=True).start()
            if self._pid == container.pid:
                self._open_port_forwards()
        used = containers.cgroup_usage(self._groups) if self._groups else None
        if used is not None:
            peak = max(used.memory_bytes, self.usage.peak_memory_bytes if self.usage else 0)
            self.usage = Usage(**used._asdict(), peak_memory_bytes=peak)

    def _open_port_forwards(self) -> None:
        if not self._job.port_forwards or self._listeners:
            return
        forwards = self._job.port_forwards
        try:
            self._listeners = port_forward.listen_in_namespace(self._pid, forwards)
        except OSError as error:
            if self._is_alive():
                self._limits.stop(("not_possible", f"Its network is not possible here: {error}."), grace_s=0)
            return
        port_forward.serve(self._listeners, forwards)
        self._barrier = containers.open_barrier(self._job.directory)

    def _await_death(self) -> None:
        """Read why the first process ended: its control groups vanish a moment later."""
        with contextlib.suppress(OSError):
            process = os.pidfd_open(self._pid)
            select.select([process], [], [])
            os.close(process)
        self._was_oom_killed = containers.was_oom_killed(self._groups)

    def _enforce_limits(self) -> None:
        if not self._log.has_space:
            self._limits.stop(DISK_FULL, grace_s=0)
        # Counted by a clock that nobody sets, and on after a restart of the runner.
        elapsed_s = boot_time_s() - self._start_ticks / _TICKS_PER_S if self._start_ticks else 0.0
        self._limits.check(elapsed_s)
        self._send_signal()

    def _send_signal(self) -> None:
        due = self._limits.next_signal()
        if due is None or self._limits.reason is None:
            return
        with contextlib.suppress(OSError):
            # For the next runner, or this one if the engine takes long: the reason for the end of the container.
            write_atomically(self._job.directory / _STOP_REASON, json.dumps(self._limits.reason))
        try:
            self._client.kill(self._name, due.name)
        except EngineError:
            # It does not run.
            return
        except EngineUnavailable:
            if self._is_alive():
                os.kill(self._pid, due)

    def _is_alive(self) -> bool:
        return self._pid > 0 and start_ticks(self._pid) == self._start_ticks

    def _ending_of(self, container: ContainerInfo) -> Ending:
        if self._limits.reason is not None:
            return Ending.of(self._limits.reason)
        code = container.exit_code
        if code in containers.NOT_EXECUTED_CODES:
            output = self._log.first_output().decode(errors="replace")
            detail = containers.execution_error(output, self._job.command, code)
            if detail is not None:
                return Ending.of(command_not_found(detail))
        if code != 0 and self._was_out_of_memory(container):
            return Ending.of(out_of_memory(self._job.resources.memory_bytes))
        # A restart of the engine, or somebody, may have ended it, whatever its exit code.
        was_not_seen = self._is_reattached and code in (_KILLED, UNSEEN_EXIT)
        if was_not_seen or self._client.was_killed(self._name):
            return _LOST
        if self._was_unavailable and self._client.info().ends_with_containers:
            return _LOST
        return Ending.of(reason_of_exit_code(code), code)

    def _was_out_of_memory(self, container: ContainerInfo) -> bool:
        deadline = time.monotonic() + _OUT_OF_MEMORY_REPORTED_S
        while not self._was_oom_killed and not container.was_out_of_memory:
            if container.exit_code != _KILLED or self._is_reattached or time.monotonic() > deadline:
                return False
            time.sleep(_RETRY_EVERY_S / 2)
            container = self._client.find_container(self._name) or container
        return True


def _start_failure(error: Exception) -> Ending:
    if isinstance(error, EngineError) and error.status == HTTPStatus.NOT_FOUND:
        return Ending(EndReason.image_unavailable, f"Its image was removed: {error}.")
    if "executable file not found" in str(error):
        return Ending.of(command_not_found(str(error)))
    return Ending(EndReason.not_possible, f"It could not be started here: {error}.")
