"""The dashboards: what they show, and the queries.

One process at a time reports the gauges of the whole instance: `max` reads them from whichever it is. Counters are
summed over processes. A counter has no series before its first event, so that rare ones are `or vector(0)`.
"""

from typing import Any

from tools.dashboards.panels import (
    Dashboard,
    Query,
    Row,
    link_to_logs,
    link_to_traces,
    log_lines,
    number,
    plot,
    traces,
)

_HOUR, _DAY = 3600, 86_400
_RED, _ORANGE = "red", "orange"
_FAILED = '{status=~"5.."}'
_ANY_LINE = '{service_name="kleinkram"}'
# Messages of workers, of requests, and of the listener for change events.
_LOST_CONNECTION = "the database went away|database error|not listening for changes"


def _rate(metric: str, *, by: str = "", where: str = "") -> str:
    grouping = f" by ({by})" if by else ""
    return f"sum{grouping} (rate({metric}{where}[$__rate_interval]))"


def _rare(metric: str, *, by: str = "", where: str = "") -> str:
    return f"{_rate(metric, by=by, where=where)} or vector(0)"


def _stored_bytes() -> Any:  # Any: see `Row`
    by_state = Query("max by (state) (kleinkram_stored_bytes)", "{{state}}")
    return plot("Stored bytes", "decbytes", "Bytes of objects by state.", by_state, is_stacked=True)


def _quantile(quantile: float, metric: str, *, by: str = "") -> str:
    labels = f"le, {by}" if by else "le"
    return f"histogram_quantile({quantile}, sum by ({labels}) (rate({metric}_bucket[$__rate_interval])))"


_STORE_USED = "1 - min(kleinkram_store_free_bytes) / max(kleinkram_store_size_bytes)"
# At most ten years: the disk does not fill in sight.
_UNTIL_FULL = (
    "clamp_max(min(kleinkram_store_free_bytes)"
    " / clamp_min(-max(deriv(kleinkram:store_free_bytes:min[6h])), 1), 315360000)"
)
_BACKUP_AGE = "time() - max(kleinkram_backup_last_success_timestamp_seconds)"
_BAD_FILES = 'sum(max by (state) (kleinkram_blobs{state=~"lost|corrupt"})) or vector(0)'
_FAILED_JOBS = 'sum(max by (task) (kleinkram_jobs{status="failed"})) or vector(0)'
_QUEUE_AGE = Query("max by (queue) (kleinkram_queue_oldest_seconds)", "{{queue}}")
_RUNS = Query("max by (state) (kleinkram_runs)", "{{state}}")
_BY_STATUS = Query(_rate("kleinkram_requests_total", by="status"), "{{status}}")
_UPLOADED = Query(_rare("kleinkram_upload_bytes_total"), "uploaded")
_DOWNLOADED = Query(_rare("kleinkram_download_bytes_total"), "download URLs issued for")
_ROUTE = "${__field.labels.route}"
_ROUTE_LINKS = (
    link_to_traces("Slow traces of this route", f'{{ span.http.route = "{_ROUTE}" && duration > 500ms }}'),
    link_to_logs("Log lines of this route", f'{_ANY_LINE} | json | route="{_ROUTE}"'),
)

