"""All Prometheus metrics: one definition each, from which processes make their metrics and the reference its table.

Labels have few values, none of which a client chooses. Imports no other module of ours: small processes use it.
"""

import enum
from dataclasses import dataclass


class MetricKind(str, enum.Enum):
    """The type of a metric, as Prometheus has it."""

    counter = "counter"
    gauge = "gauge"
    histogram = "histogram"


class MetricSource(str, enum.Enum):
    """Where a metric comes from. `instance`: one API or worker process at a time reports the whole installation."""

    process = "every process"
    server = "API, worker"
    api = "API"
    worker = "worker"
    instance = "instance"
    runner = "runner"


@dataclass(frozen=True)
class MetricDefinition:
    """A metric. The name of a counter ends in `_total`; `values` are those of its last label, where they are known."""

    name: str
    kind: MetricKind
    source: MetricSource
    meaning: str
    labels: tuple[str, ...] = ()
    values: tuple[str, ...] = ()
    buckets: tuple[float, ...] = ()


def _counter(
    name: str, source: MetricSource, meaning: str, *labels: str, values: tuple[str, ...] = ()
) -> MetricDefinition:
    return MetricDefinition(f"kleinkram_{name}", MetricKind.counter, source, meaning, labels, values)


def _gauge(
    name: str, source: MetricSource, meaning: str, *labels: str, values: tuple[str, ...] = ()
) -> MetricDefinition:
    return MetricDefinition(f"kleinkram_{name}", MetricKind.gauge, source, meaning, labels, values)


def _histogram(
    name: str,
    source: MetricSource,
    meaning: str,
    *labels: str,
    buckets: tuple[float, ...],
    values: tuple[str, ...] = (),
) -> MetricDefinition:
    return MetricDefinition(f"kleinkram_{name}", MetricKind.histogram, source, meaning, labels, values, buckets)


# -- every process ----------------------------------------------------------------------------------------------------

BUILD_INFO = _gauge(
    "build_info",
    MetricSource.process,
    "Always 1, with the version and the kind of this process.",
    "version",
    "role",
    values=("api", "worker", "runner"),
)

# -- requests ---------------------------------------------------------------------------------------------------------

REQUESTS = _counter(
    "requests_total",
    MetricSource.api,
    "Requests answered, by the template of their route.",
    "method",
    "route",
    "status",
)
REQUEST_SECONDS = _histogram(
    "request_duration_seconds",
    MetricSource.api,
    "Time to answer a request. Event streams, slices, and requests that wait for something are not included.",
    "method",
    "route",
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10),
)
PROBLEMS = _counter(
    "problems_total", MetricSource.api, "Requests answered with a problem document, by its error code.", "code"
)
SIGN_IN_REFUSALS = _counter(
    "sign_in_refusals_total",
    MetricSource.api,
    "Refused sign-ins and credentials, by error code.",
    "reason",
    values=(
        "not_authenticated",
        "sign_in_failed",
        "sign_in_refused",
        "sign_in_denied",
        "sign_in_expired",
        "second_factor_wrong",
        "code_gone",
    ),
)
RATE_LIMITED = _counter(
    "rate_limited_total",
    MetricSource.api,
    "Requests refused because of a rate limit.",
    "what",
    values=("sign-ins", "logouts by providers", "searches", "downloads", "uploads", "verifications", "exports"),
)
EVENT_STREAMS = _gauge("event_streams", MetricSource.api, "Open event streams.")
LONG_POLLS = _gauge("long_polls", MetricSource.api, "Requests that wait for a run to claim, or for lines of a log.")
EVENTS = _counter("events_total", MetricSource.api, "Change events received from PostgreSQL.")
EVENT_LISTENER_UP = _gauge(
    "event_listener_up", MetricSource.api, "Whether this process listens to PostgreSQL for change events."
)

# -- database and store -----------------------------------------------------------------------------------------------

