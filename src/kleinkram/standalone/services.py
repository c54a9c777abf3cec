"""The services of `klein up`: their commands, environments and ports, and their processes with restarts and logs."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from kleinkram.standalone.address import METRICS_PORTS, Listening, assign_ports, check_listening, public_urls
from kleinkram.standalone.data_dir import DataDir, Secrets, ensure_owner_token, load_ports, load_secrets, write_private
from kleinkram.standalone.http_client import bundle_with
from kleinkram.standalone.object_store import BUCKET, PORT_NAMES, StoreAccess, StoreFolder, locate_weed
from kleinkram.standalone.postgres import ADMIN, MIGRATE, SERVE, PostgresCluster, locate_postgres, role_url
from kleinkram.standalone.processes import ChildCommand, kill_group, stop

SERVER = (sys.executable, "-m", "kleinkram.server")
# One machine with few users: memory matters more than throughput. The caller's environment has precedence.
_LOW_MEMORY = {"KLEINKRAM_DATABASE_CONNECTIONS": "4", "MALLOC_ARENA_MAX": "2"}
# How the package index of scripts is reached: the certificates that are trusted, and the proxies.
_CERTIFICATES = ("SSL_CERT_FILE", "SSL_CERT_DIR")
_PROXIES = tuple(name for word in ("HTTP", "HTTPS", "ALL", "NO") for name in (f"{word}_PROXY", f"{word.lower()}_proxy"))
# And where the container engine is.
_RUNNER_ENVIRONMENT = ("DOCKER_HOST", "DOCKER_CONFIG", "XDG_RUNTIME_DIR", *_CERTIFICATES, *_PROXIES)

_LOG_LIMIT_BYTES = 10 * 1024 * 1024
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 30.0
_STEADY_S = 60.0
# Source: PostgreSQL, "Message Severity Levels".
_FATAL = ("PANIC:", "FATAL:")
_REJECTED_CLIENT = ("the database system is", "terminating ")


@dataclass(frozen=True)
class UpOptions:
    """Options of `klein up`. `server`: the command whose subcommands are migrate, api and worker.

    `as_json`: the line of output is the content of `instance.json` instead of a sentence.
    """

    data_dir: Path
    listening: Listening = field(default_factory=Listening)
    server: tuple[str, ...] = SERVER
    is_default_data_dir: bool = False
    with_runner: bool = True
    as_json: bool = False


@dataclass(frozen=True)
class RunnerServiceOptions:
    """Options of the process that becomes the runner. `runner`: the arguments of `kleinkram.runner`."""

    api_url: str
    certificate: str | None
    owner_token_file: str
    runner: dict[str, object]


@dataclass(frozen=True)
class Plan:
    """Programs, ports, secrets and addresses of one start."""

    data_dir: DataDir
    listening: Listening
    server: tuple[str, ...]
    ports: Mapping[str, int]
    public_url: str
    store_public_url: str
    postgres: PostgresCluster
    store: StoreFolder
    with_runner: bool

    @property
    def local_url(self) -> str:
        """The API's address from this machine."""
        return f"{self.listening.scheme}://{self.listening.local_host}:{self.ports['api']}"

    @property
    def local_store_url(self) -> str:
        """The store's address for clients, from this machine."""
        return f"{self.listening.scheme}://{self.listening.local_host}:{self.ports['store']}"

    def server_command(self, name: str) -> ChildCommand:
        """Return the command of `migrate`, `api` or `worker`; only `migrate` gets the schema owner's password."""
        environment = {
            "KLEINKRAM_DATABASE_URL": self.postgres.url(SERVE),
            "KLEINKRAM_S3_PUBLIC_URL": self.store_public_url,
            **_store_environment(self.store.access),
            "KLEINKRAM_STORE_FOLDER": str(self.store.folder),
            "KLEINKRAM_PUBLIC_URL": self.public_url,
            "KLEINKRAM_OWNER_TOKEN_FILE": str(self.data_dir.token_file),
            "KLEINKRAM_LOG_FORMAT": "json",
            **{name: os.environ.get(name, value) for name, value in _LOW_MEMORY.items()},
            **_telemetry(),
        }
        if f"{name}_metrics" in METRICS_PORTS:
            environment["KLEINKRAM_METRICS_PORT"] = str(self.ports[f"{name}_metrics"])
            environment["KLEINKRAM_METRICS_ADDRESS"] = "127.0.0.1"
        arguments: list[str] = []
        if name == "migrate":
            environment["KLEINKRAM_MIGRATION_DATABASE_URL"] = self.postgres.url(MIGRATE)
        if name == "api":
            environment |= {name: os.environ[name] for name in (*_CERTIFICATES, *_PROXIES) if name in os.environ}
            arguments = ["--wait-for-stdin", "--host", self.listening.address, "--port", str(self.ports["api"])]
            if self.listening.tls:
                certificate, key = self.listening.tls
                arguments += ["--tls-cert", str(certificate), "--tls-key", str(key)]
        return self._command(name, [*self.server, name, *arguments], environment, waits=name == "api")

    def proxy_command(self) -> ChildCommand | None:
        """Return the command that forwards other machines to the store; None where clients reach it directly."""
        if not self.listening.needs_proxy:
            return None
        target = self.store.ports["s3_tls" if self.listening.tls else "s3"]
        module = [sys.executable, "-m", "kleinkram.standalone.tcp_proxy"]
        return self._command("proxy", [*module, self.listening.address, str(self.ports["store"]), str(target)], {})

    def runner_command(self) -> ChildCommand | None:
        """Return the command of the runner of this machine; None without one."""
        if not self.with_runner:
            return None
        certificate = self.listening.tls_cert
        inherited = {name: os.environ[name] for name in _RUNNER_ENVIRONMENT if name in os.environ}
        environment = {**_LOW_MEMORY, **inherited, **_telemetry()}
        if certificate is not None:
            write_private(self.data_dir.certificates_file, bundle_with(certificate))
            environment["SSL_CERT_FILE"] = str(self.data_dir.certificates_file)
        runner: dict[str, object] = {
            # The runner verifies the certificate's host name.
            "url": self.local_url if certificate is None else self.public_url,
            "data_dir": str(self.data_dir.runner),
            "name": "klein-up",
            "token_file": str(self.data_dir.runner_token_file),
            "log_format": "json",
        }
        if default_image := os.environ.get("KLEINKRAM_DEFAULT_IMAGE"):
            runner["default_image"] = default_image
        options = RunnerServiceOptions(
            self.local_url, str(certificate) if certificate else None, str(self.data_dir.token_file), runner
        )
        arguments = [sys.executable, "-m", "kleinkram.standalone", "runner", json.dumps(asdict(options))]
        return self._command("runner", arguments, environment)

    def ports_of(self, service: str) -> list[str]:
        """Return the names of the ports that a service listens on."""
        if service == "store":
            own = [name for name in PORT_NAMES if name != "s3" and (name != "s3_tls" or self.listening.tls)]
            return [*own, "s3" if self.listening.needs_proxy else "store"]
        metrics = [f"{service}_metrics"] if f"{service}_metrics" in METRICS_PORTS else []
        return [*{"proxy": ["store"], "worker": [], "runner": []}.get(service, [service]), *metrics]

    def _command(
        self, name: str, arguments: list[str], environment: Mapping[str, str], *, waits: bool = False
    ) -> ChildCommand:
        root = self.data_dir.root
        return ChildCommand(arguments, root, self.data_dir.log(name), environment, root, waits=waits)