OVERVIEW = Dashboard(
    "overview",
    "Kleinkram / Overview",
    "Is it healthy, what is full, and what needs somebody?",
    (
        Row(
            "Now",
            (
                number(
                    "API processes",
                    "none",
                    "API processes that answer Prometheus.",
                    'count(kleinkram_build_info{role="api"}) or vector(0)',
                    good=_RED,
                    limits=((1, "green"),),
                ),
                number(
                    "Workers",
                    "none",
                    "Worker processes with a heartbeat.",
                    "max(kleinkram_workers)",
                    good=_RED,
                    limits=((1, "green"),),
                ),
                number("Runners", "none", "Runners that answer.", 'max(kleinkram_runners{state="alive"}) or vector(0)'),
                number(
                    "Alerts",
                    "none",
                    "Alerts of Prometheus that fire; see docs/alerts.md.",
                    'count(ALERTS{alertname=~"Kleinkram.*", alertstate="firing"}) or vector(0)',
                    limits=((1, _RED),),
                ),
                number(
                    "Lost or corrupt files",
                    "none",
                    "Files whose object is missing, or has changed.",
                    _BAD_FILES,
                    limits=((1, _RED),),
                ),
                number("Failed jobs", "none", "Jobs that failed permanently.", _FAILED_JOBS, limits=((1, _ORANGE),)),
                number(
                    "Last backup",
                    "s",
                    "Age of the last complete backup.",
                    _BACKUP_AGE,
                    limits=((26 * _HOUR, _ORANGE), (36 * _HOUR, _RED)),
                ),
                number(
                    "Store used",
                    "percentunit",
                    "Share of the store's disk, if the server knows it.",
                    _STORE_USED,
                    limits=((0.8, _ORANGE), (0.9, _RED)),
                ),
            ),
        ),
        Row(
            "Use",
            (
                plot("Requests", "reqps", "Requests per second by status.", _BY_STATUS),
                plot(
                    "Time to answer",
                    "s",
                    "Without event streams, slices and long polls.",
                    Query(_quantile(0.5, "kleinkram_request_duration_seconds"), "median"),
                    Query(_quantile(0.95, "kleinkram_request_duration_seconds"), "95 %"),
                ),
                plot("Transfers", "Bps", "Bytes of files that arrived or were downloaded.", _UPLOADED, _DOWNLOADED),
                _stored_bytes(),
                plot("Oldest job", "s", "Age of the oldest job that waits, by queue.", _QUEUE_AGE),
                plot("Runs", "none", "Runs that have not ended.", _RUNS, is_stacked=True),
            ),
        ),
        Row(
            "Problems",
            (
                plot(
                    "Alerts over time",
                    "none",
                    "Alerts that fire or are about to.",
                    Query('sum by (alertname) (ALERTS{alertname=~"Kleinkram.*"}) or vector(0)', "{{alertname}}"),
                ),
                log_lines(
                    "Errors", "Errors of all processes.", '{service_name="kleinkram", level=~"error|critical"} | json'
                ),
            ),
        ),
    ),
)