DATABASE_CONNECTIONS = _gauge(
    "database_connections",
    MetricSource.server,
    "Connections in the pool of this process.",
    "state",
    values=("in_use", "idle"),
)
DATABASE_CONNECTIONS_MAX = _gauge("database_connections_max", MetricSource.server, "Size of the pool of this process.")
DATABASE_CONNECTIONS_WAITING = _gauge(
    "database_connections_waiting", MetricSource.server, "Transactions that wait for a connection."
)
DATABASE_CONNECTION_WAIT_SECONDS = _histogram(
    "database_connection_wait_seconds",
    MetricSource.server,
    "Time that a transaction waited for a connection.",
    buckets=(0.001, 0.005, 0.025, 0.1, 0.5, 1, 5, 20),
)
STORE_REQUESTS = _counter(
    "store_requests_total",
    MetricSource.server,
    "Requests to the store, each attempt, by S3 operation. `refused`: status 4xx, such as for an object that is not "
    "there; `failed`: 5xx; `unreachable`: no answer.",
    "operation",
    "outcome",
    values=("succeeded", "refused", "failed", "unreachable", "cancelled"),
)
STORE_REQUEST_SECONDS = _histogram(
    "store_request_duration_seconds",
    MetricSource.server,
    "Time until the store's answer began.",
    "operation",
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10, 60),
)
STORE_READ_BYTES = _counter(
    "store_read_bytes_total",
    MetricSource.server,
    "Bytes of objects that this process read, mostly to verify them. Its child processes are not included.",
)
STORE_CLOCK_OFFSET_SECONDS = _gauge(
    "store_clock_offset_seconds",
    MetricSource.server,
    "How far the store's clock is ahead of this machine's; 0 if the difference is small.",
)
UPLOAD_FILES = _counter(
    "upload_files_total",
    MetricSource.server,
    "Files that arrived. `linked`: the store had their bytes already.",
    "result",
    values=("stored", "linked"),
)
UPLOAD_BYTES = _counter(
    "upload_bytes_total", MetricSource.server, "Bytes of files that arrived.", "result", values=("stored", "linked")
)
DOWNLOAD_FILES = _counter("download_files_total", MetricSource.api, "Files and artifacts whose URL a client got.")
DOWNLOAD_BYTES = _counter(
    "download_bytes_total", MetricSource.api, "Their bytes: clients get them from the store, and may read less."
)

# -- jobs and runs ----------------------------------------------------------------------------------------------------

JOB_ATTEMPTS = _counter(
    "job_attempts_total",
    MetricSource.worker,
    "Attempts at jobs. `failed`: it is tried again; `given_up`: it is not.",
    "task",
    "outcome",
    values=("succeeded", "failed", "given_up", "aborted"),
)
JOB_SECONDS = _histogram(
    "job_duration_seconds",
    MetricSource.worker,
    "How long an attempt at a job took.",
    "task",
    buckets=(0.1, 0.5, 1, 5, 10, 60, 300, 1800, 7200),
)
JOBS_IN_PROGRESS = _gauge("jobs_in_progress", MetricSource.worker, "Jobs that this process runs.")
RUN_WAIT_SECONDS = _histogram(
    "run_wait_seconds",
    MetricSource.api,
    "Time from the launch of a run until a runner first claimed it.",
    buckets=(1, 5, 15, 60, 300, 1800, 7200, 86_400),
)
RUN_SECONDS = _histogram(
    "run_duration_seconds",
    MetricSource.server,
    "Time from the claim of a run to its end.",
    "state",
    values=("done", "failed", "cancelled"),
    buckets=(1, 10, 60, 300, 1800, 7200, 28_800, 86_400),
)
RUNS_ENDED = _counter("runs_ended_total", MetricSource.server, "Runs that ended.", "state", "reason")

# -- the whole installation -------------------------------------------------------------------------------------------

