"""A real cluster with what a runner needs: its objects of `deploy/kubernetes`, images, volumes, and a kubeconfig."""

from __future__ import annotations

import base64
import contextlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests import kubernetes_cluster
from tests.integration.deploy import images
from tests.integration.kubernetes.manifests import FILE
from tests.integration.runner import engines
from tests.integration.runner.engines import python_root, root_of
from tests.integration.runner.registry_images import RegistryImages, gzipped
from tests.kubernetes_build import need_kubernetes
from tests.kubernetes_cluster import KubernetesCluster, wait_for
from tests.kubernetes_volumes import FolderVolumes
from tests.ports import choose_port
from tests.requirements import missing, need, path_of

NAMESPACE = "kleinkram-runs"
_SCRIPTS = "kleinkram.test/scripts"


@dataclass
class RealCluster:
    """The cluster. `kubeconfig` is the runner's, and `python_image` that of the contract tests."""

    cluster: KubernetesCluster
    volumes: FolderVolumes
    kubeconfig: Path
    registry: RegistryImages
    pod_image: str
    script_image: str
    python_image: str


@contextlib.contextmanager
def real_cluster() -> Iterator[RealCluster]:
    """Run a cluster with a namespace for runs, or skip."""
    build = need_kubernetes()
    if os.geteuid() != 0:
        missing("a Kubernetes of the tests' own needs root")
    need(*kubernetes_cluster.PROGRAMS, *engines.PROGRAMS, "debootstrap")
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="klein-kubernetes-")))
        # Nodes find it by an address that does not exist yet.
        registry = engines.Registry(folder / "registry", choose_port(), address="0.0.0.0")
        registry.start()
        stack.callback(registry.end)
        pushed = RegistryImages(registry)
        pod_image, script_image = _build_images(registry.place)
        cluster = stack.enter_context(
            kubernetes_cluster.kubernetes_cluster(build, registry=registry.place, pause=_push_pause(pushed))
        )
        volumes = FolderVolumes(cluster.api, folder / "volumes")
        stack.callback(volumes.close)
        cluster.kubectl("create", "namespace", NAMESPACE)
        cluster.kubectl("apply", "--filename", str(FILE), namespace=NAMESPACE)
        kubeconfig = cluster.write_kubeconfig(folder / "kubeconfig", _token(cluster), NAMESPACE)
        python_image = pushed.push("kleinkram.test/python", [gzipped(python_root())])
        yield RealCluster(cluster, volumes, kubeconfig, pushed, pod_image, script_image, python_image)


def _build_images(place: str) -> tuple[str, str]:
    """Build the image of Kleinkram's pods as docs say, and one for scripts from it; return their names."""
    with engines.bridge() as (name, gateway), engines.dockerd(name, gateway) as docker:
        images.load_base(docker)
        images.build(docker, "runner", images.RUNNER)
        text = f"FROM {images.RUNNER}\nENTRYPOINT []\n"
        docker.docker("build", "--quiet", "--tag", _SCRIPTS, "-", inputs=text.encode())
        names = [f"{place}/{image}:tests" for image in (images.RUNNER, _SCRIPTS)]
        for image, remote in zip((images.RUNNER, _SCRIPTS), names, strict=True):
            docker.docker("tag", image, remote)
            docker.docker("push", "--quiet", remote)
        return names[0], names[1]


def _push_pause(registry: RegistryImages) -> str:
    """Put the image of the container that holds the namespaces of a pod into the registry."""
    program = path_of("catatonit")
    assert program is not None
    files = root_of({"pause": Path(program).read_bytes()})
    return registry.push("kleinkram.test/pause", [gzipped(files)], config={"Entrypoint": ["/pause", "-P"]})


def _token(cluster: KubernetesCluster) -> str:
    """Return the token of the runner's service account, which the cluster writes into a Secret."""
    path = f"/api/v1/namespaces/{NAMESPACE}/secrets/kleinkram-runner-token"

    def token() -> str:
        return str(((cluster.api.find(path) or {}).get("data") or {}).get("token", ""))

    wait_for(token, "the service account has no token")
    return base64.b64decode(token()).decode()
