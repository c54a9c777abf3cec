"""The data model: tables with their constraints and indexes. What the database can enforce, it enforces."""

from kleinkram.server.tables.base import metadata
from kleinkram.server.tables.blobs import blob, recording_preview, scrub, store_probe, topic, topic_name, upload
from kleinkram.server.tables.checks import check_acceptance, check_note, check_report, mission_checks, project_checks
from kleinkram.server.tables.mission_events import mission_event
from kleinkram.server.tables.missions import (
    DERIVED_ORIGIN,
    MAX_STORED_TOPICS,
    file,
    mission,
    mission_topic,
    mission_topics,
    project,
    recording,
)
from kleinkram.server.tables.operations import audit_event, audit_retention, backup_attempt, job_error, worker_process
from kleinkram.server.tables.people import (
    access_grant,
    access_group,
    affiliation,
    affiliation_domain,
    erasure,
    membership,
    person,
    person_email,
    session,
    share,
    share_file,
    token,
    token_limit,
)
from kleinkram.server.tables.runs import (
    action,
    action_version,
    automatic_run,
    log_chunk,
    project_action,
    project_action_mission,
    run,
    run_artifact,
    run_check,
    run_finding,
    run_input,
    run_log,
    run_metric,
    runner,
)
from kleinkram.server.tables.sign_in import (
    identity,
    login_request,
    oidc_login,
    one_time_code,
    password,
    rate_count,
    recovery_code,
    totp,
    used_logout_token,
)
from kleinkram.server.tables.viewer_layouts import viewer_layout