BLOBS = _gauge(
    "blobs",
    MetricSource.instance,
    "Blobs that are not marked for deletion.",
    "state",
    values=("stored", "verified", "corrupt", "lost"),
)
STORED_BYTES = _gauge(
    "stored_bytes", MetricSource.instance, "Their bytes.", "state", values=("stored", "verified", "corrupt", "lost")
)
BLOB_CONTENT = _gauge("blob_content", MetricSource.instance, "Blobs by what is known of their content.", "content")
MARKED_FOR_DELETION_BYTES = _gauge(
    "marked_for_deletion_bytes", MetricSource.instance, "Bytes of blobs that will be deleted next."
)
TRASH_BYTES = _gauge("trash_bytes", MetricSource.instance, "Bytes of blobs that only the trash refers to.")
PROJECTS = _gauge("projects", MetricSource.instance, "Projects that are not in the trash.")
MISSIONS = _gauge("missions", MetricSource.instance, "Missions that are not in the trash.")
FILES = _gauge("files", MetricSource.instance, "Files that are not in the trash.")
UPLOADS = _gauge(
    "uploads",
    MetricSource.instance,
    "Uploads; those that have ended are kept for some days.",
    "state",
    values=("open", "completing", "done", "aborted", "expired"),
)
QUOTA_USED_RATIO = _gauge(
    "quota_used_ratio",
    MetricSource.instance,
    "The highest share of its quota that a project uses; 0 without quotas.",
    "unit",
    values=("bytes", "files"),
)
PROJECTS_NEAR_QUOTA = _gauge(
    "projects_near_quota",
    MetricSource.instance,
    "Projects that use 90 % or more of a quota.",
    "unit",
    values=("bytes", "files"),
)
STORE_FREE_BYTES = _gauge(
    "store_free_bytes",
    MetricSource.instance,
    "Free space on the store's disk, if `KLEINKRAM_STORE_FOLDER` is set, or what is left of "
    "`KLEINKRAM_STORE_CAPACITY_BYTES`.",
)
STORE_SIZE_BYTES = _gauge(
    "store_size_bytes",
    MetricSource.instance,
    "Size of the store's disk, if `KLEINKRAM_STORE_FOLDER` is set, or `KLEINKRAM_STORE_CAPACITY_BYTES`.",
)
DATABASE_SIZE_BYTES = _gauge("database_size_bytes", MetricSource.instance, "Size of the database.")
DATABASE_SERVER_CONNECTIONS = _gauge(
    "database_server_connections", MetricSource.instance, "Connections to PostgreSQL, of all its clients."
)
DATABASE_SERVER_CONNECTIONS_MAX = _gauge(
    "database_server_connections_max", MetricSource.instance, "`max_connections` of PostgreSQL."
)
DATABASE_CLOCK_OFFSET_SECONDS = _gauge(
    "database_clock_offset_seconds", MetricSource.instance, "How far the database's clock is ahead of this machine's."
)
JOBS = _gauge("jobs", MetricSource.instance, "Jobs in the queue.", "task", "status")
JOBS_RETRYING = _gauge("jobs_retrying", MetricSource.instance, "Jobs that failed and wait for another attempt.", "task")
QUEUE_OLDEST_SECONDS = _gauge(
    "queue_oldest_seconds",
    MetricSource.instance,
    "Age of the oldest job that waits, or waits for another attempt; 0 if none does.",
    "queue",
    values=("default", "verification", "examining", "grouping", "previews"),
)
WORKERS = _gauge("workers", MetricSource.instance, "Worker processes that are alive.")
WORKER_LAST_HEARTBEAT = _gauge(
    "worker_last_heartbeat_timestamp_seconds", MetricSource.instance, "Last heartbeat of a worker; 0 if never."
)
RUNNERS = _gauge(
    "runners",
    MetricSource.instance,
    "Runners that were seen in the last seven days: `alive` or `silent` now.",
    "state",
    values=("alive", "silent"),
)
RUNNER_LAST_SEEN = _gauge(
    "runner_last_seen_timestamp_seconds", MetricSource.instance, "When a runner was last seen; 0 if never."
)
RUNS = _gauge(
    "runs",
    MetricSource.instance,
    "Runs that have not ended.",
    "state",
    values=("queued", "preparing", "running", "collecting"),
)
RUNS_QUEUED_OLDEST_SECONDS = _gauge(
    "runs_queued_oldest_seconds", MetricSource.instance, "Age of the oldest queued run; 0 if there is none."
)
OLDEST_VERIFICATION_SECONDS = _gauge(
    "oldest_verification_seconds", MetricSource.instance, "Seconds since the oldest verification of a blob."
)
SCRUB_ENDED = _gauge(
    "scrub_ended_timestamp_seconds", MetricSource.instance, "When the last scrub ended; absent before the first."
)
SCRUB_STOPPED = _gauge(
    "scrub_stopped", MetricSource.instance, "Whether the last scrub stopped and marked nothing; absent before it."
)
SCRUB_COMPARED = _gauge(
    "scrub_compared", MetricSource.instance, "Blobs that the last scrub compared; absent before it."
)
SCRUB_FINDINGS = _gauge(
    "scrub_findings",
    MetricSource.instance,
    "Objects by result of the last scrub; absent before it.",
    "finding",
    values=("lost", "corrupt", "recovered", "unknown"),
)
BACKUP_LAST_SUCCESS = _gauge(
    "backup_last_success_timestamp_seconds",
    MetricSource.instance,
    "The moment of the last complete backup; 0 if there is none.",
)
BACKUP_LAST_ATTEMPT = _gauge(
    "backup_last_attempt_timestamp_seconds",
    MetricSource.instance,
    "When the last attempt at a backup ended; 0 if there was none.",
)
BACKUP_LAST_ATTEMPT_FAILED = _gauge(
    "backup_last_attempt_failed", MetricSource.instance, "Whether the last attempt at a backup failed."
)
BACKUP_DAMAGED_OBJECTS = _gauge(
    "backup_damaged_objects", MetricSource.instance, "Objects that the last complete backup found lost or corrupt."
)