STORAGE = Dashboard(
    "storage",
    "Kleinkram / Storage",
    "What the store contains, whether it is intact, and when it will be full.",
    (
        Row(
            "Now",
            (
                number("Projects", "none", "Projects outside the trash.", "max(kleinkram_projects)"),
                number("Missions", "none", "Missions outside the trash.", "max(kleinkram_missions)"),
                number("Files", "none", "Files outside the trash.", "max(kleinkram_files)"),
                number("Free", "decbytes", "Free space of the store's disk.", "min(kleinkram_store_free_bytes)"),
                number(
                    "Full in",
                    "s",
                    "At the rate of the last 6 hours; 10 years if the disk does not fill.",
                    _UNTIL_FULL,
                    good=_RED,
                    limits=((7 * _DAY, _ORANGE), (30 * _DAY, "green")),
                ),
                number("Lost or corrupt files", "none", "See docs/alerts.md.", _BAD_FILES, limits=((1, _RED),)),
                number(
                    "Highest use of a quota",
                    "percentunit",
                    "Of any project.",
                    "max(kleinkram_quota_used_ratio)",
                    limits=((0.9, _ORANGE), (1, _RED)),
                ),
                number(
                    "Last backup",
                    "s",
                    "Age of the last complete backup.",
                    _BACKUP_AGE,
                    limits=((26 * _HOUR, _ORANGE), (36 * _HOUR, _RED)),
                ),
            ),
        ),
        Row(
            "Content",
            (
                _stored_bytes(),
                plot(
                    "Objects",
                    "none",
                    "Objects by state.",
                    Query("max by (state) (kleinkram_blobs)", "{{state}}"),
                    is_stacked=True,
                ),
                plot(
                    "Space that will be free",
                    "decbytes",
                    "What only the trash refers to, and what is deleted next.",
                    Query("max(kleinkram_trash_bytes)", "trash"),
                    Query("max(kleinkram_marked_for_deletion_bytes)", "marked for deletion"),
                ),
                plot(
                    "Disk of the store",
                    "decbytes",
                    "If the server knows it (KLEINKRAM_STORE_FOLDER).",
                    Query("max(kleinkram_store_size_bytes)", "size"),
                    Query("min(kleinkram_store_free_bytes)", "free"),
                ),
                plot(
                    "Highest use of a quota",
                    "percentunit",
                    "Of any project, by unit.",
                    Query("max by (unit) (kleinkram_quota_used_ratio)", "{{unit}}"),
                ),
                plot(
                    "Projects near a quota",
                    "none",
                    "Projects that use 90 % or more.",
                    Query("max by (unit) (kleinkram_projects_near_quota)", "{{unit}}"),
                ),
            ),
        ),
        Row(
            "Integrity",
            (
                plot(
                    "Since the last scrub",
                    "s",
                    "A scrub compares the store's list with the database, every day.",
                    Query("time() - max(kleinkram_scrub_ended_timestamp_seconds)", "last scrub"),
                ),
                plot(
                    "Findings of the last scrub",
                    "none",
                    "Objects by result.",
                    Query("max by (finding) (kleinkram_scrub_findings)", "{{finding}}"),
                ),
                plot(
                    "Oldest verification",
                    "s",
                    "All bytes are read again every 90 days.",
                    Query("max(kleinkram_oldest_verification_seconds)", "oldest"),
                ),
                plot(
                    "Since backups",
                    "s",
                    "Since the last complete backup, and since the last attempt.",
                    Query(_BACKUP_AGE, "complete"),
                    Query("time() - max(kleinkram_backup_last_attempt_timestamp_seconds)", "attempt"),
                ),
                plot(
                    "Damaged objects in the last backup",
                    "none",
                    "Objects that were lost or corrupt.",
                    Query("max(kleinkram_backup_damaged_objects)", "objects"),
                ),
                plot(
                    "Clock of the store",
                    "s",
                    "How far it is ahead; signatures contain the time.",
                    Query("max by (instance) (kleinkram_store_clock_offset_seconds)", "{{instance}}"),
                ),
            ),
        ),
        Row(
            "Requests to the store",
            (
                plot(
                    "Requests",
                    "reqps",
                    "Of API and workers; clients send bytes to the store directly.",
                    Query(_rate("kleinkram_store_requests_total", by="operation"), "{{operation}}"),
                ),
                plot(
                    "Failed requests",
                    "reqps",
                    "Attempts without success.",
                    Query(
                        _rare("kleinkram_store_requests_total", by="outcome", where='{outcome!="succeeded"}'),
                        "{{outcome}}",
                    ),
                ),
                plot(
                    "Time to answer",
                    "s",
                    "95 % of requests answer within this time.",
                    Query(_quantile(0.95, "kleinkram_store_request_duration_seconds", by="operation"), "{{operation}}"),
                ),
                traces(
                    "Slow requests to the store",
                    "Traces with a request to the store that took a second or longer.",
                    '{ name =~ "S3/.*" && duration > 1s }',
                ),
            ),
        ),
    ),
)

