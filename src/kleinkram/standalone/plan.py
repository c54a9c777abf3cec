"""What `klein up` starts, worked out before anything is started: commands, environments, addresses, secrets."""

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.standalone.address import METRICS_PORTS, Listening, check_listening, public_urls, settle_ports
from kleinkram.standalone.binaries import locate_postgres, locate_weed
from kleinkram.standalone.child import Command
from kleinkram.standalone.data_dir import DataDir, ensure_owner_token, load_ports, load_secrets, write_private
from kleinkram.standalone.postgres import MIGRATE, SERVE, PostgresCluster, PostgresPasswords
from kleinkram.standalone.runner_part import RunnerPart
from kleinkram.standalone.s3 import StoreAccess
from kleinkram.standalone.store import BUCKET, PORT_NAMES, StoreFolder
from kleinkram.standalone.trust import bundle_with

SERVER = (sys.executable, "-m", "kleinkram.server")
DOOR = (sys.executable, "-m", "kleinkram.standalone.door")

# One machine, few users: memory matters more than the last request per second. What the caller has set stands.
_THRIFT = {"KLEINKRAM_DATABASE_CONNECTIONS": "4", "MALLOC_ARENA_MAX": "2"}


# Where an engine of containers is, and which certificates are believed.
_ENGINE = ("DOCKER_HOST", "DOCKER_CONFIG", "XDG_RUNTIME_DIR", "SSL_CERT_FILE", "SSL_CERT_DIR")


@dataclass(frozen=True)
class UpOptions:
    """What the caller of `klein up` chose. `server` is the command whose subcommands are migrate, api and worker.

    `with_runner`: it runs actions here, too. `as_json`: the one line of output is what `instance.json` holds, not a
    sentence.
    """

    data_dir: Path
    listening: Listening = field(default_factory=Listening)
    server: tuple[str, ...] = SERVER
    is_default_data_dir: bool = False
    with_runner: bool = True
    as_json: bool = False


@dataclass(frozen=True)
class Plan:
    """Everything settled for one start."""

    data_dir: DataDir
    listening: Listening
    server: tuple[str, ...]
    ports: Mapping[str, int]
    public_url: str
    store_public_url: str
    postgres: PostgresCluster
    store: StoreFolder
    with_runner: bool

    def server_process(self, name: str, *arguments: str) -> Command:
        """One of the server's processes; only `migrate` learns the password of the role that owns the schema."""
        environment = _server_environment(self)
        if f"{name}_metrics" in METRICS_PORTS:
            environment["KLEINKRAM_METRICS_PORT"] = str(self.ports[f"{name}_metrics"])
            environment["KLEINKRAM_METRICS_ADDRESS"] = "127.0.0.1"
        if name == "migrate":
            environment["KLEINKRAM_MIGRATION_DATABASE_URL"] = self.postgres.url(MIGRATE)
        return Command(
            arguments=[*self.server, name, *arguments],
            data_dir=self.data_dir.root,
            log=self.data_dir.log(name),
            environment=environment,
            directory=self.data_dir.root,
            waits=name == "api",
        )

    def data_environment(self) -> dict[str, str]:
        """What a process must know to reach database and store, also as the role that owns the schema."""
        cluster = self.postgres
        return data_environment(cluster.url(SERVE), cluster.url(MIGRATE), self.store.access)

    def door(self) -> Command | None:
        """What passes clients from outside on to the store; None where they reach it directly."""
        if not self.listening.needs_door:
            return None
        target = self.store.ports["s3_tls" if self.listening.tls else "s3"]
        return Command(
            arguments=[*DOOR, self.listening.address, str(self.ports["store"]), str(target)],
            data_dir=self.data_dir.root,
            log=self.data_dir.log("door"),
            directory=self.data_dir.root,
        )

    def runner(self) -> Command | None:
        """What runs actions here; None where nobody wants that."""
        if not self.with_runner:
            return None
        certificate = self.listening.tls_cert
        # By TLS, it has to call the API as the certificate does.
        url = self.local_url if certificate is None else self.public_url
        environment = {**_THRIFT, **{name: os.environ[name] for name in _ENGINE if name in os.environ}}
        if certificate is not None:
            write_private(self.data_dir.certificates_file, bundle_with(certificate))
            environment["SSL_CERT_FILE"] = str(self.data_dir.certificates_file)
        said: dict[str, object] = {
            "url": url,
            "data_dir": str(self.data_dir.runner),
            "name": "klein-up",
            "token_file": str(self.data_dir.runner_token_file),
            "log_format": "json",
        }
        if default_image := os.environ.get("KLEINKRAM_DEFAULT_IMAGE"):
            said["default_image"] = default_image
        given = str(certificate) if certificate else None
        part = RunnerPart(self.local_url, given, str(self.data_dir.token_file), said)
        return Command(
            arguments=part.command(),
            data_dir=self.data_dir.root,
            log=self.data_dir.log("runner"),
            environment=environment,
            directory=self.data_dir.root,
        )

    @property
    def local_url(self) -> str:
        """The API's address from this machine."""
        return f"{self.listening.scheme}://{self.listening.local_host}:{self.ports['api']}"

    def ports_of(self, part: str) -> list[str]:
        """The names of the ports that a part listens on."""
        if part == "store":
            own = [name for name in PORT_NAMES if name != "s3" and (name != "s3_tls" or self.listening.tls)]
            return [*own, "s3" if self.listening.needs_door else "store"]
        metrics = [f"{part}_metrics"] if f"{part}_metrics" in METRICS_PORTS else []
        return [*{"door": ["store"], "worker": [], "runner": []}.get(part, [part]), *metrics]

    def api_arguments(self) -> list[str]:
        """Where the API listens, and that it waits for a word before it looks for database and store."""
        arguments = ["--when-told", "--host", self.listening.address, "--port", str(self.ports["api"])]
        if self.listening.tls:
            certificate, key = self.listening.tls
            arguments += ["--tls-cert", str(certificate), "--tls-key", str(key)]
        return arguments


