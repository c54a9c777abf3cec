"""The Helm chart of `deploy/helm`, rendered by Helm, and what its manifests contain."""

import json
import re
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from ruamel.yaml import YAML

from tests.integration.deploy.units import ROOT
from tests.requirements import need_helm

CHART = ROOT / "deploy" / "helm" / "kleinkram"
EXAMPLES = {path.stem.removeprefix("values-"): path for path in sorted((CHART / "examples").glob("*.yaml"))}
RELEASE = "lab"
SECRETS = "/run/secrets/kleinkram"
Manifest = dict[str, Any]
MINIMAL: Mapping[str, Any] = {
    "publicUrl": "https://kleinkram.lab.example",
    "image": {"repository": "registry.lab.example/kleinkram/server"},
    "database": {
        "url": "postgresql://kleinkram_serve@db.lab.example/kleinkram",
        "passwordSecret": {"name": "database", "key": "serve"},
        "migration": {
            "url": "postgresql://kleinkram_migrate@db.lab.example/kleinkram",
            "passwordSecret": {"name": "database", "key": "migrate"},
        },
    },
    "store": {
        "url": "https://s3.lab.example",
        "accessKey": "key",
        "secretKeySecret": {"name": "store", "key": "secret"},
    },
}


class ChartRefused(Exception):
    """Helm did not render the chart. The text is its message."""


@dataclass(frozen=True)
class Chart:
    """The manifests that Helm renders."""

    manifests: tuple[Manifest, ...]

    def of_kind(self, kind: str) -> list[Manifest]:
        """Return the manifests of one kind."""
        return [manifest for manifest in self.manifests if manifest["kind"] == kind]

    def named(self, kind: str, suffix: str) -> Manifest:
        """Return the manifest of a kind whose name ends with a suffix."""
        (manifest,) = [it for it in self.of_kind(kind) if it["metadata"]["name"].endswith(suffix)]
        return manifest

    def pods(self) -> dict[str, Manifest]:
        """Return the pods that the manifests describe, by the suffix of their names."""
        return {manifest["metadata"]["name"].rpartition("-")[2]: pod for manifest, pod in self._pods()}

    def containers(self) -> Iterator[tuple[Manifest, Manifest]]:
        """Yield each pod's specification with each of its containers."""
        for pod in self.pods().values():
            for container in [*pod["spec"].get("initContainers", ()), *pod["spec"]["containers"]]:
                yield pod["spec"], container

    def _pods(self) -> Iterator[tuple[Manifest, Manifest]]:
        for manifest in self.manifests:
            if manifest["kind"] == "Pod":
                yield manifest, manifest
            elif manifest["kind"] == "CronJob":
                yield manifest, manifest["spec"]["jobTemplate"]["spec"]["template"]
            elif manifest["kind"] in {"Deployment", "Job"}:
                yield manifest, manifest["spec"]["template"]


def merged(*parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with those of later parts in place of earlier ones, group by group; None removes one of them."""
    result: dict[str, Any] = {}
    for part in parts:
        for name, value in part.items():
            is_group = isinstance(value, Mapping) and isinstance(result.get(name), Mapping)
            if value is None and name in result:
                del result[name]
            else:
                result[name] = merged(result[name], value) if is_group else value
    return result


def helm(*arguments: str, values: Mapping[str, Any]) -> str:
    """Run a command of Helm on the chart; return its output. Raises ChartRefused."""
    command = [str(need_helm()), *arguments, "--values", "-"]
    done = subprocess.run(command, input=json.dumps(values), check=False, capture_output=True, text=True, timeout=60)
    if done.returncode != 0:
        raise ChartRefused(done.stdout + done.stderr)
    return done.stdout


def render(values: Mapping[str, Any] = MINIMAL, *, release: str = RELEASE) -> Chart:
    """Render the chart. Raises ChartRefused."""
    return _render(json.dumps(values), release)


def variables(container: Manifest) -> dict[str, str]:
    """Return the environment of a container."""
    return {variable["name"]: variable["value"] for variable in container["env"]}


def secret_files(pod: Manifest) -> dict[str, tuple[str, str]]:
    """Return the secrets of a pod's specification: names and keys by file."""
    (volume,) = [volume for volume in pod["volumes"] if volume["name"] == "secrets"]
    secrets = [source["secret"] for source in volume["projected"]["sources"]]
    return {item["path"]: (secret["name"], item["key"]) for secret in secrets for item in secret["items"]}


def amount_bytes(quantity: str) -> int:
    """Return the bytes of a quantity."""
    number, unit = re.fullmatch(r"(\d+)(Ki|Mi|Gi|Ti)", quantity).groups()  # type: ignore[union-attr]  # it matches
    return int(number) * int(1024 ** (1 + ("Ki", "Mi", "Gi", "Ti").index(unit)))


@cache
def _render(values: str, release: str) -> Chart:
    text = helm("template", release, str(CHART), "--namespace", "kleinkram", values=json.loads(values))
    return Chart(tuple(manifest for manifest in YAML(typ="safe").load_all(text) if manifest))