def make_plan(options: UpOptions) -> Plan:
    """Choose ports, generate secrets, and record both in the data directory. The caller holds its lock.

    Raises:
        StandaloneError: a program is missing, a port is taken, an option is invalid.
    """
    data_dir, listening = DataDir(options.data_dir), options.listening
    check_listening(listening)
    programs, weed = locate_postgres(), locate_weed()
    ports = assign_ports(listening, load_ports(data_dir))
    write_private(data_dir.ports_file, json.dumps(ports, indent=2))
    secrets = load_secrets(data_dir)
    ensure_owner_token(data_dir)
    public_url, store_public_url = public_urls(listening, ports)
    return Plan(
        data_dir=data_dir,
        listening=listening,
        server=options.server,
        ports=ports,
        public_url=public_url,
        store_public_url=store_public_url,
        postgres=PostgresCluster(
            binaries=programs,
            data_dir=data_dir.root,
            folder=data_dir.postgres,
            log=data_dir.log("postgres"),
            port=ports["postgres"],
            passwords={
                ADMIN: secrets.postgres_admin,
                MIGRATE: secrets.postgres_migrate,
                SERVE: secrets.postgres_serve,
            },
        ),
        store=StoreFolder(
            program=weed,
            data_dir=data_dir.root,
            folder=data_dir.store,
            log=data_dir.log("store"),
            ports={**ports, "s3": ports["s3"] if listening.needs_proxy else ports["store"]},
            access_key=secrets.s3_access_key,
            secret_key=secrets.s3_secret_key,
            tls=listening.tls,
        ),
        with_runner=options.with_runner,
    )


