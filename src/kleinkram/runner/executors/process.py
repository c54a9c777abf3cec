"""Runs jobs as processes of this machine, in sandboxes where the kernel allows that.

A supervisor process per job starts it, enforces its limits and writes its log and ending. It outlives the runner. The
runner and the supervisor share a lock, by which a later runner finds out whether the supervisor is alive.
"""

import contextlib
import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from kleinkram.action.run_files import IN_VARIABLE, OUT_VARIABLE, PACKAGES_VARIABLE
from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runners import ExecutorAbilities
from kleinkram.contract.runs import EndReason, Usage
from kleinkram.environments.cache import EnvironmentCache, compile_packages
from kleinkram.environments.python import PROBE, Python, PythonUnknown, parse_python
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors import nvidia, process_sandbox, process_supervisor
from kleinkram.runner.executors.base import CannotStart, Ending, PinnedImage, RunJob
from kleinkram.runner.executors.docker.container import NOT_EXECUTED_CODES, execution_error
from kleinkram.runner.executors.gpus import Gpu
from kleinkram.runner.executors.local import LocalExecutor, Machine, cannot_start, limits_of, make_directories
from kleinkram.runner.executors.process_sandbox import OWN_ENTRIES
from kleinkram.runner.executors.supervision import ENDING, USAGE, command_not_found, reserve, write_atomically
from kleinkram.runner.images.apptainer import VARIABLE, Apptainer
from kleinkram.runner.images.store import ImageFailure, ImageRun, ImageStore, StoredImage

_LOCK_RETRIES = 50
_POLL_EVERY_S = 0.02
_NO_IMAGES = "Without a container engine, no image can be run."
# What all of NVIDIA's GPUs share.
_NVIDIA_NODES = ("/dev/nvidiactl", "/dev/nvidia-uvm", "/dev/nvidia-uvm-tools")
_BYTECODE = "/out/bytecode"
_TOOL_BYTES = 2**30
_TOOL_TIMEOUT_S = 600
_TOOL_OUTPUT_BYTES = 2**16
_FIRST_OUTPUT_BYTES = 2**12
# Of images that set none, as container engines have it.
_IMAGE_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
_LOST = Ending(EndReason.lost, "Its processes were killed together with their supervisor.")