INGEST = Dashboard(
    "ingest",
    "Kleinkram / Ingest",
    "What happens to a file from its upload to its verification.",
    (
        Row(
            "Uploads",
            (
                plot(
                    "Files",
                    "cps",
                    "Files per second; linked: the same bytes were there.",
                    Query(_rate("kleinkram_upload_files_total", by="result"), "{{result}}"),
                ),
                plot(
                    "Bytes",
                    "Bps",
                    "Bytes of these files.",
                    Query(_rate("kleinkram_upload_bytes_total", by="result"), "{{result}}"),
                ),
                plot(
                    "Uploads by state",
                    "none",
                    "Open ones hold a name in their mission.",
                    Query('max by (state) (kleinkram_uploads{state=~"open|completing"}) or vector(0)', "{{state}}"),
                ),
            ),
        ),
        Row(
            "Jobs",
            (
                plot("Oldest job", "s", "Age of the oldest job that waits, by queue.", _QUEUE_AGE),
                plot(
                    "Waiting jobs",
                    "none",
                    "By task.",
                    Query('max by (task) (kleinkram_jobs{status="todo"}) or vector(0)', "{{task}}"),
                    is_stacked=True,
                ),
                plot(
                    "Attempts",
                    "cps",
                    "By outcome: failed ones are tried again, given_up ones are not.",
                    Query(_rate("kleinkram_job_attempts_total", by="outcome"), "{{outcome}}"),
                ),
                plot(
                    "Attempts by task",
                    "cps",
                    "All outcomes.",
                    Query(_rate("kleinkram_job_attempts_total", by="task"), "{{task}}"),
                ),
                plot(
                    "Duration",
                    "s",
                    "95 % of attempts take no longer.",
                    Query(_quantile(0.95, "kleinkram_job_duration_seconds", by="task"), "{{task}}"),
                ),
                plot(
                    "Jobs that fail",
                    "none",
                    "Jobs that wait for another attempt, and those that failed permanently.",
                    Query("sum(max by (task) (kleinkram_jobs_retrying)) or vector(0)", "retrying"),
                    Query(_FAILED_JOBS, "failed permanently"),
                ),
            ),
        ),
        Row(
            "Workers",
            (
                plot(
                    "Running jobs",
                    "none",
                    "By process.",
                    Query("sum by (instance) (kleinkram_jobs_in_progress)", "{{instance}}"),
                ),
                plot(
                    "Reading from the store",
                    "Bps",
                    "Verification reads every byte; KLEINKRAM_VERIFY_BYTES_PER_S limits each process.",
                    Query(_rate("kleinkram_store_read_bytes_total", by="instance"), "{{instance}}"),
                ),
                plot(
                    "Content of files",
                    "none",
                    "What is known of recordings: pending ones have not been read yet.",
                    Query("max by (content) (kleinkram_blob_content)", "{{content}}"),
                ),
                log_lines(
                    "Failed attempts",
                    "Warnings and errors of workers, with the reason.",
                    '{service_name="kleinkram", role="worker", level=~"warning|error|critical"} | json',
                ),
                traces(
                    "Long jobs",
                    "Traces of jobs that took a minute or longer.",
                    '{ resource.service.name = "kleinkram-worker" && kind = consumer && duration > 1m }',
                ),
            ),
        ),
    ),
)

RUNS = Dashboard(
    "runs",
    "Kleinkram / Runs",
    "Runs of actions, and the runners that execute them.",
    (
        Row(
            "Runs",
            (
                plot("Runs", "none", "Runs that have not ended, by state.", _RUNS, is_stacked=True),
                plot(
                    "Oldest queued run",
                    "s",
                    "A run waits for a runner with its labels and enough resources.",
                    Query("max(kleinkram_runs_queued_oldest_seconds)", "oldest"),
                ),
                plot(
                    "Runs that ended",
                    "cps",
                    "By state.",
                    Query(_rate("kleinkram_runs_ended_total", by="state"), "{{state}}"),
                ),
                plot(
                    "Why runs failed",
                    "cps",
                    "By reason.",
                    Query(
                        _rare("kleinkram_runs_ended_total", by="reason", where='{state!="done"}'),
                        "{{reason}}",
                    ),
                ),
                plot(
                    "Waiting time",
                    "s",
                    "From the launch of a run to its claim.",
                    Query(_quantile(0.5, "kleinkram_run_wait_seconds"), "median"),
                    Query(_quantile(0.95, "kleinkram_run_wait_seconds"), "95 %"),
                ),
                plot(
                    "Duration",
                    "s",
                    "From the claim to the end; 95 % of runs take no longer.",
                    Query(_quantile(0.95, "kleinkram_run_duration_seconds", by="state"), "{{state}}"),
                ),
            ),
        ),
        Row(
            "Runners",
            (
                plot(
                    "Runners",
                    "none",
                    "Silent ones answered in the last 7 days, but do not now.",
                    Query("max by (state) (kleinkram_runners)", "{{state}}"),
                ),
                plot(
                    "Cores",
                    "none",
                    "What runs may use, and what is reserved.",
                    Query("sum by (kind) (kleinkram_runner_cores)", "{{kind}}"),
                ),
                plot(
                    "Memory",
                    "decbytes",
                    "What runs may use, and what is reserved.",
                    Query("sum by (kind) (kleinkram_runner_memory_bytes)", "{{kind}}"),
                ),
                plot(
                    "Free disk",
                    "decbytes",
                    "Where a runner's data directory is.",
                    Query("min by (instance) (kleinkram_runner_free_bytes)", "{{instance}}"),
                ),
                plot(
                    "Inputs",
                    "Bps",
                    "Bytes read from the store, and from the runner's cache.",
                    Query(_rare("kleinkram_runner_input_bytes_total", by="source"), "{{source}}"),
                ),
                plot(
                    "Since the last contact",
                    "s",
                    "Time since the server answered a runner.",
                    Query(
                        "time() - max by (instance) (kleinkram_runner_last_contact_timestamp_seconds)", "{{instance}}"
                    ),
                ),
            ),
        ),
        Row(
            "Details",
            (
                log_lines(
                    "Runners",
                    "Warnings and errors of runners.",
                    '{service_name="kleinkram", role="runner", level=~"warning|error|critical"} | json',
                ),
                traces(
                    "Long runs",
                    "Traces of runs that took a minute or longer.",
                    '{ resource.service.name = "kleinkram-runner" && duration > 1m }',
                ),
            ),
        ),
    ),
)