def _telemetry() -> dict[str, str]:
    """Return the variables of OpenTelemetry, which say where traces are exported to."""
    return {name: value for name, value in os.environ.items() if name.startswith("OTEL_")}


def backup_environment(secrets: Secrets, *, postgres_port: int, store_port: int) -> dict[str, str]:
    """Return the settings of database, for both roles, and store."""
    access = StoreAccess(f"http://127.0.0.1:{store_port}", secrets.s3_access_key, secrets.s3_secret_key)
    return {
        "KLEINKRAM_DATABASE_URL": role_url(SERVE, secrets.postgres_serve, postgres_port),
        "KLEINKRAM_MIGRATION_DATABASE_URL": role_url(MIGRATE, secrets.postgres_migrate, postgres_port),
        **_store_environment(access),
    }


def _store_environment(access: StoreAccess) -> dict[str, str]:
    return {
        "KLEINKRAM_S3_INTERNAL_URL": access.endpoint,
        "KLEINKRAM_S3_BUCKET": BUCKET,
        "KLEINKRAM_S3_ACCESS_KEY": access.access_key,
        "KLEINKRAM_S3_SECRET_KEY": access.secret_key,
        "KLEINKRAM_S3_REGION": access.region,
    }


@dataclass
class ServiceProcess:
    """A service with its process, which is restarted after increasing pauses.

    `failures_checked`: at how many failures its ports were last checked. `log_from`: size of the log at the last start.
    """

    name: str
    start: Callable[[], "subprocess.Popen[bytes]"]
    log: Path
    stop_signal: signal.Signals = signal.SIGTERM
    stop_timeout_s: float = 15.0
    failures: int = 0
    failures_checked: int = 0
    restart_at: float | None = None
    child: "subprocess.Popen[bytes]" = field(init=False)
    started_at: float = field(init=False)
    log_from: int = field(init=False)

    def launch(self) -> None:
        """Start the process."""
        self.log_from = self.log.stat().st_size if self.log.exists() else 0
        self.child = self.start()
        self.started_at = time.monotonic()
        self.restart_at = None

    @property
    def pid(self) -> int | None:
        """The running process's pid."""
        return self.child.pid if self.restart_at is None else None

    def exit_reason(self) -> str | None:
        """Return how the process ended, None while it runs."""
        code = self.child.poll()
        if code is None:
            return None
        return f"killed by signal {-code}" if code < 0 else f"exit code {code}"

    def schedule_restart(self) -> float:
        """Schedule the next start of a service that has ended; returns the pause in seconds."""
        kill_group(self.child)
        now = time.monotonic()
        self.failures = 1 if now - self.started_at > _STEADY_S else self.failures + 1
        pause = min(_FIRST_PAUSE_S * 2.0 ** (self.failures - 1), _LONGEST_PAUSE_S)
        self.restart_at = now + pause
        return pause

    def restart_if_due(self) -> bool:
        """Start again if the pause is over; returns whether it was started."""
        if self.restart_at is None or time.monotonic() < self.restart_at:
            return False
        self.launch()
        return True

    def stop(self) -> None:
        """End the process and its group."""
        stop(self.child, sign=self.stop_signal, timeout_s=self.stop_timeout_s)

    def limit_log(self) -> None:
        """Keep the log below 10 MB, with one older copy beside it.

        Copied, then emptied, since the process keeps the file open. Lines written in between are lost.
        """
        if self.log.exists() and self.log.stat().st_size > _LOG_LIMIT_BYTES:
            shutil.copyfile(self.log, self.log.with_suffix(".log.1"))
            with self.log.open("r+b") as file:
                file.truncate(0)


def last_line(log: Path) -> str:
    """Return the last line of a log that is not empty; at most 300 characters."""
    lines = [line.strip() for line in _tail(log, 4096) if line.strip()]
    return lines[-1][:300] if lines else ""


def last_postgres_error(log: Path, *, since: int = 0) -> str:
    """Return PostgreSQL's last reason for ending, empty where the log's end has none. `since`: first byte to read."""
    matches = [line.partition(word) for line in _tail(log, 16_384, since) for word in _FATAL if word in line]
    # Rejected clients are FATAL, too.
    errors = [
        rest.strip() for _, word, rest in matches if word == "PANIC:" or not rest.strip().startswith(_REJECTED_CLIENT)
    ]
    return errors[-1][:300] if errors else ""


def _tail(log: Path, limit_bytes: int, since: int = 0) -> list[str]:
    try:
        with log.open("rb") as file:
            size = log.stat().st_size
            file.seek(max(0, size - limit_bytes, since if since <= size else 0))
            return file.read().decode(errors="replace").splitlines()
    except FileNotFoundError:
        return []
