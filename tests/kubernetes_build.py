"""Builds Kubernetes from Debian's source package, into the folder of KLEINKRAM_TEST_KUBERNETES.

`python -m tests.kubernetes_build` does it once, in half an hour on two cores. Nothing is installed on the machine: what
else a cluster needs comes from Debian's packages, unpacked in the same folder. Debian 12 only: later releases have no
sources of the API server.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.requirements import missing

VARIABLE = "KLEINKRAM_TEST_KUBERNETES"
VERSION = "1.20.2"
PROGRAMS = ("kube-apiserver", "kube-controller-manager", "kube-scheduler", "kubelet", "kube-proxy", "kubectl")
_GO = "1.19"
_PACKAGES = (f"golang-{_GO}-go", f"golang-{_GO}-src", "etcd-server", "containernetworking-plugins")
_KEYS = "/usr/share/keyrings/debian-archive-keyring.gpg"
_VERSION_FILE = "staging/src/k8s.io/component-base/version/base.go"
# Without the clouds, and without the container runtime that later versions do not have either.
_TAGS = "providerless,dockerless"


class KubernetesBuild:
    """The programs of a cluster in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._packages = folder / "packages"
        self.plugins = self._packages / "usr" / "lib" / "cni"

    @property
    def is_complete(self) -> bool:
        """Whether everything was built."""
        return all(self.program(name).exists() for name in PROGRAMS) and self.program("etcd").exists()

    def program(self, name: str) -> Path:
        """Return the path of a program."""
        return (self._packages / "usr" / "bin" if name == "etcd" else self.folder / "bin") / name

    def make(self) -> None:
        """Fetch and build what is not there."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if not self.plugins.exists():
            self._fetch_packages()
        sources = self.folder / "sources" / "src" / "k8s.io" / "kubernetes"
        if not sources.exists():
            self._fetch_sources(sources)
        self._generate(sources)
        for name in PROGRAMS:
            if not self.program(name).exists():
                _say(f"building {name}")
                self._build(sources, f"./cmd/{name}", self.program(name))

    def _fetch_packages(self) -> None:
        _say(f"fetching {', '.join(_PACKAGES)}")
        archives = self.folder / "archives"
        archives.mkdir(exist_ok=True)
        _run("apt-get", "download", *_PACKAGES, folder=archives)
        for archive in archives.glob("*.deb"):
            _run("dpkg-deb", "--extract", archive, self._packages, folder=archives)

    def _fetch_sources(self, sources: Path) -> None:
        """Fetch the source package by the lists of this machine's own sources of packages."""
        _say(f"fetching the sources of Kubernetes {VERSION}")
        home = self.folder / "apt"
        for name in ("lists/partial", "archives/partial"):
            (home / name).mkdir(parents=True, exist_ok=True)
        entries = _run("apt-get", "indextargets", "--format", "$(ORIGIN) $(REPO_URI) $(RELEASE) main", folder=home)
        lines = {line.removeprefix("Debian ") for line in entries.splitlines() if line.startswith("Debian ")}
        (home / "sources.list").write_text("".join(f"deb-src [signed-by={_KEYS}] {line}\n" for line in sorted(lines)))
        settings = {
            "Dir::State::lists": home / "lists",
            "Dir::Cache::archives": home / "archives",
            "Dir::Cache::pkgcache": "",
            "Dir::Cache::srcpkgcache": "",
            "Dir::Etc::sourcelist": home / "sources.list",
            "Dir::Etc::sourceparts": "/dev/null",
            "APT::Sandbox::User": "root",
        }
        options = [f"--option={name}={value}" for name, value in settings.items()]
        _run("apt-get", *options, "update", folder=home)
        _run("apt-get", *options, "source", "--download-only", "kubernetes", folder=home)
        (description,) = home.glob(f"kubernetes_*{VERSION}*.dsc")
        partial = sources.with_name("partial")
        partial.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(partial, ignore_errors=True)
        _run("dpkg-source", "--no-check", "--extract", description, partial, folder=home)
        # Without the repository, it does not know its version.
        version = partial / _VERSION_FILE
        version.write_text(re.sub(r'"v0\.0\.0-master[^"]*"', f'"v{VERSION}"', version.read_text()))
        partial.rename(sources)

    def _generate(self, sources: Path) -> None:
        """Generate the only code that the sources lack, as their Makefile does."""
        package = "pkg/generated/openapi"
        if (sources / package / "zz_generated.openapi.go").exists():
            return
        _say("generating code")
        generator = self.folder / "bin" / "openapi-gen"
        self._build(sources, "./vendor/k8s.io/kube-openapi/cmd/openapi-gen", generator)
        vendored = [path for path in sorted((sources / "vendor" / "k8s.io").iterdir()) if path.is_dir()]
        others = [path for path in vendored if path.name not in {"code-generator", "sample-apiserver"}]
        places = [f"{path.relative_to(sources)}/" for path in (sources / "pkg", *others)]
        listing = _run("grep", "-rl", "--include=*.go", "+k8s:openapi-gen=", *places, folder=sources)
        folders = sorted({str(Path(line).parent) for line in listing.splitlines()})
        options = {
            "input-dirs": ",".join(f"k8s.io/kubernetes/{folder}" for folder in folders),
            "output-package": f"k8s.io/kubernetes/{package}",
            "output-file-base": "zz_generated.openapi",
            "go-header-file": "hack/boilerplate/boilerplate.generatego.txt",
            "report-filename": str(self.folder / "violations"),
            "output-base": str(self.folder / "sources" / "src"),
        }
        words = [f"--{name}={value}" for name, value in options.items()]
        _run(generator, *words, folder=sources, environment=self._environment())

    def _build(self, sources: Path, package: str, output: Path) -> None:
        output.parent.mkdir(exist_ok=True)
        partial = output.with_suffix(".partial")
        options = ["-p", "2", "-tags", _TAGS, "-trimpath", "-ldflags", "-s -w", "-o", str(partial), package]
        _run("nice", "go", "build", *options, folder=sources, environment=self._environment())
        partial.rename(output)

    def _environment(self) -> Mapping[str, str]:
        root = self._packages / "usr" / "lib" / f"go-{_GO}"
        return {
            "PATH": f"{root / 'bin'}:{os.environ['PATH']}",
            "HOME": str(self.folder),
            "GOROOT": str(root),
            "GOPATH": str(self.folder / "sources"),
            "GOCACHE": str(self.folder / "cache"),
            "GO111MODULE": "off",
            "GOPROXY": "off",
            "CGO_ENABLED": "0",
        }


def need_kubernetes() -> KubernetesBuild:
    """Return the programs that were built, or skip."""
    folder = os.environ.get(VARIABLE)
    if not folder or not (build := KubernetesBuild(Path(folder))).is_complete:
        missing(f"no Kubernetes: {VARIABLE}=FOLDER python -m tests.kubernetes_build builds it in half an hour")
    return build


def _run(program: str | Path, *words: str | Path, folder: Path, environment: Mapping[str, str] | None = None) -> str:
    command = [str(program), *map(str, words)]
    done = subprocess.run(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)[:500]}: {done.stderr[-3000:]}")
    return done.stdout


def _say(text: str) -> None:
    sys.stdout.write(f"Kubernetes: {text}\n")
    sys.stdout.flush()


def main() -> None:
    """Build it where the variable says; without it, nothing."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        _say(f"set {VARIABLE} to a folder to build it there; tests with a real cluster are skipped")
        return
    KubernetesBuild(Path(folder)).make()


if __name__ == "__main__":
    main()
