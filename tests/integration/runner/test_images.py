"""Images without a container engine: fetched from a registry, kept by digest, and run as processes."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.images import store as store_module
from kleinkram.runner.images.names import Pull
from kleinkram.runner.images.store import FolderBuilder, ImageFailure, ImageStore
from tests.integration.runner.conftest import Bench, ImageFolder, lent, log_of
from tests.integration.runner.engines import python_root
from tests.integration.runner.registry_images import ARCHITECTURE, RegistryImages, digest_of, entry, gzipped, layer_of
from tests.ports import choose_port

pytestmark = pytest.mark.slow
GB = 10**9
OTHER = {"amd64": "arm64", "arm64": "amd64"}[ARCHITECTURE]
SMALL = gzipped(layer_of((entry("file"), b"content" * 1000)))


def a_store(folder: Path, limit_bytes: int = GB, **options: object) -> ImageStore:
    return ImageStore(folder / "images", limit_bytes, FolderBuilder(), **options)  # type: ignore[arg-type]


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """A bench for processes in images."""
    yield from lent("images", request, tmp_path)


def refusal(store: ImageStore, image: str) -> str:
    with pytest.raises(ImageFailure) as caught:
        store.prepare(image)
    return str(caught.value)


def test_what_an_image_says_of_itself_is_honoured(bench: Bench, image_folder: ImageFolder) -> None:
    config = {
        "Env": ["ROBOT=anymal", "PATH=/usr/bin", "PYTHONPATH=/opt/lab", "HOME=/root"],
        "Entrypoint": ["python3", "-c"],
        "Cmd": ["print('the command of the image')"],
        "WorkingDir": "/work/space",
        "Volumes": {"/data/large": {}, "/tmp": {}, "/": {}, "/proc": {}},
        "User": "1234:1234",
    }
    image = image_folder.registry.push("lab/configured", [gzipped(python_root())], config=config)
    configured = bench.with_image(bench.executor.prepare_image(image).reference)
    text = (
        "import os, sys; open('/data/large/file', 'w').write('x'); names = ('ROBOT', 'PATH', 'PYTHONPATH', 'HOME')\n"
        "print(os.getcwd(), *(os.environ[name] for name in names), sys.argv[1:], sep='\\n')"
    )
    job, ending = configured.run([text, "argument"])
    assert (ending.reason, ending.message) == (EndReason.done, "")
    assert log_of(job).splitlines() == ["/work/space", "anymal", "/usr/bin", "/opt/lab", "/tmp", "['argument']"]
    assert (job.directory / "tmp" / ".volume-0" / "file").read_text() == "x"
    job, ending = configured.run([])
    assert (ending.reason, log_of(job)) == (EndReason.done, "the command of the image\n")


def test_a_job_needs_an_image_and_a_command(bench: Bench) -> None:
    with pytest.raises(CannotStart, match="names a command") as caught:
        bench.run([])
    assert caught.value.ending.reason is EndReason.command_not_found
    with pytest.raises(CannotStart, match="names none"):
        bench.executor.submit(dataclasses.replace(bench.job("pass"), image=None))
    with pytest.raises(CannotStart, match="is not on this runner") as caught:
        bench.with_image("sha256:" + "0" * 64).run("pass")
    assert caught.value.ending.reason is EndReason.image_unavailable


def test_a_job_sees_its_image_and_not_the_machine(bench: Bench) -> None:
    job, ending = bench.run("import os; print(*sorted(os.listdir('/'))); print(*os.listdir('/etc'))")
    assert ending.reason is EndReason.done
    root, etc = (set(line.split()) for line in log_of(job).splitlines())
    assert {"in", "out", "tmp", "usr", "dev", "proc"} <= root
    assert not {"work", "boot", "var", "srv", "mnt"} & root
    assert etc == {"hosts", "resolv.conf"}


@pytest.mark.parametrize("network", [Network.none, Network.open])
def test_an_image_has_the_names_of_its_network(bench: Bench, network: Network) -> None:
    job = bench.job("import socket; print(socket.gethostbyname('localhost'))", network=network)
    bench.executor.submit(job)
    assert (bench.end_of(job).reason, log_of(job)) == (EndReason.done, "127.0.0.1\n")


def test_an_ordinary_user_runs_images(image_folder: ImageFolder, tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path\n"
        "from tests.integration.runner.conftest import Bench, log_of\n"
        "from tests.integration.runner import test_images\n"
        "from kleinkram.runner.executors.process import ProcessExecutor\n"
        "folder = Path(sys.argv[1]); executor = ProcessExecutor(images=test_images.a_store(folder))\n"
        "image = executor.prepare_image(sys.argv[2]).reference\n"
        "bench = Bench(executor, folder, lambda: executor, image, 'python3')\n"
        'text = \'import os; print(os.getuid(), flush=True); open("/out/x", "w"); open("/usr/x", "w")\'\n'
        "job, ending = bench.run(text)\n"
        "print(log_of(job).split()[0], 'Read-only' in log_of(job), (job.directory / 'out' / 'x').exists())\n"
    )
    # Without any privilege, as the owner of this Python.
    as_user = ["unshare", "--user", "--map-user=4321", "--map-group=4321"] if os.getuid() == 0 else []
    command = [*as_user, sys.executable, "-c", program, str(tmp_path), image_folder.image]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[3])
    assert done.stdout.split() == ["1000", "True", "True"], done.stderr


def test_names_and_digests_lead_to_the_same_image(registry_images: RegistryImages, tmp_path: Path) -> None:
    name = registry_images.push("lab/many", [SMALL], architectures=[OTHER, ARCHITECTURE], tag="1")
    store = a_store(tmp_path)
    by_tag = store.prepare(name)
    assert by_tag.reference != by_tag.digest, "the digest of a name is that of its index"
    assert store.prepare(f"{name}@{by_tag.digest}") == by_tag
    assert a_store(tmp_path, pull=Pull.never).prepare(name) == by_tag
    image = store.find(by_tag.reference)
    assert image is not None
    assert (image.path / "file").read_bytes() == b"content" * 1000
    image.close()


def test_a_moved_tag_is_only_followed_by_always(registry_images: RegistryImages, tmp_path: Path) -> None:
    name = registry_images.push("lab/moved", [SMALL])
    first = a_store(tmp_path).prepare(name)
    registry_images.push("lab/moved", [SMALL], config={"Env": ["A=b"]})
    assert a_store(tmp_path).prepare(name) == first
    second = a_store(tmp_path, pull=Pull.always).prepare(name)
    assert second != first
    assert a_store(tmp_path).prepare(f"{name}@{first.digest}") == first


def test_refusals_say_what_to_do(registry_images: RegistryImages, tmp_path: Path) -> None:
    store, place = a_store(tmp_path), registry_images.registry.place
    name = registry_images.push("lab/refused", [SMALL])
    assert "does not exist" in refusal(store, f"{place}/lab/never:1")
    assert "does not exist" in refusal(store, f"{name}@sha256:{'0' * 64}")
    assert "does not answer" in refusal(store, f"127.0.0.1:{choose_port()}/lab/away:1")
    assert "it may use images of: ghcr.io" in refusal(a_store(tmp_path, allowed=["ghcr.io"]), name)
    assert "does not pull images" in refusal(a_store(tmp_path, pull=Pull.never), name)
    assert "GB are allowed" in refusal(a_store(tmp_path, limit_bytes=10), name)
    assert not [*(tmp_path / "images").glob("*root*/root")]


def test_an_image_for_another_architecture_is_not_possible(registry_images: RegistryImages, tmp_path: Path) -> None:
    for name in ("lab/foreign", "lab/foreign-index"):
        kinds = [OTHER, "riscv64"] if name.endswith("index") else [OTHER]
        image = registry_images.push(name, [SMALL], architectures=kinds)
        with pytest.raises(CannotStart, match=f"is for {OTHER}.*; this runner is {ARCHITECTURE}") as caught:
            ProcessExecutor(images=a_store(tmp_path)).prepare_image(image)
        assert caught.value.ending.reason is EndReason.not_possible


def test_a_registry_that_sends_something_else_is_noticed(registry_images: RegistryImages, tmp_path: Path) -> None:
    layer = gzipped(layer_of((entry("file"), b"genuine")))
    name = registry_images.push("lab/exchanged", [layer])
    digest = digest_of(layer).removeprefix("sha256:")
    (stored,) = registry_images.registry.folder.rglob(f"{digest}/data")
    other = gzipped(layer_of((entry("file"), b"hostile")))
    stored.write_bytes(other.ljust(len(layer), b"\0")[: len(layer)])
    assert f"it is not sha256:{digest}" in refusal(a_store(tmp_path), name)
    stored.write_bytes(layer[: len(layer) // 2])
    assert "broke off" in refusal(a_store(tmp_path), name)
    stored.write_bytes(layer)
    a_store(tmp_path).prepare(name)


def test_a_hostile_layer_leaves_nothing(registry_images: RegistryImages, tmp_path: Path) -> None:
    name = registry_images.push("lab/hostile", [gzipped(layer_of((entry("../../../escaped"), b"x")))])
    assert "leads out of the image" in refusal(a_store(tmp_path), name)
    assert not [*tmp_path.rglob("escaped")]
    assert not [*(tmp_path / "images").glob("*.new-*")]


def test_a_full_disk_is_reported(
    registry_images: RegistryImages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = registry_images.push("lab/full", [SMALL])
    store = a_store(tmp_path)
    full = shutil.disk_usage(tmp_path)._replace(free=store_module._SPARE_BYTES + 10)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: full)
    assert "are allowed" in refusal(store, name)
    monkeypatch.setattr(FolderBuilder, "build", lambda *_: store_module.check_space(tmp_path))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: full._replace(free=0))
    assert "The disk is full" in refusal(store, name)


def test_unused_images_make_space(registry_images: RegistryImages, tmp_path: Path) -> None:
    layers = [gzipped(layer_of((entry(f"file-{number}"), os.urandom(400_000)))) for number in range(3)]
    first, second, third = (registry_images.push(f"lab/size-{n}", [layer]) for n, layer in enumerate(layers))
    store = a_store(tmp_path, limit_bytes=GB)
    references = [store.prepare(name).reference for name in (first, second)]
    store.close()
    used = a_store(tmp_path).find(references[0])
    assert used is not None
    last = a_store(tmp_path, limit_bytes=900_000).prepare(third)
    store = a_store(tmp_path)
    left = [reference for reference in (*references, last.reference) if store.find(reference) is not None]
    assert left == [references[0], last.reference], "the one in use stays"
    used.close()


def test_the_image_of_a_job_stays_while_it_runs(image_folder: ImageFolder, bench: Bench, tmp_path: Path) -> None:
    job = bench.job("import time; print('ready', flush=True); time.sleep(60)")
    bench.executor.submit(job)
    store = image_folder.store()
    key = store._key(str(job.image))
    with store.try_lock(key) as lock:
        assert lock is None
    later = ProcessExecutor(images=image_folder.store())
    assert later.poll(job) is None
    later.remove(job)
    assert job.key not in later._images_in_use


def test_two_runners_fetch_an_image_once(registry_images: RegistryImages, tmp_path: Path) -> None:
    name = registry_images.push("lab/shared", [SMALL])
    built: list[str] = []

    class Counting(FolderBuilder):
        def build(self, *parts: object) -> store_module.ImageRun:
            built.append("built")
            return super().build(*parts)  # type: ignore[arg-type]

    stores = [ImageStore(tmp_path / "images", GB, Counting()) for _ in range(3)]
    threads = [threading.Thread(target=store.prepare, args=(name,)) for store in stores]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert built == ["built"]


def test_a_killed_build_is_done_again(registry_images: RegistryImages, tmp_path: Path) -> None:
    name = registry_images.push("lab/killed", [SMALL])
    program = (
        "import sys, os, signal; from pathlib import Path; from kleinkram.runner.images import store, unpack\n"
        "store._unpack = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "store.ImageStore(Path(sys.argv[1]), 10**9, store.FolderBuilder()).prepare(sys.argv[2])\n"
    )
    folder = tmp_path / "images"
    done = subprocess.run([sys.executable, "-c", program, str(folder), name], check=False)
    assert done.returncode == -signal.SIGKILL
    assert [*folder.glob("*.new-*")]
    a_store(tmp_path).prepare(name)
    assert not [*folder.glob("*.new-*")]


def test_scripts_run_with_the_python_of_the_image(bench: Bench, tmp_path: Path) -> None:
    executor = bench.executor
    assert isinstance(executor, ProcessExecutor)
    version = executor._find_python(bench.image).version
    assert version == ".".join(map(str, sys.version_info[:3]))
    packages = tmp_path / "packages"
    (packages / "lab").mkdir(parents=True)
    (packages / "lab" / "__init__.py").write_text("VALUE = 42\n")
    executor._compile_packages(bench.image, packages, lambda _: None)
    assert [path.name for path in packages.rglob("*.pyc")] == [f"__init__.{sys.implementation.cache_tag}.pyc"]
    job = bench.job("import lab; print(lab.VALUE, lab.__file__)")
    job = dataclasses.replace(job, packages=packages)
    executor.submit(job)
    assert (bench.end_of(job).reason, log_of(job)) == (EndReason.done, "42 /env/lab/__init__.py\n")
