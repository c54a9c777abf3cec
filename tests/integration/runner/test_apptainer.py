"""Images by Apptainer, which is not installed here: a program of the tests records how it is called."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runs import EndReason
from kleinkram.environments.folder_cache import FolderCache
from kleinkram.runner.executors import nvidia, process_supervisor
from kleinkram.runner.executors.base import CannotStart, RunJob, wait_for_end
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.images import store as store_module
from kleinkram.runner.images.apptainer import Apptainer
from kleinkram.runner.images.names import parse_image_name
from kleinkram.runner.images.registry import ImageConfig, RegistryClient, RegistryImage
from kleinkram.runner.images.store import BuildSpace, ImageFailure, ImageStore
from tests.integration.runner.conftest import log_of

DIGEST = f"sha256:{'ab' * 32}"
# Records its arguments and variables; runs what follows the image, with the variables that Apptainer would set.
PROGRAM = """\
#!/bin/sh
printf '%s\\n' "$@" > {folder}/arguments
env > {folder}/variables
if [ "$1" = build ]; then
  [ -e {folder}/failure ] && {{ echo 'INFO: Starting'; cat {folder}/failure; exit 255; }} >&2
  for word; do case $word in *.sif) echo sif > $word;; esac; done
  exit 0
fi
while [ "${{1##*.}}" != sif ]; do shift; done
shift
exec "$@"
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "apptainer"
    path.write_text(PROGRAM.format(folder=tmp_path))
    path.chmod(0o755)
    return path


def image_of(**config: object) -> RegistryImage:
    return RegistryImage(DIGEST, DIGEST, ImageConfig.model_validate(config), ())


def build(program: Path, name: str = "ghcr.io/lab/slam:1", **config: object) -> store_module.ImageRun:
    folder = program.parent / "new"
    folder.mkdir()
    lock = os.open(program.parent, os.O_RDONLY)
    try:
        full = parse_image_name(name)
        space = BuildSpace(folder, lock, 10**9)
        return Apptainer(str(program)).build(full, image_of(**config), space, RegistryClient(full, "amd64"))
    finally:
        os.close(lock)


def recorded(program: Path, name: str) -> list[str]:
    return (program.parent / name).read_text().splitlines()


def test_an_image_is_built_by_digest(program: Path, tmp_path: Path) -> None:
    run = build(program, WorkingDir="/work", Volumes={"/data": {}}, Env=["A=b"])
    assert recorded(program, "arguments") == [
        *("build", "--disable-cache", str(tmp_path / "new" / "image.sif"), f"docker://ghcr.io/lab/slam@{DIGEST}")
    ]
    assert (run.directory, run.volumes, run.environment) == ("/work", ["/data"], ["A=b"])
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["image.sif"]


def test_a_registry_of_this_machine_needs_no_certificate(program: Path) -> None:
    build(program, "127.0.0.1:5000/lab/slam")
    assert "--no-https" in recorded(program, "arguments")


