"""For each alert of `deploy/observability`: series for which it fires, and series for which it does not."""

from collections.abc import Mapping
from dataclasses import dataclass, field

_CRITICAL, _WARNING = {"severity": "critical"}, {"severity": "warning"}
_API = {"instance": "127.0.0.1:18000", "job": "kleinkram-api"}
_PUBLIC = {"instance": "https://lab.example/health/ready", "job": "kleinkram-public"}
_RUNNER = {"instance": "desk:19100", "job": "kleinkram-runner"}
_WORKER = {"instance": "127.0.0.1:19001", "job": "kleinkram-worker"}


@dataclass(frozen=True)
class AlertCase:
    """Values of series, constant or with a change per minute (`10-1`), and what the alert is after `minutes`.

    Attributes:
        firing, quiet: values with which it fires, and with which it does not.
        labels: of each alert that fires.
    """

    alert: str
    firing: Mapping[str, str]
    quiet: Mapping[str, str]
    summary: str
    labels: tuple[Mapping[str, str], ...]
    minutes: int = field(default=30)


def _series(name: str, labels: Mapping[str, str]) -> str:
    pairs = ",".join(f'{label}="{value}"' for label, value in labels.items())
    return f"{name}{{{pairs}}}"


def _gauge(
    alert: str, series: str, firing: str, quiet: str, summary: str, *labels: Mapping[str, str], minutes: int = 30
) -> AlertCase:
    return AlertCase(alert, {series: firing}, {series: quiet}, summary, labels, minutes)


_FREE, _SIZE = "kleinkram_store_free_bytes", {"kleinkram_store_size_bytes": "1000000000000"}
_DISK = '{instance="nas:9100",device="/dev/sda1",fstype="ext4",mountpoint="/"}'
_REQUESTS = 'kleinkram_requests_total{method="GET",route="/r",status="%s"}'
_BUCKET = 'kleinkram_request_duration_seconds_bucket{method="GET",route="/r",le="%s"}'
_STORE = 'kleinkram_store_requests_total{operation="PutObject",outcome="%s"}'
_CONNECTIONS = "kleinkram_database_server_connections"

