"""The Helm chart: valid manifests for several versions of Kubernetes, hardened pods, and sentences for wrong values."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest

import kleinkram
from kleinkram.server.environment import load_settings
from kleinkram.server.settings import Settings
from tests.certificate import make_certificate
from tests.integration.deploy.chart import (
    CHART,
    EXAMPLES,
    MINIMAL,
    SECRETS,
    Chart,
    ChartRefused,
    amount_bytes,
    helm,
    merged,
    render,
    secret_files,
    variables,
)
from tests.integration.deploy.custom_resources import problems_of
from tests.integration.deploy.monitors import load_yaml

pytestmark = pytest.mark.slow
_VERSIONS = ("1.27", "1.30", "1.33", "1.37")
_GROUPS_OF_CUSTOM_RESOURCES = ("monitoring.coreos.com/", "gateway.networking.k8s.io/")
_PROCESS_BYTES = 512 * 1024**2
# Jobs of a worker that may read a recording at once: all of its queues.
_READERS = 6
_PEER = {"namespaceSelector": {"matchLabels": {"kubernetes.io/metadata.name": "proxies"}}}
_BACKUP = {
    "enabled": True,
    "location": "s3://copies/lab",
    "encrypt": True,
    "passphraseSecret": {"name": "backup", "key": "passphrase"},
    "s3": {
        "url": "https://s3.elsewhere.example",
        "accessKeySecret": {"name": "backup", "key": "access"},
        "secretKeySecret": {"name": "backup", "key": "secret"},
        "caSecret": {"name": "backup", "key": "ca.pem"},
    },
}
_WITHOUT_PASSPHRASE = {name: value for name, value in _BACKUP.items() if name != "passphraseSecret"}
_EVERYTHING: Mapping[str, Any] = {
    "imagePullSecrets": [{"name": "registry"}],
    "trustedProxies": ["10.0.0.0/8", "fd00::/8"],
    "settings": {
        "KLEINKRAM_LOCAL_ACCOUNTS": False,
        "KLEINKRAM_SCRUB_HOURS": 0,
        "KLEINKRAM_SLICE_MEMORY_BYTES": 2147483648,
        "KLEINKRAM_LAB_NAME": 'Robotics: "north"',
        "KLEINKRAM_VIEWERS": [{"name": "Lichtblick", "url": "https://lichtblick.lab.example/?ds.url={url}"}],
        "KLEINKRAM_MONITORING_NETWORKS": "10.1.0.0/16",
        "KLEINKRAM_PACKAGE_INDEX": "off",
        "KLEINKRAM_STORE_CAPACITY_BYTES": 10**13,
        "KLEINKRAM_REPORT_TO": "ada@lab.example,bob@lab.example",
        "KLEINKRAM_MAIL_FROM": "kleinkram@lab.example",
        "KLEINKRAM_SMTP_HOST": "mail.lab.example",
        "KLEINKRAM_SMTP_USER": "kleinkram",
    },
    "environment": {"HTTPS_PROXY": "http://proxy.lab.example:3128"},
    "oidcProvidersSecret": {"name": "oidc", "key": "providers.json"},
    "smtpPasswordSecret": {"name": "mail", "key": "password"},
    "database": {"caSecret": {"name": "database", "key": "ca.crt"}},
    "store": {
        "url": "http://rgw.rook-ceph.svc",
        "accessKey": "",
        "accessKeySecret": {"name": "store", "key": "access"},
        "caSecret": {"name": "store", "key": "ca.crt"},
        "service": {"name": "rgw", "port": 80},
    },
    "api": {
        "replicas": 3,
        "podAnnotations": {"team": "robotics"},
        "podLabels": {"team": "robotics"},
        "nodeSelector": {"disk": "fast"},
        "tolerations": [{"key": "lab", "operator": "Exists"}],
        "priorityClassName": "high",
    },
    "worker": {"temporaryVolume": {"type": "ephemeral", "size": "100Gi", "storageClassName": "fast"}},
    "backup": _BACKUP,
    "ingress": {"enabled": True, "className": "nginx", "tlsSecretName": "tls", "bucketAnnotations": {"body": "5g"}},
    "httpRoute": {"enabled": True, "parentRefs": [{"name": "public", "namespace": "gateways"}]},
    "networkPolicy": {
        "enabled": True,
        "apiFrom": [_PEER],
        "egress": [{"to": [{"ipBlock": {"cidr": "10.0.0.0/8"}}], "ports": [{"port": 5432}]}],
    },
    "serviceMonitor": {"enabled": True, "labels": {"release": "prometheus"}},
    "prometheusRule": {"enabled": True, "labels": {"release": "prometheus"}},
}
_CHANGES: Mapping[str, Mapping[str, Any]] = {
    "minimal": {},
    "everything": _EVERYTHING,
    "one of each": {"api": {"replicas": 1, "podDisruptionBudget": False}, "worker": {"replicas": 1}},
    "own account": {"serviceAccount": {"create": False, "name": "own"}, "migrate": {"enabled": False}},
    "digest and IPv6": {"image": {"digest": "sha256:" + "0" * 64}, "listenAddress": "::"},
    "backup to a volume": {"backup": {"enabled": True, "location": "/backups", "persistentVolumeClaim": "copies"}},
    "own affinity": {
        "worker": {
            "affinity": {"podAffinity": {}},
            "temporaryVolume": {"type": "emptyDir", "size": "5Gi"},
            "topologySpreadConstraints": [
                {"maxSkew": 1, "topologyKey": "rack", "whenUnsatisfiable": "DoNotSchedule", "labelSelector": {}}
            ],
        }
    },
}
_VALUES: Mapping[str, Mapping[str, Any]] = {
    **{name: merged(MINIMAL, changes) for name, changes in _CHANGES.items()},
    **{name: load_yaml(path) for name, path in EXAMPLES.items()},
}


@pytest.fixture(params=_VALUES)
def chart(request: pytest.FixtureRequest) -> Chart:
    return render(_VALUES[request.param])


@pytest.fixture
def everything() -> Chart:
    return render(_VALUES["everything"])


@pytest.mark.parametrize("name", _VALUES)
def test_helm_finds_nothing_to_correct(name: str) -> None:
    assert "0 chart(s) failed" in helm("lint", "--strict", str(CHART), values=_VALUES[name])


def test_the_chart_has_the_version_of_the_program() -> None:
    chart = load_yaml(CHART / "Chart.yaml")
    assert chart["appVersion"] == chart["version"] == kleinkram.__version__


@pytest.mark.parametrize("version", _VERSIONS)
def test_kubernetes_accepts_every_manifest(chart: Chart, version: str) -> None:
    for manifest in chart.manifests:
        if not manifest["apiVersion"].startswith(_GROUPS_OF_CUSTOM_RESOURCES):
            kubernetes_validate.validate(copy.deepcopy(manifest), version, strict=True)


def test_a_wrong_field_is_noticed() -> None:
    manifest = copy.deepcopy(render().named("Deployment", "-api"))
    manifest["spec"]["replica"] = 2
    with pytest.raises(kubernetes_validate.ValidationError, match="replica"):
        kubernetes_validate.validate(manifest, _VERSIONS[-1], strict=True)


def test_operators_accept_their_resources(chart: Chart) -> None:
    for manifest in chart.manifests:
        if manifest["apiVersion"].startswith(_GROUPS_OF_CUSTOM_RESOURCES):
            assert problems_of(manifest) == []


def test_a_wrong_field_of_a_custom_resource_is_noticed(everything: Chart) -> None:
    for kind in ("ServiceMonitor", "PrometheusRule", "HTTPRoute"):
        (manifest,) = copy.deepcopy(everything.of_kind(kind))
        manifest["spec"]["surplus"] = {}
        assert problems_of(manifest)


def test_names_are_unique_and_short_enough(chart: Chart) -> None:
    names = [(manifest["kind"], manifest["metadata"]["name"]) for manifest in chart.manifests]
    assert len(names) == len({*names})
    long = render(_VALUES["everything"], release="r" * 53)
    for manifest in long.manifests:
        assert len(manifest["metadata"]["name"]) <= 52  # of a CronJob; others may have 63
        assert all(len(value) <= 63 for value in manifest["metadata"]["labels"].values())


def test_containers_are_restricted(chart: Chart) -> None:
    for pod, container in chart.containers():
        assert pod["automountServiceAccountToken"] is False
        assert pod["enableServiceLinks"] is False
        context = pod["securityContext"]
        assert context["runAsNonRoot"] is True
        assert context["runAsUser"] == context["fsGroup"] == 10001
        assert context["seccompProfile"] == {"type": "RuntimeDefault"}
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        assert {"cpu", "memory"} <= container["resources"]["requests"].keys()
        assert container["resources"]["limits"]["memory"]
        assert not container["image"].endswith((":latest", ":"))
        assert "@sha256:" in container["image"] or container["image"].rpartition(":")[2] == kleinkram.__version__


def test_memory_limits_are_large_enough_for_the_processes_that_read_recordings() -> None:
    limits = {
        pod["containers"][0]["name"]: amount_bytes(pod["containers"][0]["resources"]["limits"]["memory"])
        for pod in (it["spec"] for it in render().pods().values())
    }
    default = {name: field.default for name, field in Settings.model_fields.items()}
    assert limits["api"] >= _PROCESS_BYTES + default["slices_at_once"] * default["slice_memory_bytes"]
    assert limits["worker"] >= _PROCESS_BYTES + _READERS * default["summary_memory_bytes"]


def test_processes_that_run_on_have_probes(chart: Chart) -> None:
    for deployment in chart.of_kind("Deployment"):
        (container,) = deployment["spec"]["template"]["spec"]["containers"]
        ports = {port["name"] for port in container["ports"]}
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            assert container[probe]["httpGet"]["port"] in ports
            assert container[probe]["httpGet"]["path"].startswith("/health/")
        assert container["livenessProbe"]["httpGet"]["path"] == "/health/live"
        assert deployment["spec"]["template"]["spec"]["terminationGracePeriodSeconds"] >= 30


def test_secrets_are_files_that_exist(chart: Chart) -> None:
    for pod, container in chart.containers():
        assert all(variable.keys() == {"name", "value"} for variable in container["env"])
        files = {value for value in variables(container).values() if value.startswith(SECRETS)}
        assert files == {f"{SECRETS}/{name}" for name in secret_files(pod)}
        (mount,) = [mount for mount in container["volumeMounts"] if mount["name"] == "secrets"]
        assert (mount["mountPath"], mount["readOnly"]) == (SECRETS, True)


def test_only_what_needs_it_gets_the_password_of_the_owner_of_the_schema(everything: Chart) -> None:
    holders = {
        name for name, pod in everything.pods().items() if "migration-database-password" in secret_files(pod["spec"])
    }
    assert holders == {"migrate", "backup", "check"}
    holders = {name for name, pod in everything.pods().items() if "backup-passphrase" in secret_files(pod["spec"])}
    assert holders == {"backup"}


def _write_secret(folder: Path, name: str) -> None:
    if name.endswith(".pem"):
        make_certificate(folder, "127.0.0.1")[0].rename(folder / name)
    else:
        (folder / name).write_text("[]" if name == "oidc-providers.json" else "secret")


def test_servers_accept_the_environment(chart: Chart, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for pod, container in chart.containers():
        environment = variables(container)
        for name in secret_files(pod):
            _write_secret(tmp_path, name)
        with monkeypatch.context() as patch:
            for name, value in environment.items():
                patch.setenv(name, value.replace(SECRETS, str(tmp_path)))
            settings = load_settings()
        assert settings.database_url.hosts()[0]["password"] == "secret"
        assert settings.serving_role == "kleinkram_serve"
        assert settings.public_url == "https://kleinkram.lab.example"
        assert (settings.migration_database_url is None) == (container["name"] in {"api", "worker"})


def test_settings_arrive_unchanged(everything: Chart, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (container,) = everything.pods()["worker"]["spec"]["containers"]
    for name in secret_files(everything.pods()["worker"]["spec"]):
        _write_secret(tmp_path, name)
    for name, value in variables(container).items():
        monkeypatch.setenv(name, value.replace(SECRETS, str(tmp_path)))
    settings = load_settings()
    assert settings.local_accounts is False
    assert settings.scrub_hours == 0
    assert settings.store_capacity_bytes == 10**13
    assert settings.slice_memory_bytes == 2**31
    assert settings.lab_name == 'Robotics: "north"'
    assert [viewer.name for viewer in settings.viewers] == ["Lichtblick"]
    assert settings.report_to == ("ada@lab.example", "bob@lab.example")
    assert [str(network) for network in settings.trusted_proxies] == ["10.0.0.0/8", "fd00::/8"]
    assert settings.store_public_url == settings.public_url
    assert variables(container)["PGSSLMODE"] == "verify-full"
    assert variables(container)["HTTPS_PROXY"] == "http://proxy.lab.example:3128"


def _selected(chart: Chart, selector: Mapping[str, str]) -> set[str]:
    """Return the pods that have these labels."""
    return {name for name, pod in chart.pods().items() if selector.items() <= pod["metadata"]["labels"].items()}


def test_selectors_select_the_pods_that_they_mean(everything: Chart) -> None:
    for deployment in everything.of_kind("Deployment"):
        name = deployment["metadata"]["name"].rpartition("-")[2]
        assert _selected(everything, deployment["spec"]["selector"]["matchLabels"]) == {name}
    (budget,) = everything.of_kind("PodDisruptionBudget")
    assert _selected(everything, budget["spec"]["selector"]["matchLabels"]) == {"api"}
    assert _selected(everything, everything.named("Service", "-api")["spec"]["selector"]) == {"api"}
    assert _selected(everything, everything.named("Service", "-processes")["spec"]["selector"]) == {"api", "worker"}
    policies = {
        policy["metadata"]["name"].removeprefix("lab-kleinkram"): _selected(
            everything, policy["spec"]["podSelector"]["matchLabels"]
        )
        for policy in everything.of_kind("NetworkPolicy")
    }
    assert policies == {"": {*everything.pods()}, "-api": {"api"}, "-metrics": {"api", "worker"}}


def test_two_releases_select_no_pods_of_each_other() -> None:
    ours, theirs = render(_VALUES["everything"]), render(_VALUES["everything"], release="other")
    for deployment in ours.of_kind("Deployment"):
        assert _selected(theirs, deployment["spec"]["selector"]["matchLabels"]) == set()


def test_ports_are_those_of_containers(everything: Chart) -> None:
    for name in ("api", "worker"):
        (container,) = everything.pods()[name]["spec"]["containers"]
        ports = {port["name"]: port["containerPort"] for port in container["ports"]}
        assert str(ports["metrics"]) == variables(container)["KLEINKRAM_METRICS_PORT"]
        if name == "api":
            assert str(ports["http"]) == container["command"][container["command"].index("--port") + 1]
            assert everything.named("Service", "-api")["spec"]["ports"][0]["targetPort"] in ports
    policy = everything.named("NetworkPolicy", "-metrics")
    assert policy["spec"]["ingress"][0]["ports"][0]["port"] == ports["metrics"]
    assert policy["spec"]["ingress"][0]["from"]
    (monitor,) = everything.of_kind("ServiceMonitor")
    service = everything.named("Service", "-processes")
    assert monitor["spec"]["selector"]["matchLabels"].items() <= service["metadata"]["labels"].items()
    assert monitor["spec"]["endpoints"][0]["port"] == service["spec"]["ports"][0]["name"]


def test_the_bucket_is_published_at_the_address_of_the_api(everything: Chart) -> None:
    api = everything.named("Service", "-api")["metadata"]["name"]
    paths = {
        rule["path"]: rule["backend"]["service"]["name"]
        for ingress in everything.of_kind("Ingress")
        for rule in ingress["spec"]["rules"][0]["http"]["paths"]
    }
    assert paths == {"/": api, "/kleinkram": "rgw"}
    assert "annotations" not in everything.named("Ingress", "lab-kleinkram")["metadata"]
    assert everything.named("Ingress", "-bucket")["metadata"]["annotations"] == {"body": "5g"}
    (route,) = everything.of_kind("HTTPRoute")
    assert route["spec"]["hostnames"] == ["kleinkram.lab.example"]
    paths = {rule["matches"][0]["path"]["value"]: rule["backendRefs"][0]["name"] for rule in route["spec"]["rules"]}
    assert paths == {"/": api, "/kleinkram": "rgw"}


def test_the_first_migration_needs_nothing_of_the_release() -> None:
    chart = render()
    job, account = chart.named("Job", "-migrate"), chart.named("ServiceAccount", "-migrate")
    hooks = [manifest["metadata"]["annotations"] for manifest in (account, job)]
    assert [hook["helm.sh/hook"] for hook in hooks] == ["pre-install,pre-upgrade"] * 2
    assert int(hooks[0]["helm.sh/hook-weight"]) < int(hooks[1]["helm.sh/hook-weight"])
    pod = job["spec"]["template"]["spec"]
    assert pod["serviceAccountName"] == account["metadata"]["name"]
    assert {volume["name"] for volume in pod["volumes"]} == {"tmp", "secrets"}
    own = render(_VALUES["own account"])
    assert not own.of_kind("Job")
    assert not own.of_kind("ServiceAccount")
    assert own.pods()["api"]["spec"]["serviceAccountName"] == "own"


def test_an_upgrade_stops_no_process_before_another_is_ready() -> None:
    chart = render()
    strategy = chart.named("Deployment", "-api")["spec"]["strategy"]["rollingUpdate"]
    assert strategy == {"maxSurge": 1, "maxUnavailable": 0}
    (budget,) = chart.of_kind("PodDisruptionBudget")
    assert budget["spec"]["maxUnavailable"] == 1
    assert chart.named("Deployment", "-api")["spec"]["replicas"] == 2


def test_a_backup_is_verified_before_old_ones_are_deleted(everything: Chart) -> None:
    spec = everything.pods()["backup"]["spec"]
    commands = [container["command"][:3] for container in [*spec["initContainers"], *spec["containers"]]]
    assert commands == [["klein", "backup", verb] for verb in ("create", "verify", "prune")]
    assert spec["initContainers"][0]["command"][3:] == ["s3://copies/lab", "--encrypt"]
    assert spec["containers"][0]["command"][3:] == ["s3://copies/lab", "--keep", "60"]


def test_alerts_are_those_of_the_file(everything: Chart) -> None:
    (rule,) = everything.of_kind("PrometheusRule")
    assert rule["spec"]["groups"] == load_yaml(CHART / "rules.yml")["groups"]


def test_pods_may_connect_only_where_the_policy_says(everything: Chart) -> None:
    policy = everything.named("NetworkPolicy", "lab-kleinkram")["spec"]
    assert policy["policyTypes"] == ["Ingress", "Egress"]
    assert "ingress" not in policy
    assert [sorted(port["port"] for port in rule["ports"]) for rule in policy["egress"]] == [[53, 53], [5432]]
    assert everything.named("NetworkPolicy", "-api")["spec"]["ingress"][0]["from"] == [_PEER]


_WRONG: tuple[tuple[Mapping[str, Any], str], ...] = (
    ({"publicUrl": None}, "missing property 'publicUrl'"),
    ({"image": {"repository": None}}, "missing property 'repository'"),
    ({"replicas": 3}, "additional properties 'replicas' not allowed"),
    ({"api": {"replica": 3}}, "additional properties 'replica' not allowed"),
    ({"api": {"replicas": 0}}, "minimum: got 0, want 1"),
    ({"api": {"replicas": "2"}}, "got string, want integer"),
    ({"settings": {"KLEINKRAM_TRASHDAYS": 1}}, "additional properties 'KLEINKRAM_TRASHDAYS' not allowed"),
    ({"settings": {"KLEINKRAM_TRASH_DAYS": -1}}, "minimum: got -1, want 0"),
    ({"settings": {"KLEINKRAM_REPORT_TO": ["ada@lab.example"]}}, "got array, want string"),
    ({"settings": {"KLEINKRAM_S3_SECRET_KEY": "x"}}, "additional properties 'KLEINKRAM_S3_SECRET_KEY' not allowed"),
    ({"database": {"url": "postgresql://serve:secret@db/kleinkram"}}, "/database/url"),
    ({"database": {"url": "postgresql://serve@db/kleinkram?password=secret"}}, "must not contain a password"),
    ({"database": {"url": "postgresql://kleinkram_migrate@db/kleinkram"}}, "name the same role"),
    ({"database": {"passwordSecret": {"key": None}}}, "missing property 'key'"),
    ({"image": {"tag": "latest"}}, "image.tag is latest, which changes without an upgrade"),
    ({"environment": {"KLEINKRAM_TRASH_DAYS": "1"}}, "move it to settings"),
    ({"store": {"accessKey": ""}}, "The store needs an access key"),
    ({"store": {"accessKeySecret": {"name": "a", "key": "b"}}}, "both set"),
    (
        {"store": {"url": "http://seaweedfs-s3:8333"}},
        "Clients outside the cluster cannot reach the store at seaweedfs-s3",
    ),
    ({"store": {"url": "http://rgw.rook-ceph.svc"}}, "cannot reach the store at rgw.rook-ceph.svc"),
    ({"store": {"service": {"name": "rgw", "port": 80}}}, "enable one of them"),
    ({"httpRoute": {"enabled": True}}, "httpRoute.parentRefs is empty"),
    ({"backup": {"enabled": True}}, "backup.location is empty"),
    ({"backup": {"enabled": True, "location": "/mnt"}}, "/backup/location"),
    ({"backup": {"enabled": True, "location": "/backups"}}, "set backup.persistentVolumeClaim"),
    ({"backup": {"enabled": True, "location": "s3://copies"}}, "set backup.s3"),
    ({"backup": _WITHOUT_PASSPHRASE}, "backup.encrypt needs backup.passphraseSecret"),
    ({"worker": {"resources": {"limits": {"memory": None}}}}, "missing property 'memory'"),
)


@pytest.mark.parametrize(("changes", "sentence"), _WRONG, ids=[sentence for _, sentence in _WRONG])
def test_a_wrong_value_is_refused_with_a_sentence(changes: Mapping[str, Any], sentence: str) -> None:
    with pytest.raises(ChartRefused) as refused:
        render(merged(MINIMAL, changes))
    assert sentence in str(refused.value)


def test_the_notes_say_what_to_do_next() -> None:
    command = ("install", "lab", str(CHART), "--dry-run=client", "--namespace", "kleinkram")
    notes = helm(*command, values=merged(MINIMAL, {"settings": {"KLEINKRAM_DATABASE_CONNECTIONS": 10}}))
    # Three API processes and three workers, with 12 and 23 connections.
    assert "PostgreSQL needs 105 connections" in notes
    assert "helm test lab --namespace kleinkram" in notes
    assert "app.kubernetes.io/name=kleinkram,app.kubernetes.io/instance=lab,app.kubernetes.io/component=api" in notes
    assert notes.count("WARNING") == 3


def test_what_is_off_is_not_rendered() -> None:
    names = {f"{it['kind']}/{it['metadata']['name']}" for it in render().manifests}
    assert names == {
        "ServiceAccount/lab-kleinkram",
        "ServiceAccount/lab-kleinkram-migrate",
        "Job/lab-kleinkram-migrate",
        "Deployment/lab-kleinkram-api",
        "Service/lab-kleinkram-api",
        "PodDisruptionBudget/lab-kleinkram-api",
        "Deployment/lab-kleinkram-worker",
        "Service/lab-kleinkram-processes",
        "Pod/lab-kleinkram-check",
    }


def test_the_custom_resources_of_the_matrix_are_all_that_the_chart_has(everything: Chart) -> None:
    kinds: set[str] = {
        manifest["kind"]
        for manifest in everything.manifests
        if manifest["apiVersion"].startswith(_GROUPS_OF_CUSTOM_RESOURCES)
    }
    assert kinds == {"ServiceMonitor", "PrometheusRule", "HTTPRoute"}
