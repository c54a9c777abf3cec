"""A private Kubernetes of one node: the API server, its controllers, containerd and a kubelet, in namespaces.

It is a machine of its own as far as the kernel allows: its network, processes and mounts are not this machine's, and
end with it. It reaches this machine by one address, and nothing else.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.kubernetes_access import Api, Body, write_certificates
from tests.kubernetes_build import KubernetesBuild
from tests.requirements import path_of

# What it needs of this machine, besides what is built.
PROGRAMS = ("containerd", "runc", "catatonit", "dnsmasq", "ip", "iptables", "setpriv")
NODE, STORAGE_CLASS, PROVISIONER = "node-1", "of-the-tests", "kleinkram.test/folders"
_SERVICES, _FIRST_SERVICE, _PODS = "10.96.0.0/16", "10.96.0.1", "10.97.0.0/24"
_START_S = 120.0
_numbers = itertools.count(0)
# The kubelet insists on them. It is shown files with these values, for the machine's own stay as they are.
_KERNEL_SETTINGS = {
    "vm/overcommit_memory": 1,
    "vm/panic_on_oom": 0,
    "kernel/panic": 10,
    "kernel/panic_on_oops": 1,
    "kernel/keys/root_maxkeys": 1_000_000,
    "kernel/keys/root_maxbytes": 25_000_000,
}
_USERS = {
    "admin": "system:masters",
    "system:kube-controller-manager": "",
    "system:kube-scheduler": "",
    "system:kube-proxy": "",
    f"system:node:{NODE}": "system:nodes",
}
_CONTAINERD = """\
version = 2
root = "{folder}/containerd"
state = "{folder}/run/containerd"
disabled_plugins = ["io.containerd.snapshotter.v1.btrfs", "io.containerd.snapshotter.v1.zfs"]
[grpc]
address = "{folder}/run/containerd.sock"
[plugins."io.containerd.grpc.v1.cri"]
sandbox_image = "{pause}"
restrict_oom_score_adj = true
disable_apparmor = true
[plugins."io.containerd.grpc.v1.cri".cni]
bin_dir = "{plugins}"
conf_dir = "{folder}/cni"
"""


class KubernetesCluster:
    """The services of one cluster. `address` is where its pods find this machine.

    `registry` is where nodes pull images: a host and a port, by which the registry is also known on this machine.
    """

    def __init__(self, folder: Path, build: KubernetesBuild, *, registry: str, pause: str) -> None:
        self.folder = folder
        self._build = build
        self._registry = registry
        self._pause = pause
        self._services: dict[str, subprocess.Popen[bytes]] = {}
        self._link = f"kk{os.getpid()}-{next(_numbers)}"
        self._cgroup = f"kleinkram-{os.getpid()}-{folder.name}"
        self.address = self._node_address = ""
        self._tokens = {name: os.urandom(16).hex() for name in _USERS}
        self._admin: Api | None = None

    # -- start and end -------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start all services, and wait until the node takes pods."""
        self._make_machine()
        self._write_files()
        self._start_once("etcd", *self._etcd())
        self.start_api_server()
        self.start_controllers()
        self._start_once("dnsmasq", *self._name_server())
        self.start_node()
        self._add_storage_class()

    def start_api_server(self) -> None:
        """Start the API server, and wait until it answers."""
        self._start_once("kube-apiserver", *self._api_server())
        wait_for(lambda: self.api.is_ready(), "the API server does not answer")

    def start_controllers(self) -> None:
        """Start the controllers and the scheduler."""
        for name, options in (("kube-controller-manager", self._controllers()), ("kube-scheduler", self._scheduler())):
            self._start_once(name, *options)

    def start_node(self) -> None:
        """Start what runs pods, and wait until the cluster knows."""
        self._start_once("containerd", "--config", str(self.folder / "containerd.toml"))
        wait_for((self.folder / "run" / "containerd.sock").exists, "containerd does not answer")
        self._start_once("kubelet", *self._kubelet())
        self._start_once("kube-proxy", f"--config={self.folder}/proxy.json")
        wait_for(lambda: self.is_node_ready, "the node does not get ready")

    def kill(self, program: str) -> None:
        """Kill a service with SIGKILL. The pods of a killed node go on."""
        process = self._services.pop(program)
        process.kill()
        process.wait()

    def repair(self) -> None:
        """Start what was killed, and wait until the node takes pods."""
        self._start_once("etcd", *self._etcd())
        for name, process in [*self._services.items()]:
            if process.poll() is not None:  # without etcd, some end by themselves
                del self._services[name]
        self.start_api_server()
        self.start_controllers()
        self.start_node()

    def close(self) -> None:
        """End everything, pods included."""
        for process in reversed(self._services.values()):
            process.kill()
            process.wait()
        self._services.clear()
        subprocess.run([_path("ip"), "link", "delete", self._link], check=False, capture_output=True)
        for hierarchy in Path("/sys/fs/cgroup").iterdir():
            root = hierarchy / self._cgroup
            for folder, _, _ in [*os.walk(root, topdown=False)]:
                with contextlib.suppress(OSError):
                    Path(folder).rmdir()

    # -- what tests ask ------------------------------------------------------------------------------------------------

    @property
    def api(self) -> Api:
        """The API, as an administrator."""
        if self._admin is None:
            self._admin = Api(self.url, self.folder / "ca.pem", self._tokens["admin"])
        return self._admin

    @property
    def url(self) -> str:
        """Where the API server answers."""
        return f"https://{self._node_address}:6443"

    @property
    def is_node_ready(self) -> bool:
        """Whether the node takes pods."""
        node = self.api.find(f"/api/v1/nodes/{NODE}") or {}
        conditions = node.get("status", {}).get("conditions", [])
        return any(it["type"] == "Ready" and it["status"] == "True" for it in conditions)

    def kubectl(self, *words: str, namespace: str = "default") -> str:
        """Run kubectl as an administrator."""
        command = [str(self._build.program("kubectl")), f"--kubeconfig={self.folder}/admin.json"]
        done = subprocess.run(
            [*command, f"--namespace={namespace}", *words], capture_output=True, text=True, check=False, timeout=120
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def write_kubeconfig(self, path: Path, token: str, namespace: str = "default") -> Path:
        """Write the file by which a client finds the cluster, with a token."""
        authority = str(self.folder / "ca.pem")
        content = {
            "apiVersion": "v1",
            "kind": "Config",
            "current-context": "tests",
            "contexts": [{"name": "tests", "context": {"cluster": "tests", "user": "it", "namespace": namespace}}],
            "clusters": [{"name": "tests", "cluster": {"server": self.url, "certificate-authority": authority}}],
            "users": [{"name": "it", "user": {"token": token}}],
        }
        path.touch(0o600)
        path.write_text(json.dumps(content))
        return path

    # -- the machine ---------------------------------------------------------------------------------------------------

    def _make_machine(self) -> None:
        """Make the namespaces, held by a first process, and a cable between them and this machine."""
        for name in ("run", "log", "lib", "cni", "etcd", "kernel"):
            (self.folder / name).mkdir()
        mounts = [f"mount --bind {self.folder}/log /var/log", f"mount --bind {self.folder}/lib /var/lib"]
        mounts.append(f"mount --bind {self.folder}/run /run")
        for name, value in _KERNEL_SETTINGS.items():
            file = self.folder / "kernel" / name.replace("/", "-")
            file.write_text(f"{value}\n")
            mounts.append(f"mount --bind {file} /proc/sys/{name}")
        script = " && ".join([*mounts, f"touch {self.folder}/ready", f"exec {_path('catatonit')} -- sleep infinity"])
        namespaces = ("--net", "--mount", "--uts", "--ipc", "--pid", "--fork", "--kill-child=KILL", "--mount-proc")
        self._start("machine", "unshare", *namespaces, "sh", "-c", script)
        wait_for((self.folder / "ready").exists, "its mounts were not made")
        self._make_cable()

    def _make_cable(self) -> None:
        pid = self._machine_pid()
        inside = f"{self._link}n"
        _run("ip", "link", "add", self._link, "type", "veth", "peer", "name", inside, "netns", str(pid))
        # By the number that the kernel gave it: no other that is there has the same.
        number = int(Path(f"/sys/class/net/{self._link}/ifindex").read_text())
        network = f"10.{number // 256 % 50 + 100}.{number % 256}"
        self.address, self._node_address = f"{network}.1", f"{network}.2"
        _run("ip", "address", "add", f"{self.address}/24", "dev", self._link)
        _run("ip", "link", "set", self._link, "up")
        for words in (
            ("ip", "link", "set", "lo", "up"),
            ("ip", "link", "set", inside, "name", "eth0"),
            ("ip", "address", "add", f"{self._node_address}/24", "dev", "eth0"),
            ("ip", "link", "set", "eth0", "up"),
            ("sysctl", "-q", "net.ipv4.ip_forward=1", "net.ipv4.conf.all.route_localnet=1"),
            *self._forwarded_registry(),
        ):
            _run(*self._enter(*words))

    def _forwarded_registry(self) -> list[tuple[str, ...]]:
        """Return commands by which nodes find the registry under the name that it has on this machine."""
        host, _, port = self._registry.rpartition(":")
        registry = ("--destination", host, "--protocol", "tcp", "--dport", port)
        table = ("iptables", "--wait", "--table", "nat", "--append")
        return [
            (*table, "OUTPUT", *registry, "--jump", "DNAT", "--to-destination", f"{self.address}:{port}"),
            (*table, "POSTROUTING", "--destination", self.address, "--jump", "MASQUERADE"),
        ]

    def _machine_pid(self) -> int:
        (pid,) = (
            Path(f"/proc/{self._services['machine'].pid}/task/{self._services['machine'].pid}/children")
            .read_text()
            .split()
        )
        return int(pid)

    def _enter(self, *command: str) -> list[str]:
        """Return a command that does this inside, and ends with what it was started by."""
        namespaces = ("--net", "--mount", "--uts", "--ipc", "--pid")
        inside = [_path("setpriv"), "--pdeathsig=KILL", *command]
        return [_path("nsenter"), f"--target={self._machine_pid()}", *namespaces, "--", *inside]

    def _start_once(self, name: str, *options: str) -> None:
        if name in self._services:
            return
        built = self._build.program(name)
        program = str(built) if built.exists() else _path(name)
        self._start(name, *self._enter(program, *options))

    def _start(self, name: str, program: str, *words: str) -> None:
        with (self.folder / f"{name}.out").open("ab") as log:
            self._services[name] = subprocess.Popen(
                [_path("setpriv"), "--pdeathsig=KILL", _path(program), *words],  # however the tests end
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin", "HOME": str(self.folder)},
                cwd=self.folder,
            )

    # -- the services --------------------------------------------------------------------------------------------------

    def _etcd(self) -> list[str]:
        return [
            f"--data-dir={self.folder}/etcd",
            "--listen-client-urls=http://127.0.0.1:2379",
            "--advertise-client-urls=http://127.0.0.1:2379",
            "--listen-peer-urls=http://127.0.0.1:2380",
            "--unsafe-no-fsync",
        ]

    def _api_server(self) -> list[str]:
        folder = self.folder
        return [
            "--etcd-servers=http://127.0.0.1:2379",
            f"--bind-address={self._node_address}",
            f"--advertise-address={self._node_address}",
            "--secure-port=6443",
            f"--service-cluster-ip-range={_SERVICES}",
            f"--tls-cert-file={folder}/server.pem",
            f"--tls-private-key-file={folder}/server.key",
            f"--client-ca-file={folder}/ca.pem",
            f"--kubelet-client-certificate={folder}/client.pem",
            f"--kubelet-client-key={folder}/client.key",
            "--kubelet-preferred-address-types=InternalIP",
            f"--service-account-key-file={folder}/accounts.pub",
            f"--service-account-signing-key-file={folder}/accounts.key",
            "--service-account-issuer=https://kubernetes.default.svc",
            f"--token-auth-file={folder}/tokens.csv",
            "--authorization-mode=Node,RBAC",
            "--enable-admission-plugins=NodeRestriction,ResourceQuota,LimitRanger",
            "--feature-gates=TTLAfterFinished=true",
            "--anonymous-auth=false",
        ]

    def _controllers(self) -> list[str]:
        folder = self.folder
        return [
            f"--kubeconfig={folder}/kube-controller-manager.json",
            "--use-service-account-credentials=true",
            f"--service-account-private-key-file={folder}/accounts.key",
            f"--root-ca-file={folder}/ca.pem",
            "--leader-elect=false",
            "--feature-gates=TTLAfterFinished=true",
            "--bind-address=127.0.0.1",
            "--port=0",
            f"--cert-dir={folder}/run",
        ]

    def _scheduler(self) -> list[str]:
        return [
            f"--kubeconfig={self.folder}/kube-scheduler.json",
            "--leader-elect=false",
            "--bind-address=127.0.0.1",
            "--port=0",
            f"--cert-dir={self.folder}/run",
        ]

    def _kubelet(self) -> list[str]:
        return [
            f"--config={self.folder}/kubelet.json",
            f"--kubeconfig={self.folder}/kubelet.json.token",
            f"--root-dir={self.folder}/kubelet",
            f"--cert-dir={self.folder}/run",
            f"--hostname-override={NODE}",
            f"--node-ip={self._node_address}",
            "--container-runtime=remote",
            f"--container-runtime-endpoint=unix://{self.folder}/run/containerd.sock",
        ]

    def _name_server(self) -> list[str]:
        return [
            "--keep-in-foreground",
            "--conf-file=/dev/null",
            "--no-resolv",
            "--no-hosts",
            "--bind-interfaces",
            f"--listen-address={self._node_address}",
            "--pid-file",
            "--user=root",
            "--local=/cluster.local/",
            f"--address=/kubernetes.default.svc.cluster.local/{_FIRST_SERVICE}",
        ]

    def _write_files(self) -> None:
        folder = self.folder
        write_certificates(folder, (self._node_address, _FIRST_SERVICE))
        rows = [f'{self._tokens[name]},{name},{name},"{group}"\n' for name, group in _USERS.items()]
        (folder / "tokens.csv").write_text("".join(rows))
        for name in ("kube-controller-manager", "kube-scheduler", "kube-proxy"):
            self.write_kubeconfig(folder / f"{name}.json", self._tokens[f"system:{name}"])
        self.write_kubeconfig(folder / "admin.json", self._tokens["admin"])
        self.write_kubeconfig(folder / "kubelet.json.token", self._tokens[f"system:node:{NODE}"])
        (folder / "containerd.toml").write_text(
            _CONTAINERD.format(
                folder=folder,
                pause=self._pause,
                plugins=self._build.plugins,
            )
        )
        network = {
            "cniVersion": "0.4.0",
            "name": "pods",
            "plugins": [
                {
                    "type": "bridge",
                    "bridge": "pods",
                    "isGateway": True,
                    "ipMasq": True,
                    "hairpinMode": True,
                    "ipam": {"type": "host-local", "ranges": [[{"subnet": _PODS}]], "routes": [{"dst": "0.0.0.0/0"}]},
                }
            ],
        }
        (folder / "cni" / "pods.conflist").write_text(json.dumps(network))
        (folder / "kubelet.json").write_text(json.dumps(self._kubelet_configuration()))
        proxy = {
            "apiVersion": "kubeproxy.config.k8s.io/v1alpha1",
            "kind": "KubeProxyConfiguration",
            "clientConnection": {"kubeconfig": f"{folder}/kube-proxy.json"},
            "hostnameOverride": NODE,
            "mode": "iptables",
            "clusterCIDR": _PODS,
            # The machine's own settings stay as they are.
            "conntrack": {"maxPerCore": 0, "min": 0, "tcpEstablishedTimeout": "0s", "tcpCloseWaitTimeout": "0s"},
            "healthzBindAddress": "127.0.0.1:10256",
            "metricsBindAddress": "127.0.0.1:10249",
        }
        (folder / "proxy.json").write_text(json.dumps(proxy))

    def _kubelet_configuration(self) -> Body:
        for hierarchy in Path("/sys/fs/cgroup").iterdir():
            if hierarchy.is_dir() and not hierarchy.is_symlink():
                self._make_cgroup(hierarchy)
        return {
            "apiVersion": "kubelet.config.k8s.io/v1beta1",
            "kind": "KubeletConfiguration",
            "authentication": {
                "anonymous": {"enabled": False},
                "webhook": {"enabled": False},
                "x509": {"clientCAFile": f"{self.folder}/ca.pem"},
            },
            "authorization": {"mode": "AlwaysAllow"},
            "cgroupDriver": "cgroupfs",
            "cgroupRoot": f"/{self._cgroup}",
            "enforceNodeAllocatable": [],
            "protectKernelDefaults": True,
            "clusterDNS": [self._node_address],
            "clusterDomain": "cluster.local",
            "resolvConf": "",
            "failSwapOn": False,
            "volumePluginDir": f"{self.folder}/lib/plugins",
            # The disk of this machine may be as full as it likes.
            "evictionHard": {"memory.available": "100Mi", "nodefs.available": "1%", "imagefs.available": "1%"},
            "imageGCHighThresholdPercent": 100,
            "imageGCLowThresholdPercent": 99,
            "healthzBindAddress": "127.0.0.1",
            "podPidsLimit": 512,
            # What is in a volume is measured so often, in place of each minute.
            "volumeStatsAggPeriod": "5s",
        }

    def _make_cgroup(self, hierarchy: Path) -> None:
        root = hierarchy / self._cgroup
        root.mkdir(exist_ok=True)
        for name in ("cpuset.cpus", "cpuset.mems"):
            if (root / name).exists():
                (root / name).write_text((hierarchy / name).read_text())

    def _add_storage_class(self) -> None:
        body = {
            "apiVersion": "storage.k8s.io/v1",
            "kind": "StorageClass",
            "metadata": {
                "name": STORAGE_CLASS,
                "annotations": {"storageclass.kubernetes.io/is-default-class": "true"},
            },
            "provisioner": PROVISIONER,
            "reclaimPolicy": "Delete",
            "volumeBindingMode": "WaitForFirstConsumer",
        }
        self.api.send("POST", "/apis/storage.k8s.io/v1/storageclasses", body)


def wait_for(condition: Callable[[], object], what: str, timeout_s: float = _START_S) -> None:
    """Wait until a condition holds, or fail by saying what does not."""
    until = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until, what
        time.sleep(0.05)


def _path(program: str) -> str:
    if "/" in program:
        return program
    path = path_of(program)
    assert path is not None, program
    return path


def _run(program: str, *words: str) -> None:
    subprocess.run([_path(program), *words], check=True, capture_output=True, timeout=60)


@contextlib.contextmanager
def kubernetes_cluster(build: KubernetesBuild, *, registry: str, pause: str) -> Iterator[KubernetesCluster]:
    """Run a cluster in a folder of its own. Its path is short: those of sockets are limited."""
    folder = Path(tempfile.mkdtemp(prefix="kube-"))
    cluster = KubernetesCluster(folder, build, registry=registry, pause=pause)
    try:
        cluster.start()
        yield cluster
    finally:
        cluster.close()
        shutil.rmtree(folder, ignore_errors=True)
