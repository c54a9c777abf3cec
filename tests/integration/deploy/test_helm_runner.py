"""The runner of the Helm chart: what it may do, and that it is what administrators apply without the chart."""

import copy
import ipaddress
from collections.abc import Mapping
from typing import Any

import kubernetes_validate
import pytest

from kleinkram.cli.runner import app
from kleinkram.runner.executors.kubernetes.manifests import MANAGER, MANAGER_LABEL, NETWORK_LABEL
from tests.integration.deploy.chart import CHART, MINIMAL, Chart, ChartRefused, helm, merged, render
from tests.integration.kubernetes.manifests import manifests, rules

pytestmark = pytest.mark.slow
_VERSIONS = ("1.27", "1.30", "1.33", "1.37")
_API_EGRESS = [{"to": [{"ipBlock": {"cidr": "10.1.0.10/32"}}], "ports": [{"port": 443, "protocol": "TCP"}]}]
_RUNNER: Mapping[str, Any] = {
    "enabled": True,
    "namespace": "runs",
    "image": {"repository": "registry.lab.example/kleinkram/runner"},
    "tokenSecret": {"name": "runner", "key": "token"},
    "labels": ["gpu"],
    "imagePullSecrets": ["registry"],
    "registrySecret": "registry-login",
    "defaultImage": "registry.lab.example/kleinkram/action-python:0.1.0",
    "allowMetadataAccess": True,
    "apiEgress": _API_EGRESS,
    "gpus": 2,
    "arguments": ["--gpu-toleration", "nvidia.com/gpu"],
    "volume": {"storageClassName": "fast"},
    "nodeSelector": {"disk": "fast"},
    "tolerations": [{"key": "lab", "operator": "Exists"}],
}


def _values(**changes: Any) -> dict[str, Any]:
    return merged(MINIMAL, {"runner": {"kubernetes": merged(_RUNNER, changes)}})


@pytest.fixture(scope="module")
def chart() -> Chart:
    return render(_values())


@pytest.mark.parametrize("version", _VERSIONS)
def test_kubernetes_accepts_the_manifests_of_the_runner(chart: Chart, version: str) -> None:
    for manifest in [*chart.manifests, *(it for kind in _KINDS for it in manifests(kind))]:
        kubernetes_validate.validate(copy.deepcopy(manifest), version, strict=True)


_KINDS = ("ServiceAccount", "Secret", "Role", "RoleBinding", "NetworkPolicy")


def test_helm_finds_nothing_to_correct_in_the_runner() -> None:
    assert "0 chart(s) failed" in helm("lint", "--strict", str(CHART), values=_values())


def test_there_is_no_runner_by_default() -> None:
    assert not render().of_kind("Role")


def test_the_role_and_the_policies_are_those_without_the_chart(chart: Chart) -> None:
    (role,) = chart.of_kind("Role")
    assert role["rules"] == rules()
    ours = {it["metadata"]["name"].rpartition("-")[2]: it["spec"] for it in chart.of_kind("NetworkPolicy")}
    plain = {it["metadata"]["name"].rpartition("-")[2]: it["spec"] for it in manifests("NetworkPolicy")}
    assert ours["api"].pop("egress")[1:] == _API_EGRESS
    plain["api"].pop("egress")
    assert ours == plain
    assert {name: spec["podSelector"]["matchLabels"] for name, spec in ours.items()} == {
        "runs": {MANAGER_LABEL: MANAGER},
        **{name: {NETWORK_LABEL: name} for name in ("none", "api", "open")},
    }


def test_the_runner_has_rights_in_the_namespace_of_runs_alone(chart: Chart) -> None:
    for kind in ("Role", "RoleBinding", "NetworkPolicy"):
        assert {it["metadata"]["namespace"] for it in chart.of_kind(kind)} == {"runs"}
    assert not [it for it in chart.manifests if it["kind"].startswith("Cluster")]
    (binding,) = chart.of_kind("RoleBinding")
    pod = chart.pods()["runner"]["spec"]
    assert binding["subjects"] == [
        {"kind": "ServiceAccount", "name": pod["serviceAccountName"], "namespace": "kleinkram"}
    ]
    others = [it["spec"] for name, it in chart.pods().items() if name != "runner"]
    assert not any(it["automountServiceAccountToken"] for it in others)


def test_the_runner_asks_private_registries_with_a_secret(chart: Chart) -> None:
    pod = chart.pods()["runner"]["spec"]
    (container,) = pod["containers"]
    (folder,) = [it["value"] for it in container["env"] if it["name"] == "DOCKER_CONFIG"]
    (mount,) = [it for it in container["volumeMounts"] if it["mountPath"] == folder]
    (volume,) = [it for it in pod["volumes"] if it["name"] == mount["name"]]
    assert volume["secret"]["secretName"] == "registry-login"
    assert volume["secret"]["items"] == [{"key": ".dockerconfigjson", "path": "config.json"}]
    plain = render(_values(registrySecret="", allowMetadataAccess=False)).pods()["runner"]["spec"]
    assert [it["name"] for it in plain["volumes"]] == ["state", "tmp"]
    assert "--allow-metadata-access" not in plain["containers"][0]["command"]
    assert "--allow-metadata-access" in container["command"]


def test_policies_keep_pods_from_the_metadata_services_of_clouds() -> None:
    (policy,) = [it for it in manifests("NetworkPolicy") if it["metadata"]["name"] == "kleinkram-runs-open"]
    names, others = policy["spec"]["egress"]
    blocks = [peer["ipBlock"] for peer in others["to"] if "ipBlock" in peer]
    excepted = [ipaddress.ip_network(it) for block in blocks for it in block["except"]]
    for address in ("169.254.169.254", "168.63.129.16", "100.100.100.200", "fd00:ec2::254", "fd20:ce::254"):
        assert any(ipaddress.ip_address(address) in it for it in excepted), address
    assert {port["port"] for port in names["ports"]} == {53}


def test_the_command_line_accepts_the_options_of_the_runner(chart: Chart) -> None:
    (container,) = chart.pods()["runner"]["spec"]["containers"]
    command = container["command"]
    assert command[:3] == ["klein", "runner", "kubernetes"]
    known = {name for parameter in _parameters() for name in parameter}
    assert {word for word in command if word.startswith("--")} <= known
    assert command[command.index("--pod-image") + 1] == container["image"]
    assert container["securityContext"]["readOnlyRootFilesystem"] is True
    assert [it["valueFrom"]["secretKeyRef"]["name"] for it in container["env"] if "valueFrom" in it] == ["runner"]


def _parameters() -> list[list[str]]:
    import typer

    group = typer.main.get_command(app)
    command = group.commands["kubernetes"]  # type: ignore[attr-defined]  # it is a group
    return [parameter.opts for parameter in command.params]


_WRONG: tuple[tuple[Mapping[str, Any], str], ...] = (
    ({"namespace": ""}, "a namespace for runs alone"),
    ({"namespace": "kleinkram"}, "can read its Secrets"),
    ({"image": {"repository": ""}}, "runner.kubernetes.image.repository is empty"),
    ({"image": {"tag": "latest"}}, "changes without an upgrade"),
    ({"tokenSecret": None}, "runner.kubernetes.tokenSecret is not set"),
    ({"memory": "lots"}, "/runner/kubernetes/memory"),
)


@pytest.mark.parametrize(("changes", "sentence"), _WRONG, ids=[sentence for _, sentence in _WRONG])
def test_wrong_values_of_the_runner_are_refused(changes: Mapping[str, Any], sentence: str) -> None:
    with pytest.raises(ChartRefused, match=sentence):
        render(_values(**changes))