API = Dashboard(
    "api",
    "Kleinkram / API",
    "Requests: how many, how fast, and which fail. A click on a series opens its traces or log lines.",
    (
        Row(
            "Requests",
            (
                plot("By status", "reqps", "Requests per second.", _BY_STATUS),
                plot(
                    "By route",
                    "reqps",
                    "The ten most frequent.",
                    Query(f"topk(10, {_rate('kleinkram_requests_total', by='route')})", "{{route}}"),
                    links=_ROUTE_LINKS,
                ),
                plot(
                    "Time to answer by route",
                    "s",
                    "95 % of requests; the ten slowest routes.",
                    Query(
                        f"topk(10, {_quantile(0.95, 'kleinkram_request_duration_seconds', by='route')} > 0)",
                        "{{route}}",
                    ),
                    links=_ROUTE_LINKS,
                ),
                plot(
                    "Errors of the server",
                    "percentunit",
                    "Share of requests with a status of 500 or more.",
                    Query(
                        f"({_rare('kleinkram_requests_total', where=_FAILED)}) / {_rate('kleinkram_requests_total')}",
                        "errors",
                    ),
                ),
                plot(
                    "Problems",
                    "reqps",
                    "Answers that are problem documents, by code.",
                    Query(_rare("kleinkram_problems_total", by="code"), "{{code}}"),
                ),
                plot(
                    "Waiting clients",
                    "none",
                    "Open event streams, and requests that wait for an event.",
                    Query("sum(kleinkram_event_streams)", "event streams"),
                    Query("sum(kleinkram_long_polls)", "long polls"),
                ),
            ),
        ),
        Row(
            "Refusals",
            (
                plot(
                    "Refused sign-ins",
                    "cps",
                    "By reason.",
                    Query(_rare("kleinkram_sign_in_refusals_total", by="reason"), "{{reason}}"),
                ),
                plot(
                    "Rate limits",
                    "cps",
                    "Requests that a limit refused.",
                    Query(_rare("kleinkram_rate_limited_total", by="what"), "{{what}}"),
                ),
                plot(
                    "Change events",
                    "cps",
                    "Received from PostgreSQL, for open pages.",
                    Query(_rate("kleinkram_events_total", by="instance"), "{{instance}}"),
                ),
            ),
        ),
        Row(
            "Processes",
            (
                plot(
                    "CPU",
                    "percentunit",
                    "Share of one core.",
                    Query(
                        _rate("process_cpu_seconds_total", by="instance, job", where='{job=~"kleinkram-.*"}'),
                        "{{job}} {{instance}}",
                    ),
                ),
                plot(
                    "Memory",
                    "decbytes",
                    "Resident memory.",
                    Query(
                        'sum by (instance, job) (process_resident_memory_bytes{job=~"kleinkram-.*"})',
                        "{{job}} {{instance}}",
                    ),
                ),
                plot(
                    "Open files",
                    "percentunit",
                    "Share of the limit.",
                    Query(
                        'max by (instance, job) (process_open_fds{job=~"kleinkram-.*"} / process_max_fds)',
                        "{{job}} {{instance}}",
                    ),
                ),
                plot(
                    "Time since the start",
                    "s",
                    "It begins again when a process is restarted.",
                    Query(
                        'time() - max by (instance, job) (process_start_time_seconds{job=~"kleinkram-.*"})',
                        "{{job}} {{instance}}",
                    ),
                ),
                plot(
                    "Versions",
                    "none",
                    "Processes by role and version.",
                    Query("count by (role, version) (kleinkram_build_info)", "{{role}} {{version}}"),
                    is_stacked=True,
                ),
            ),
        ),
        Row(
            "Details",
            (
                log_lines("Failed requests", "With a status of 500 or more.", f"{_ANY_LINE} | json | status >= 500"),
                traces(
                    "Slow requests",
                    "Traces of requests that took a second or longer.",
                    '{ resource.service.name = "kleinkram-api" && kind = server && duration > 1s }',
                ),
            ),
        ),
    ),
)

