"""The data model: one module a noun. Constraints and indexes stand here; what the database can hold, it holds."""

from kleinkram.server.tables.access_group import access_grant, access_group, affiliation, affiliation_domain, membership
from kleinkram.server.tables.action import action, action_version
from kleinkram.server.tables.audit_event import audit_event
from kleinkram.server.tables.base import metadata
from kleinkram.server.tables.blob import blob, topic, topic_name
from kleinkram.server.tables.file import file, recording
from kleinkram.server.tables.job_error import job_error
from kleinkram.server.tables.mission import mission
from kleinkram.server.tables.mission_topic import MOST_KEPT_TOPICS, mission_topic, mission_topics
from kleinkram.server.tables.person import person, person_email, session, token, token_limit
from kleinkram.server.tables.project import project
from kleinkram.server.tables.run import log_chunk, run, run_artifact, run_finding, run_input, run_metric
from kleinkram.server.tables.runner import runner
from kleinkram.server.tables.scrub import scrub
from kleinkram.server.tables.share import share, share_file
from kleinkram.server.tables.signing_in import (
    identity,
    login_request,
    oidc_login,
    one_time_code,
    password,
    rate_count,
    recovery_code,
    totp,
)
from kleinkram.server.tables.store_probe import store_probe
from kleinkram.server.tables.upload import upload
from kleinkram.server.tables.worker_process import worker_process

__all__ = [
    "MOST_KEPT_TOPICS",
    "access_grant",
    "access_group",
    "action",
    "action_version",
    "affiliation",
    "affiliation_domain",
    "audit_event",
    "blob",
    "file",
    "identity",
    "job_error",
    "log_chunk",
    "login_request",
    "membership",
    "metadata",
    "mission",
    "mission_topic",
    "mission_topics",
    "oidc_login",
    "one_time_code",
    "password",
    "person",
    "person_email",
    "project",
    "rate_count",
    "recording",
    "recovery_code",
    "run",
    "run_artifact",
    "run_finding",
    "run_input",
    "run_metric",
    "runner",
    "scrub",
    "session",
    "share",
    "share_file",
    "store_probe",
    "token",
    "token_limit",
    "topic",
    "topic_name",
    "totp",
    "upload",
    "worker_process",
]