class _TaskInImage(NamedTuple):
    """The variables of a job in an image, and what else differs for its supervisor."""

    environment: dict[str, str]
    changes: dict[str, object]


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
        builder = images.builder if images is not None else None
        self._apptainer = builder if isinstance(builder, Apptainer) else None
        # Apptainer isolates jobs itself, by a program that a sandbox would disarm.
        self._is_isolated = self._apptainer is None and process_sandbox.is_available()
        self._images_in_use: dict[str, StoredImage] = {}
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._pythons: dict[str, Python] = {}

    @property
    def abilities(self) -> ExecutorAbilities:
        """Supported features. Without a sandbox, a job has the file and network access of the runner."""
        networks = frozenset(Network) if self._is_isolated else frozenset({Network.open})
        return ExecutorAbilities(
            executor="process",
            isolation=Isolation.namespaces if self._is_isolated or self._apptainer else Isolation.none,
            images=self._images is not None,
            networks=frozenset({Network.none, Network.open}) if self._apptainer else networks,
            gpus=self._gpus is not None,
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
        gpus = self._assign_gpus(job)
        uid = make_directories(job, own_uid=os.getuid() == 0 and self._is_isolated)
        environment = self._environment(job)
        task: dict[str, object] = {
            "command": list(job.command),
            "environment": environment,
            "devices": _nodes_of(gpus),
            "is_isolated": self._is_isolated,
            "has_network": job.network is Network.open,
            "uid": uid,
            "packages": str(job.packages) if job.packages is not None else None,
            "image": None,
            "volumes": 0,
            "gpus": job.resources.gpus,
            "variable_prefix": "",
            "has_own_isolation": False,
            "limits": limits_of(job),
            "port_forwards": job.port_forwards,
        }
        if image is not None:
            in_image = self._task_in_image(job, image, uid)
            environment = in_image.environment
            task |= in_image.changes
        prefix = task["variable_prefix"]
        task["environment"] = environment | {f"{prefix}{name}": value for name, value in _variables_of(gpus).items()}
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

    def _task_in_image(self, job: RunJob, image: StoredImage, uid: int | None) -> "_TaskInImage":
        """Return what differs for a job in an image. Raises CannotStart."""
        command = [*image.run.entrypoint, *(job.command or image.run.command)]
        if not command:
            raise cannot_start("Neither the action nor its image names a command.", EndReason.command_not_found)
        volumes = _volumes_of(image.run)
        process_sandbox.make_volumes(job.directory, len(volumes), uid)
        if self._apptainer is not None:
            return _task_of_apptainer(self._apptainer, job, image, command, volumes)
        root = process_sandbox.ImageRoot(str(image.path), volumes, image.run.directory)
        return _TaskInImage(
            _environment_in_image(job, image.run), {"command": command, "image": root, "volumes": len(volumes)}
        )

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
        code = ending["exit_code"]
        if self._apptainer is not None and code in NOT_EXECUTED_CODES:
            output = self.read_log(job, 0, _FIRST_OUTPUT_BYTES).decode(errors="replace")
            if (detail := execution_error(output, job.command, code)) is not None:
                return Ending.of(command_not_found(detail))
        return Ending(EndReason(ending["reason"]), ending["message"], code)

    def cancel(self, job: RunJob) -> None:
        """Send SIGTERM to the supervisor."""
        self._signal(job, signal.SIGTERM)

    def usage(self, job: RunJob) -> Usage | None:
        """Return the usage that the supervisor wrote last; None where it cannot be read at the moment, either."""
        try:
            return Usage(**json.loads((job.directory / USAGE).read_text()))
        except (OSError, ValueError):
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
        self._release_gpus(job)
        if (image := self._images_in_use.pop(job.key, None)) is not None:
            image.close()

    def gpu_obstacle(self, gpu: Gpu) -> str | None:
        """Return what is missing to show the files of a GPU to a job."""
        if gpu.nodes or not self._is_isolated:
            return None
        by = "run `nvidia-ctk cdi generate --output=/etc/cdi/nvidia.yaml` (package nvidia-container-toolkit)"
        return f"no CDI specification tells which files below /dev belong to {gpu.id}: {by}"

    def remove_others(self, known_keys: Collection[str]) -> None:
        """Do nothing: supervisors end jobs whose lease is not extended."""

    def _find_python(self, image: str | None) -> Python:
        if image is None:
            command = [sys.executable, "-I", "-c", PROBE]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            return parse_python(done.stdout)
        if image not in self._pythons:
            with self._tool_job(image, ["python3", "-I", "-c", PROBE]) as job:
                self._run_tool(job, lambda _: None)
                self._pythons[image] = parse_python(self.read_log(job, 0, _TOOL_OUTPUT_BYTES).decode(errors="replace"))
        return self._pythons[image]

    def _compile_packages(self, image: str | None, folder: Path, wait: Wait) -> None:
        if image is None:
            compile_packages(sys.executable, folder, wait)
            return
        # The image gets the packages read-only: it is only asked for bytecode.
        options = ["-I", "-X", f"pycache_prefix={_BYTECODE}", "-m", "compileall", "-q", "-q", process_sandbox.PACKAGES]
        with self._tool_job(image, ["python3", *options], packages=folder) as job:
            self._run_tool(job, wait)
            _add_bytecode(job.directory / f"{_BYTECODE}{process_sandbox.PACKAGES}"[1:], folder)

    @contextlib.contextmanager
    def _tool_job(self, image: str, command: list[str], packages: Path | None = None) -> Iterator[RunJob]:
        """Yield a job for a command of the runner's own, without network, in a directory beside the images."""
        if self._images is None:
            raise PythonUnknown(_NO_IMAGES)
        with tempfile.TemporaryDirectory(prefix="tool-", dir=self._images.scratch, ignore_cleanup_errors=True) as name:
            Path(name).chmod(0o711)
            resources = Resources(memory_bytes=_TOOL_BYTES, disk_bytes=_TOOL_BYTES, time_s=_TOOL_TIMEOUT_S)
            job = RunJob(Path(name).name, Path(name), command, image, resources, Network.none, packages=packages)
            try:
                yield job
            finally:
                self.remove(job)

    def _run_tool(self, job: RunJob, wait: Wait) -> None:
        """Run a job to its end. Raises PythonUnknown where it fails."""
        try:
            self.submit(job)
        except CannotStart as error:
            raise PythonUnknown(error.ending.message) from error
        while (ending := self.poll(job)) is None:
            wait(_POLL_EVERY_S)
            time.sleep(_POLL_EVERY_S)
        if ending.reason in (EndReason.command_not_found, EndReason.not_possible):
            raise PythonUnknown(f"The image has no python3 that can be started: {ending.message}")
        if ending.reason is not EndReason.done and ending.reason is not EndReason.exit_code:
            raise PythonUnknown(f"Its python3 cannot be used. {ending.message}")

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


def _variables_of(gpus: Sequence[Gpu]) -> dict[str, str]:
    """Return the variables by which programs choose GPUs; without any, they would also find those of other jobs."""
    return {"CUDA_VISIBLE_DEVICES": ",".join(gpu.id for gpu in gpus if gpu.is_nvidia)} if gpus else {}


def _nodes_of(gpus: Sequence[Gpu]) -> list[str]:
    """Return the files below /dev that a job with these GPUs needs."""
    nodes = [node for gpu in gpus for node in gpu.nodes]
    if any(gpu.is_nvidia for gpu in gpus):
        nodes += _NVIDIA_NODES
    return [node for node in dict.fromkeys(nodes) if Path(node).exists()]


def _environment_in_image(job: RunJob, run: ImageRun) -> dict[str, str]:
    """Return the variables of the image, those of every job, and those of this one."""
    variables = {"PATH": _IMAGE_PATH, **dict(entry.partition("=")[::2] for entry in run.environment)}
    variables |= {"HOME": "/tmp", "TMPDIR": "/tmp", "PYTHONUNBUFFERED": "1"}  # noqa: S108  the job's own
    if job.resources.gpus:
        paths = {"LD_LIBRARY_PATH": nvidia.LIBRARIES, "PATH": nvidia.PROGRAMS}
        variables |= {name: ":".join(filter(None, (variables.get(name), path))) for name, path in paths.items()}
    if job.packages is not None:
        search_path = ":".join(filter(None, (process_sandbox.PACKAGES, variables.get("PYTHONPATH"))))
        variables |= {PACKAGES_VARIABLE: process_sandbox.PACKAGES, "PYTHONPATH": search_path}
    return variables | dict(job.environment)


def _volumes_of(run: ImageRun) -> list[str]:
    """Return where an image sees its volumes: `/out` and `/tmp` are writable anyway, and the rest is the sandbox's."""
    return [path for path in sorted(run.volumes) if path != "/" and path.split("/")[1] not in OWN_ENTRIES]


def _task_of_apptainer(
    apptainer: Apptainer, job: RunJob, image: StoredImage, command: list[str], volumes: list[str]
) -> _TaskInImage:
    directories = {f"/{name}": (job.directory / name, name == "in") for name in ("in", "out", "tmp")}
    if job.packages is not None:
        directories[process_sandbox.PACKAGES] = (job.packages, True)
    for number, path in enumerate(volumes):
        directories[path] = (process_sandbox.volume_directory(job.directory, number), False)
    try:
        words = apptainer.command(
            image.path,
            command,
            directories=directories,
            working_directory=image.run.directory,
            network=job.network,
            has_gpus=job.resources.gpus > 0,
        )
    except ValueError as error:
        raise cannot_start(f"It cannot be started here: {error}.") from error
    inside = _environment_in_image(job, image.run)
    environment = {f"{VARIABLE}{name}": value for name, value in inside.items() if name != "HOME"}
    environment["PATH"] = os.environ.get("PATH", os.defpath)
    changes: dict[str, object] = {"command": words, "variable_prefix": VARIABLE, "has_own_isolation": True}
    changes["volumes"] = len(volumes)
    return _TaskInImage(environment, changes)


def _add_bytecode(compiled: Path, packages: Path) -> None:
    """Move the bytecode that an image made to the folder of the packages, beside their files.

    It may have written anything: only files for folders that exist are taken.
    """
    for parent, names, files in os.walk(compiled):
        folder = packages / Path(parent).relative_to(compiled)
        names[:] = [name for name in names if (folder / name).is_dir() and not (folder / name).is_symlink()]
        cache = folder / "__pycache__"
        for file in files:
            source = Path(parent) / file
            if source.suffix == ".pyc" and source.is_file() and not source.is_symlink():
                cache.mkdir(exist_ok=True)
                shutil.copyfile(source, cache / file)