DATABASE = Dashboard(
    "database",
    "Kleinkram / Database",
    "PostgreSQL, as the processes of Kleinkram see it.",
    (
        Row(
            "Server",
            (
                plot(
                    "Connections",
                    "none",
                    "Of all clients, and PostgreSQL's max_connections.",
                    Query("max(kleinkram_database_server_connections)", "open"),
                    Query("max(kleinkram_database_server_connections_max)", "max_connections"),
                ),
                plot("Size", "decbytes", "Size of the database.", Query("max(kleinkram_database_size_bytes)", "size")),
                plot(
                    "Clock",
                    "s",
                    "How far it is ahead of the server's.",
                    Query("max(kleinkram_database_clock_offset_seconds)", "offset"),
                ),
            ),
        ),
        Row(
            "Connection pools",
            (
                plot(
                    "Connections",
                    "none",
                    "Of each process, by state.",
                    Query("sum by (instance, state) (kleinkram_database_connections)", "{{instance}} {{state}}"),
                ),
                plot(
                    "Use",
                    "percentunit",
                    "Share of each pool that is in use.",
                    Query(
                        'max by (instance) (kleinkram_database_connections{state="in_use"}'
                        " / ignoring(state) kleinkram_database_connections_max)",
                        "{{instance}}",
                    ),
                ),
                plot(
                    "Waiting tasks",
                    "none",
                    "Requests and jobs that wait for a connection.",
                    Query("sum by (instance) (kleinkram_database_connections_waiting)", "{{instance}}"),
                ),
                plot(
                    "Time to get a connection",
                    "s",
                    "95 % of tasks wait no longer.",
                    Query(_quantile(0.95, "kleinkram_database_connection_wait_seconds", by="instance"), "{{instance}}"),
                ),
                plot(
                    "Listening for changes",
                    "none",
                    "1 while a process receives change events.",
                    Query("max by (instance) (kleinkram_event_listener_up)", "{{instance}}"),
                ),
                plot(
                    "Requests without a database",
                    "reqps",
                    "Answered with 503.",
                    Query(
                        _rare("kleinkram_problems_total", where='{code="database_unavailable"}'),
                        "database_unavailable",
                    ),
                ),
            ),
        ),
        Row(
            "Details",
            (log_lines("Lost connections", "Of workers and API.", f'{_ANY_LINE} |~ "{_LOST_CONNECTION}" | json'),),
        ),
    ),
)

DASHBOARDS = (OVERVIEW, STORAGE, INGEST, RUNS, API, DATABASE)