def make_plan(options: UpOptions) -> Plan:
    """Settle ports, secrets and addresses, and note them in the data directory. The caller holds its lock.

    Raises:
        StandaloneError: a program is missing, a port is taken, an option cannot be meant.
    """
    data_dir, listening = DataDir(options.data_dir), options.listening
    check_listening(listening)
    programs, weed = locate_postgres(), locate_weed()
    ports = settle_ports(listening, load_ports(data_dir))
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
            passwords=PostgresPasswords(secrets.postgres_admin, secrets.postgres_migrate, secrets.postgres_serve),
        ),
        store=StoreFolder(
            program=weed,
            data_dir=data_dir.root,
            folder=data_dir.store,
            log=data_dir.log("store"),
            ports={**ports, "s3": ports["s3"] if listening.needs_door else ports["store"]},
            access_key=secrets.s3_access_key,
            secret_key=secrets.s3_secret_key,
            tls=listening.tls,
        ),
        with_runner=options.with_runner,
    )


def data_environment(serve: str, migrate: str, access: StoreAccess) -> dict[str, str]:
    """The settings that name an instance's database, as both roles, and its store."""
    return {
        "KLEINKRAM_DATABASE_URL": serve,
        "KLEINKRAM_MIGRATION_DATABASE_URL": migrate,
        "KLEINKRAM_S3_INTERNAL_URL": access.endpoint,
        "KLEINKRAM_S3_BUCKET": BUCKET,
        "KLEINKRAM_S3_ACCESS_KEY": access.access_key,
        "KLEINKRAM_S3_SECRET_KEY": access.secret_key,
        "KLEINKRAM_S3_REGION": access.region,
    }


def _server_environment(plan: Plan) -> dict[str, str]:
    access = plan.store.access
    return {
        "KLEINKRAM_DATABASE_URL": plan.postgres.url(SERVE),
        "KLEINKRAM_S3_INTERNAL_URL": access.endpoint,
        "KLEINKRAM_S3_PUBLIC_URL": plan.store_public_url,
        "KLEINKRAM_S3_BUCKET": BUCKET,
        "KLEINKRAM_S3_ACCESS_KEY": access.access_key,
        "KLEINKRAM_S3_SECRET_KEY": access.secret_key,
        "KLEINKRAM_S3_REGION": access.region,
        "KLEINKRAM_STORE_FOLDER": str(plan.store.folder),
        "KLEINKRAM_PUBLIC_URL": plan.public_url,
        "KLEINKRAM_OWNER_TOKEN_FILE": str(plan.data_dir.token_file),
        "KLEINKRAM_LOG_FORMAT": "json",
        **{name: os.environ.get(name, value) for name, value in _THRIFT.items()},
    }