# -- runners ----------------------------------------------------------------------------------------------------------

_KINDS = ("capacity", "reserved")
RUNNER_RUNS = _gauge("runner_runs", MetricSource.runner, "Runs that it executes.")
RUNNER_RUNS_ENDED = _counter(
    "runner_runs_ended_total",
    MetricSource.runner,
    "Runs that it no longer executes. `lost`: the server gave the run to another runner.",
    "state",
    values=("done", "failed", "cancelled", "lost"),
)
RUNNER_CORES = _gauge("runner_cores", MetricSource.runner, "Cores for runs.", "kind", values=_KINDS)
RUNNER_MEMORY_BYTES = _gauge("runner_memory_bytes", MetricSource.runner, "Memory for runs.", "kind", values=_KINDS)
RUNNER_DISK_BYTES = _gauge("runner_disk_bytes", MetricSource.runner, "Disk for runs.", "kind", values=_KINDS)
RUNNER_GPUS = _gauge("runner_gpus", MetricSource.runner, "GPUs for runs.", "kind", values=_KINDS)
RUNNER_FREE_BYTES = _gauge("runner_free_bytes", MetricSource.runner, "Free space in its data directory.")
RUNNER_LAST_CONTACT = _gauge(
    "runner_last_contact_timestamp_seconds", MetricSource.runner, "When the server last answered it; 0 if never."
)
RUNNER_SERVER_ERRORS = _counter(
    "runner_server_errors_total",
    MetricSource.runner,
    "Requests to the server that failed.",
    "request",
    values=("claim", "heartbeat"),
)
RUNNER_INPUT_BYTES = _counter(
    "runner_input_bytes_total",
    MetricSource.runner,
    "Bytes of inputs that runs got.",
    "source",
    values=("store", "cache"),
)

DEFINITIONS = tuple(value for value in [*globals().values()] if isinstance(value, MetricDefinition))
