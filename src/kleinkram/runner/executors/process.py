"""Runs jobs as processes of this machine, in sandboxes where the kernel allows that.

A supervisor process per job starts it, enforces its limits and writes its log and ending. It outlives the runner. The
runner and the supervisor share a lock, by which a later runner finds out whether the supervisor is alive.
"""

import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Collection
from pathlib import Path

from kleinkram.action.run_files import IN_VARIABLE, OUT_VARIABLE, PACKAGES_VARIABLE
from kleinkram.contract.actions import Network
from kleinkram.contract.runners import ExecutorAbilities, Isolation
from kleinkram.contract.runs import EndReason, Usage
from kleinkram.environments.cache import EnvironmentCache, compile_packages
from kleinkram.environments.python import PROBE, Python, parse_python
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors import process_sandbox, process_supervisor
from kleinkram.runner.executors.base import Ending, PinnedImage, RunJob
from kleinkram.runner.executors.local import LocalExecutor, Machine, cannot_start, limits_of, make_directories
from kleinkram.runner.executors.supervision import ENDING, USAGE, reserve, write_atomically
from kleinkram.runner.images.store import ImageFailure, ImageRun, ImageStore, StoredImage

_LOCK_RETRIES = 50
_POLL_EVERY_S = 0.02
_NO_IMAGES = "Without a container engine, no image can be run."
# Of images that set none, as container engines have it.
_IMAGE_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
_LOST = Ending(EndReason.lost, "Its processes were killed together with their supervisor.")


class ProcessExecutor(LocalExecutor):
    """Runs jobs as processes: in `images`, or without them with the programs and the Python of this machine."""

    def __init__(
        self,
        machine: Machine | None = None,
        environments: EnvironmentCache | None = None,
        images: ImageStore | None = None,
    ) -> None:
        super().__init__(machine, environments)
        self._images = images
        self._images_in_use: dict[str, StoredImage] = {}
        self._is_isolated = process_sandbox.is_available()
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def abilities(self) -> ExecutorAbilities:
        """Supported features. Without a sandbox, a job has the file and network access of the runner."""
        return ExecutorAbilities(
            executor="process",
            isolation=Isolation.namespaces if self._is_isolated else Isolation.none,
            images=self._images is not None,
            networks=frozenset(Network) if self._is_isolated else frozenset({Network.open}),
            gpus=False,
            bounds_memory=True,
            bounds_disk=True,
            environments=self._environments is not None,
        )

    def prepare_image(self, image: str) -> PinnedImage:
        """Make an image available; refuse all without a store of images."""
        if self._images is None:
            raise cannot_start(_NO_IMAGES)
        try:
            resolved = self._images.prepare(image)
        except ImageFailure as error:
            reason = EndReason.image_unavailable if error.is_possible else EndReason.not_possible
            raise cannot_start(str(error), reason) from error
        return PinnedImage(reference=resolved.reference, digest=resolved.digest)

    def submit(self, job: RunJob) -> None:
        """Start the supervisor of a job."""
        image = self._image_of(job)
        network = job.network.value
        self._check_network(job, f"Without a container engine, no run here has the network {network!r}.")
        uid = make_directories(job, own_uid=os.getuid() == 0 and self._is_isolated)
        task = {
            "command": list(job.command),
            "environment": self._environment(job),
            "is_isolated": self._is_isolated,
            "has_network": job.network is Network.open,
            "uid": uid,
            "packages": str(job.packages) if job.packages is not None else None,
            "image": None,
            "limits": limits_of(job),
            "port_forwards": job.port_forwards,
        }
        if image is not None:
            task |= _task_in_image(job, image, uid)
        write_atomically(job.directory / process_supervisor.JOB, json.dumps(task))
        # The ending can be written however full the disk is by then.
        reserve(job.directory / ENDING)
        self._start_supervisor(job)

    def _image_of(self, job: RunJob) -> StoredImage | None:
        """Return the image of a job, in use until the job is removed."""
        if self._images is None:
            if job.image is not None:
                raise cannot_start(_NO_IMAGES)
            return None
        if job.image is None:
            raise cannot_start("This runner runs everything in an image, and the action names none.")
        image = self._use_image(job)
        if image is None:
            raise cannot_start(f"The image {job.image} is not on this runner.", EndReason.image_unavailable)
        return image

    def _use_image(self, job: RunJob) -> StoredImage | None:
        if job.key not in self._images_in_use and self._images is not None and job.image is not None:
            image = self._images.find(job.image)
            if image is not None:
                self._images_in_use[job.key] = image
        return self._images_in_use.get(job.key)

    def poll(self, job: RunJob) -> Ending | None:
        """Return the ending that the supervisor wrote, once the supervisor is gone."""
        if self._supervisor_pid(job) is not None:
            # Of a job that an earlier runner process started.
            self._use_image(job)
            return None
        if job.key in self._children:
            self._children[job.key].poll()
        try:
            ending = json.loads((job.directory / ENDING).read_text())
        except FileNotFoundError:
            return _LOST
        return Ending(EndReason(ending["reason"]), ending["message"], ending["exit_code"])

    def cancel(self, job: RunJob) -> None:
        """Send SIGTERM to the supervisor."""
        self._signal(job, signal.SIGTERM)

    def usage(self, job: RunJob) -> Usage | None:
        """Return the usage that the supervisor wrote last."""
        try:
            return Usage(**json.loads((job.directory / USAGE).read_text()))
        except FileNotFoundError:
            return None

    def remove(self, job: RunJob) -> None:
        """Kill the supervisor, which kills the job."""
        # A supervisor that has just been started does nothing without it.
        (job.directory / process_supervisor.JOB).unlink(missing_ok=True)
        while self._supervisor_pid(job) is not None:
            self._signal(job, signal.SIGKILL)
            time.sleep(_POLL_EVERY_S)
        if (child := self._children.pop(job.key, None)) is not None:
            child.wait()
        if (image := self._images_in_use.pop(job.key, None)) is not None:
            image.close()

    def remove_others(self, known_keys: Collection[str]) -> None:
        """Do nothing: supervisors end jobs whose lease is not extended."""

    def _find_python(self, image: str | None) -> Python:
        command = [sys.executable, "-I", "-c", PROBE]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return parse_python(done.stdout)

    def _compile_packages(self, image: str | None, folder: Path, wait: Wait) -> None:
        compile_packages(sys.executable, folder, wait)

    def _start_supervisor(self, job: RunJob) -> None:
        lock = os.open(job.directory / process_supervisor.LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            for _ in range(_LOCK_RETRIES):
                # Another thread may be checking whether a supervisor is alive.
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                time.sleep(_POLL_EVERY_S)
            else:
                raise cannot_start("An earlier start of this job still runs.")
            os.ftruncate(lock, 0)
            # Blocked until the supervisor has a handler: it may be cancelled from now on.
            previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
            try:
                with (job.directory / "supervisor.log").open("ab") as errors:
                    child = subprocess.Popen(
                        [sys.executable, "-I", "-m", process_supervisor.__name__, str(job.directory), str(lock)],
                        stdin=subprocess.DEVNULL,
                        stdout=errors,
                        stderr=errors,
                        env={"PATH": os.defpath},
                        pass_fds=[lock],
                        start_new_session=True,
                    )
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, previous)
            self._children[job.key] = child
            process_supervisor.write_pid(lock, child.pid)
        finally:
            # The supervisor has the lock until it ends.
            os.close(lock)

    def _supervisor_pid(self, job: RunJob) -> int | None:
        """Return the pid of the supervisor, 0 where it is about to start; None where there is none."""
        try:
            lock = os.open(job.directory / process_supervisor.LOCK, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            return None
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return int(os.pread(lock, 32, 0) or b"0")
        else:
            return None
        finally:
            os.close(lock)

    def _signal(self, job: RunJob, number: signal.Signals) -> None:
        if pid := self._supervisor_pid(job):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)

    def _environment(self, job: RunJob) -> dict[str, str]:
        environment = {"PATH": os.environ.get("PATH", os.defpath), "LANG": "C.UTF-8", "PYTHONUNBUFFERED": "1"}
        if job.packages is not None:
            packages = process_sandbox.PACKAGES if self._is_isolated else str(job.packages)
            environment |= {PACKAGES_VARIABLE: packages, "PYTHONPATH": packages}
        if self._is_isolated:
            return {**environment, "HOME": "/tmp", "TMPDIR": "/tmp", **job.environment}  # noqa: S108  the job's own
        directories = {name: str(job.directory / name) for name in ("in", "out", "tmp")}
        environment |= {IN_VARIABLE: directories["in"], OUT_VARIABLE: directories["out"]}
        environment |= {"TMPDIR": directories["tmp"], "HOME": directories["tmp"]}
        return environment | {
            name: f"{job.directory}{value}" if value.startswith("/in/") else value
            for name, value in job.environment.items()
        }