def test_credentials_are_variables(program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    (tmp_path / "config.json").write_text('{"auths": {"ghcr.io": {"auth": "YWRhOnNlY3JldA=="}}}')
    build(program)
    assert {"APPTAINER_DOCKER_USERNAME=ada", "APPTAINER_DOCKER_PASSWORD=secret"} <= set(recorded(program, "variables"))
    assert not any("secret" in word for word in recorded(program, "arguments"))


def test_the_last_words_of_apptainer_are_the_reason(program: Path, tmp_path: Path) -> None:
    (tmp_path / "failure").write_text("FATAL: While performing build: conveyor failed\n")
    with pytest.raises(ImageFailure, match="conveyor failed"):
        build(program)


@pytest.fixture
def executor(program: Path, tmp_path: Path) -> ProcessExecutor:
    """An executor with an image that Apptainer built."""
    store = ImageStore(tmp_path / "images", 10**9, Apptainer(str(program)))
    key = store._key(DIGEST)
    new = FolderCache.make_folder(store, key)
    (new / "image.sif").write_text("sif")
    run = store_module.run_of(ImageConfig.model_validate({"Env": ["ROBOT=anymal"]}), 4, ["/", "/data"])
    store.publish(new, key, run.model_dump())
    return ProcessExecutor(images=store)


def job_of(folder: Path, *command: str, network: Network = Network.none, **resources: int) -> RunJob:
    directory = folder / "job"
    (directory / "in").mkdir(parents=True)
    limits = Resources.model_validate({"time_s": 30, "memory_bytes": 10**9, **resources})
    return RunJob("job-1", directory, list(command), DIGEST, limits, network, {"KLEINKRAM_TOKEN": "secret"})


def test_a_job_sees_only_its_directories(executor: ProcessExecutor, program: Path, tmp_path: Path) -> None:
    job = job_of(tmp_path, "python3", "-c", "pass")
    executor.submit(job)
    ending = wait_for_end(executor, job, timeout_s=30)
    assert ending is not None
    assert (ending.reason, log_of(job)) == (EndReason.done, "")
    folder, words = job.directory, recorded(program, "arguments")
    image = words.index(next(word for word in words if word.endswith(".sif")))
    assert words[:image] == [
        *("exec", "--containall", "--no-home", "--cleanenv", "--uts", "--pwd", "/"),
        *("--bind", f"{folder}/in:/in:ro", "--bind", f"{folder}/out:/out", "--bind", f"{folder}/tmp:/tmp"),
        *("--bind", f"{folder}/tmp/.volume-0:/data", "--net", "--network", "none"),
    ]
    assert words[-3:] == ["python3", "-c", "pass"]
    assert not any("secret" in word for word in words), "others see the command lines of processes"
    variables = recorded(program, "variables")
    assert {"APPTAINERENV_KLEINKRAM_TOKEN=secret", "APPTAINERENV_ROBOT=anymal"} <= set(variables)
    executor.remove(job)


def test_gpus_are_those_of_the_cluster(
    executor: ProcessExecutor, program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = job_of(tmp_path, "true", network=Network.open, gpus=1)
    monkeypatch.setattr(executor, "_start_supervisor", lambda _: None)
    monkeypatch.setattr(executor, "_assign_gpus", lambda _: ())
    executor.submit(job)
    # As a cluster starts it on a node.
    command = [sys.executable, "-I", "-m", process_supervisor.__name__, str(job.directory), "1"]
    environment = {"PATH": os.defpath, "CUDA_VISIBLE_DEVICES": "3"}
    with (tmp_path / "lock").open("w") as lock:
        subprocess.run(command, check=True, env=environment, stdout=lock)
    words = recorded(program, "arguments")
    assert "--nv" in words
    assert "--network" not in words
    assert "APPTAINERENV_CUDA_VISIBLE_DEVICES=3" in recorded(program, "variables")


def test_what_apptainer_does_not_give_is_not_offered(executor: ProcessExecutor, tmp_path: Path) -> None:
    abilities = executor.abilities
    assert (abilities.images, abilities.isolation) == (True, Isolation.namespaces)
    assert abilities.networks == {Network.none, Network.open}
    with pytest.raises(CannotStart, match="'api'"):
        executor.submit(job_of(tmp_path, "true", network=Network.api))


def test_a_path_that_apptainer_would_misread_is_refused(executor: ProcessExecutor, tmp_path: Path) -> None:
    (tmp_path / "a:b").mkdir()
    with pytest.raises(CannotStart, match="a colon or a comma"):
        executor.submit(job_of(tmp_path / "a:b", "true"))


def test_a_missing_command_is_reported(executor: ProcessExecutor, tmp_path: Path) -> None:
    job = job_of(tmp_path, "/usr/bin/nonsense")
    executor.submit(job)
    ending = wait_for_end(executor, job, timeout_s=30)
    assert ending is not None
    assert ending.reason is EndReason.command_not_found


def test_a_job_ends_with_its_supervisor(executor: ProcessExecutor, tmp_path: Path) -> None:
    job = job_of(tmp_path, "/bin/sh", "-c", "echo $$; exec sleep 60")
    executor.submit(job)
    until = time.monotonic() + 30
    while not re.match(r"\d+\n", log_of(job)):
        assert time.monotonic() < until
        time.sleep(0.02)
    pid = int(log_of(job))
    os.kill(int((job.directory / "supervisor").read_text()), signal.SIGKILL)
    while Path(f"/proc/{pid}").exists() and Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z":
        assert time.monotonic() < until
        time.sleep(0.02)
    ending = wait_for_end(executor, job, timeout_s=10)
    assert ending is not None
    assert ending.reason is EndReason.lost


LDCONFIG = """\
3 libs found in cache `/etc/ld.so.cache'
\tlibcuda.so.1 (libc6,x86-64) => /usr/lib/x86_64-linux-gnu/libcuda.so.1
\tlibcuda.so.1 (libc6) => /usr/lib/i386-linux-gnu/libcuda.so.1
\tlibnvidia-ml.so.1 (libc6,AArch64) => /usr/lib/aarch64-linux-gnu/libnvidia-ml.so.1
\tlibcurl.so.4 (libc6,x86-64) => /usr/lib/x86_64-linux-gnu/libcurl.so.4
"""


def test_the_driver_of_gpus_is_found(tmp_path: Path) -> None:
    assert [Path(path).name for path in nvidia.parse_libraries(LDCONFIG)] == ["libcuda.so.1", "libnvidia-ml.so.1"]
    for name in ("nvidia0", "nvidia1", "nvidiactl", "nvidia-uvm", "null"):
        (tmp_path / name).touch()
    assert [path.name for path in nvidia.devices("1", tmp_path)] == ["nvidiactl", "nvidia-uvm", "nvidia1"]
    assert len(nvidia.devices("GPU-8a56a4bc", tmp_path)) == 4, "the driver itself then shows only that one"