CASES = (
    AlertCase(
        "KleinkramApiDown",
        {'kleinkram_build_info{role="worker",version="1"}': "1"},
        {'kleinkram_build_info{role="api",version="1"}': "1"},
        "No API process answers Prometheus.",
        ({"role": "api", **_CRITICAL},),
    ),
    _gauge(
        "KleinkramNotReady",
        _series("probe_success", _PUBLIC),
        "0",
        "1",
        "https://lab.example/health/ready does not answer that it is ready.",
        {**_PUBLIC, **_CRITICAL},
    ),
    _gauge(
        "KleinkramProcessDown",
        _series("up", _WORKER),
        "0",
        "1",
        "127.0.0.1:19001 (kleinkram-worker) does not answer Prometheus.",
        {**_WORKER, **_WARNING},
    ),
    AlertCase(
        "KleinkramDatabaseUnavailable",
        {'kleinkram_build_info{role="api",version="1"}': "1"},
        {'kleinkram_build_info{role="api",version="1"}': "1", "kleinkram_workers": "0"},
        "Processes run, but none of them can read the database.",
        (_CRITICAL,),
    ),
    _gauge(
        "KleinkramNoWorker",
        "kleinkram_workers",
        "0",
        "1",
        "No worker is alive: new files are neither read nor verified.",
        _CRITICAL,
    ),
    _gauge(
        "KleinkramEventsStopped",
        _series("kleinkram_event_listener_up", _API),
        "0",
        "1",
        "127.0.0.1:18000 receives no change events: open pages do not update.",
        {**_API, **_WARNING},
    ),
    *(
        _gauge(
            "KleinkramClockSkew",
            f'kleinkram_{what}_clock_offset_seconds{{instance="a"}}',
            offset,
            "-20",
            "The clocks of the server and of its store or database differ by 45s.",
            _WARNING,
        )
        for what, offset in (("store", "-45"), ("database", "45"))
    ),
    _gauge(
        "KleinkramCertificateExpires",
        _series("probe_ssl_earliest_cert_expiry", _PUBLIC),
        "871200",
        "8712000",
        "The certificate of https://lab.example/health/ready expires in 10d 0h 0m 0s.",
        {"instance": _PUBLIC["instance"], **_WARNING},
        minutes=120,
    ),
    _gauge(
        "KleinkramJobsFailing",
        'kleinkram_jobs_retrying{task="verify_blob"}',
        "2",
        "0",
        "2 jobs verify_blob fail, and are tried again.",
        {"task": "verify_blob", **_WARNING},
    ),
    AlertCase(
        "KleinkramJobsGivenUp",
        {'kleinkram_jobs{task="verify_blob",status="failed"}': "3"},
        {'kleinkram_jobs{task="verify_blob",status="todo"}': "3"},
        "3 jobs verify_blob failed permanently.",
        ({"task": "verify_blob", **_WARNING},),
    ),
    AlertCase(
        "KleinkramQueueOld",
        {'kleinkram_queue_oldest_seconds{queue="default"}': "1000"},
        {'kleinkram_queue_oldest_seconds{queue="verification"}': "1000"},
        "A job has waited in the queue default for 16m 40s.",
        ({"queue": "default", **_WARNING},),
    ),
    AlertCase(
        "KleinkramVerificationLate",
        {'kleinkram_queue_oldest_seconds{queue="verification"}': "50000"},
        {'kleinkram_queue_oldest_seconds{queue="verification"}': "40000"},
        "A file has waited for its verification for 13h 53m 20s.",
        (_WARNING,),
    ),
    _gauge(
        "KleinkramFilesLost", 'kleinkram_blobs{state="lost"}', "2", "0", "2 objects are not in the store.", _CRITICAL
    ),
    _gauge(
        "KleinkramFilesCorrupt",
        'kleinkram_blobs{state="corrupt"}',
        "1",
        "0",
        "The bytes of 1 objects changed in the store.",
        _CRITICAL,
    ),
    _gauge(
        "KleinkramScrubStopped",
        "kleinkram_scrub_stopped",
        "1",
        "0",
        "The last scrub missed so many objects that it stopped.",
        _CRITICAL,
    ),
    _gauge(
        "KleinkramScrubOld",
        "kleinkram_scrub_ended_timestamp_seconds",
        "0",
        "0+60",
        "The last scrub ended 2d 13h 0m 0s ago.",
        _WARNING,
        minutes=61 * 60,
    ),
    _gauge(
        "KleinkramVerificationOld",
        "kleinkram_oldest_verification_seconds",
        "11000000",
        "7000000",
        "A file was last verified 127d 7h 33m 20s ago.",
        _WARNING,
        minutes=120,
    ),
    _gauge(
        "KleinkramBackupOld",
        "kleinkram_backup_last_success_timestamp_seconds",
        "0",
        "0+60",
        "There is no complete backup of the last 36 hours.",
        _CRITICAL,
        minutes=37 * 60,
    ),
    _gauge(
        "KleinkramBackupFailed",
        "kleinkram_backup_last_attempt_failed",
        "1",
        "0",
        "The last backup failed.",
        _WARNING,
    ),
    _gauge(
        "KleinkramBackupDamaged",
        "kleinkram_backup_damaged_objects",
        "4",
        "0",
        "4 objects of the last complete backup are lost or corrupt.",
        _CRITICAL,
    ),
    AlertCase(
        "KleinkramStoreFull",
        {_FREE: "50000000000", **_SIZE},
        {_FREE: "500000000000", **_SIZE},
        "The disk of the store is 95% full.",
        (_CRITICAL, _WARNING),
    ),
    AlertCase(
        "KleinkramStoreFull",
        {_FREE: "150000000000", **_SIZE},
        {_FREE: "250000000000", **_SIZE},
        "The disk of the store is 85% full.",
        (_WARNING,),
    ),
    _gauge(
        "KleinkramStoreFillsSoon",
        _FREE,
        "600000000000-60000000",
        "600000000000-6000000",
        "At the rate of the last day, the disk of the store is full within 7 days.",
        _WARNING,
        minutes=26 * 60,
    ),
    AlertCase(
        "KleinkramDiskFull",
        {f"node_filesystem_avail_bytes{_DISK}": "5", f"node_filesystem_size_bytes{_DISK}": "100"},
        {f"node_filesystem_avail_bytes{_DISK}": "15", f"node_filesystem_size_bytes{_DISK}": "100"},
        "/dev/sda1 of nas:9100 has 5% left.",
        ({"instance": "nas:9100", "device": "/dev/sda1", **_WARNING},),
    ),
    _gauge(
        "KleinkramQuotaNear",
        'kleinkram_projects_near_quota{unit="bytes"}',
        "2",
        "0",
        "2 projects use 90 % of their quota of bytes or more.",
        {"unit": "bytes", **_WARNING},
    ),
    AlertCase(
        "KleinkramErrorRate",
        {_REQUESTS % "500": "0+6", _REQUESTS % "200": "0+54"},
        {_REQUESTS % "404": "0+6", _REQUESTS % "200": "0+54"},
        "10% of requests end in an error of the server.",
        (_CRITICAL,),
    ),
    AlertCase(
        "KleinkramSlow",
        {_BUCKET % "2.5": "0", _BUCKET % "10": "0+60", _BUCKET % "+Inf": "0+60"},
        {_BUCKET % "2.5": "0+60", _BUCKET % "10": "0+60", _BUCKET % "+Inf": "0+60"},
        "One of 20 requests takes 9.625s or longer.",
        (_WARNING,),
    ),
    AlertCase(
        "KleinkramStoreErrors",
        {_STORE % "unreachable": "0+6", _STORE % "succeeded": "0+54"},
        {_STORE % "refused": "0+6", _STORE % "succeeded": "0+54"},
        "10% of requests to the store fail.",
        (_CRITICAL,),
    ),
    AlertCase(
        "KleinkramDatabaseConnections",
        {_CONNECTIONS: "90", f"{_CONNECTIONS}_max": "100"},
        {_CONNECTIONS: "70", f"{_CONNECTIONS}_max": "100"},
        "90% of PostgreSQL's connections are in use.",
        (_WARNING,),
    ),
    _gauge(
        "KleinkramDatabasePoolFull",
        _series("kleinkram_database_connections_waiting", _API),
        "3",
        "0",
        "Requests of 127.0.0.1:18000 wait for a database connection.",
        {**_API, **_WARNING},
    ),
    AlertCase(
        "KleinkramSignInsRefused",
        {'kleinkram_sign_in_refusals_total{reason="sign_in_failed"}': "0+10"},
        {'kleinkram_sign_in_refusals_total{reason="not_authenticated"}': "0+10"},
        "150 sign-ins were refused in 15 minutes.",
        (_WARNING,),
    ),
    _gauge(
        "KleinkramRunnerGone",
        'kleinkram_runners{state="silent"}',
        "1",
        "0",
        "1 runners of the last 7 days do not answer any more.",
        _WARNING,
    ),
    _gauge(
        "KleinkramRunsQueued",
        "kleinkram_runs_queued_oldest_seconds",
        "4000",
        "3000",
        "A run has waited for a runner for 1h 6m 40s.",
        _WARNING,
    ),
    _gauge(
        "KleinkramRunnerDiskFull",
        _series("kleinkram_runner_free_bytes", _RUNNER),
        "1073741824",
        "10000000000",
        "The runner desk:19100 has 1GiB of disk left.",
        {**_RUNNER, **_WARNING},
    ),
)
