"""`python -m kleinkram.server check | create-bucket | migrate | api | worker`: the server's processes."""

import argparse
import asyncio
import contextlib
import gc
import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

from kleinkram import traces
from kleinkram.server.environment import SettingsInvalid, load_settings
from kleinkram.server.logs import set_up_logs
from kleinkram.server.settings import Settings, plain_dsn

_NICENESS = 10
_NOT_STARTED = 3
# For a store that starts at the same time.
_BUCKET_TIMEOUT_S = 60.0
# A page of a hundred rows allocates thousands of objects without cycles. With Python's default of 700, the garbage
# collector takes 5 % of the CPU time.
_GC_THRESHOLD = 10_000


def main() -> None:
    """Run one of the server's processes until it receives a signal to stop."""
    arguments = _parser().parse_args()
    if arguments.command == "check":
        _check(as_json=arguments.as_json)
    try:
        settings = load_settings()
    except SettingsInvalid as error:
        sys.exit(str(error))
    if getattr(arguments, "metrics_port", None) is not None:
        settings = settings.model_copy(update={"metrics_port": arguments.metrics_port})
    set_up_logs(settings.log_format, settings.log_level, role=arguments.command)
    if arguments.command == "migrate":
        _migrate(settings)
    elif arguments.command == "create-bucket":
        _create_bucket(settings)
    elif arguments.command == "worker":
        _work(settings)
    else:
        _serve(settings, arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m kleinkram.server", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("migrate", help="bring the database schema to this version")
    commands.add_parser("create-bucket", help="create the bucket of the settings, unless it exists")
    check = commands.add_parser("check", help="check settings, database, store and this machine")
    check.add_argument("--json", action="store_true", dest="as_json")
    worker = commands.add_parser("worker", help="run background jobs")
    api = commands.add_parser("api", help="serve the API")
    api.add_argument("--host", default="127.0.0.1")
    api.add_argument("--port", type=int, default=8000)
    api.add_argument("--tls-cert", type=Path)
    api.add_argument("--tls-key", type=Path)
    for command in (api, worker):
        command.add_argument("--metrics-port", type=int, help="instead of KLEINKRAM_METRICS_PORT")
    api.add_argument("--wait-for-stdin", action="store_true", help="load, then wait for a line on stdin before serving")
    return parser


def _migrate(settings: Settings) -> None:
    from kleinkram.server.migrations.migrate import MigrationBlocked, SchemaUnsupported, migrate, set_audit_retention

    url = plain_dsn(settings.migration_database_url or settings.database_url).replace("://", "+psycopg://", 1)
    try:
        migrate(url, settings.serving_role)
        set_audit_retention(url, settings.audit_days)
    except (MigrationBlocked, SchemaUnsupported) as error:
        sys.exit(str(error))


def _create_bucket(settings: Settings) -> None:
    from kleinkram.contract.errors import StoreUnavailable
    from kleinkram.server.s3.bucket import create_bucket

    try:
        is_new = asyncio.run(create_bucket(settings, timeout_s=_BUCKET_TIMEOUT_S))
    except StoreUnavailable as error:
        sys.exit(f"The bucket {settings.s3_bucket} was not created: {error.reason}.")
    sys.stdout.write(f"The bucket {settings.s3_bucket} {'was created' if is_new else 'exists'}.\n")


def _check(*, as_json: bool) -> NoReturn:
    from kleinkram.server.health.checks import main as check

    sys.exit(check(as_json=as_json))


def _work(settings: Settings) -> None:
    with _loading():
        from kleinkram.server.health.metrics_server import MetricsPortUnusable
        from kleinkram.server.worker import run_worker

    # Requests have priority over jobs. The child processes that read recordings inherit this.
    os.nice(_NICENESS)
    traces.start("kleinkram-worker")
    try:
        asyncio.run(run_worker(settings))
    except MetricsPortUnusable as error:
        logging.getLogger("kleinkram").critical(str(error))
        sys.exit(_NOT_STARTED)
    finally:
        traces.stop()


def _serve(settings: Settings, arguments: argparse.Namespace) -> None:
    traces.start("kleinkram-api")
    with _loading():
        import uvicorn

        from kleinkram.server.app import create_app
        from kleinkram.server.http.uvicorn_server import ApiServer

        app = create_app(settings)
    if arguments.wait_for_stdin and not sys.stdin.readline():
        return  # the supervisor has ended
    config = uvicorn.Config(
        app,
        host=arguments.host,
        port=arguments.port,
        ssl_certfile=arguments.tls_cert,
        ssl_keyfile=arguments.tls_key,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,  # `http/headers.py` decides which proxies to trust
        timeout_graceful_shutdown=10,
    )
    server = ApiServer(config, app)
    with contextlib.suppress(KeyboardInterrupt):
        server.run()
    traces.stop()
    if not server.started:
        sys.exit(_NOT_STARTED)


@contextlib.contextmanager
def _loading() -> Iterator[None]:
    """Import modules without garbage collection, and exclude what they allocate from later collections."""
    gc.disable()
    yield
    gc.freeze()
    gc.set_threshold(_GC_THRESHOLD)
    gc.enable()


if __name__ == "__main__":
    main()