def _task_in_image(job: RunJob, image: StoredImage, uid: int | None) -> dict[str, object]:
    """Return what differs for a job in an image. Raises CannotStart."""
    run = image.run
    command = [*run.entrypoint, *(job.command or run.command)]
    if not command:
        raise cannot_start("Neither the action nor its image names a command.", EndReason.command_not_found)
    # Those in its own directories are writable anyway.
    volumes = [path for path in run.volumes if path.split("/")[1] not in ("in", "out", "tmp")]
    for number, _ in enumerate(volumes):
        directory = process_sandbox.volume_directory(job.directory, number)
        directory.mkdir(exist_ok=True)
        if uid is not None:
            os.chown(directory, uid, uid)
    root = process_sandbox.ImageRoot(str(image.path), volumes, run.directory)
    return {"command": command, "environment": _environment_in_image(job, run), "image": root}


def _environment_in_image(job: RunJob, run: ImageRun) -> dict[str, str]:
    """Return the variables of the image, those of every job, and those of this one."""
    variables = {"PATH": _IMAGE_PATH, **dict(entry.partition("=")[::2] for entry in run.environment)}
    variables |= {"HOME": "/tmp", "TMPDIR": "/tmp", "PYTHONUNBUFFERED": "1"}  # noqa: S108  the job's own
    if job.packages is not None:
        search_path = ":".join(filter(None, (process_sandbox.PACKAGES, variables.get("PYTHONPATH"))))
        variables |= {PACKAGES_VARIABLE: process_sandbox.PACKAGES, "PYTHONPATH": search_path}
    return variables | dict(job.environment)
