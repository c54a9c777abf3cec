-- The schema of the first version: tables, indexes, triggers, the job queue's additions and rows that must exist.
-- Tables and columns repeat src/kleinkram/server/tables; tests/integration/test_migrations.py compares the two.
-- Two storage parameters stand only here:
--   autovacuum_analyze_threshold = 0: the planner learns about small tables at once, not after fifty new rows.
--   gin_pending_list_limit = 256: each lookup reads the whole pending list; at the default of 4 MB that takes up to 15 ms.

CREATE EXTENSION IF NOT EXISTS pg_trgm;

-- array_to_string, declared immutable because an index requires it.
CREATE FUNCTION joined(labels text[]) RETURNS text LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
  RETURN array_to_string(labels, E'\n');

CREATE TABLE job_error (
    job_id bigint CONSTRAINT pk_job_error PRIMARY KEY,
    sentence text NOT NULL
);

CREATE TABLE person (
    id uuid CONSTRAINT pk_person PRIMARY KEY,
    name text NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    deactivated_at timestamptz
) WITH (autovacuum_analyze_threshold = 0);

CREATE UNLOGGED TABLE rate_count (
    key text COLLATE "C" NOT NULL,
    window_start timestamptz NOT NULL,
    count integer NOT NULL,
    CONSTRAINT pk_rate_count PRIMARY KEY (key, window_start)
);
CREATE INDEX ix_rate_count_window_start ON rate_count (window_start);

CREATE TABLE store_probe (
    store_id text CONSTRAINT pk_store_probe PRIMARY KEY,
    checksum text NOT NULL,
    writes_once boolean NOT NULL,
    probed_at timestamptz NOT NULL DEFAULT now(),
    CONSTRAINT ck_store_probe_checksum CHECK (checksum IN ('crc64nvme', 'sha256', 'md5'))
);

CREATE TABLE topic_name (
    name text COLLATE "C" CONSTRAINT pk_topic_name PRIMARY KEY
);
CREATE INDEX ix_topic_name_words ON topic_name USING gin (name gin_trgm_ops) WITH (gin_pending_list_limit = 256);

CREATE TABLE worker_process (
    id uuid CONSTRAINT pk_worker_process PRIMARY KEY,
    host text NOT NULL,
    pid integer NOT NULL,
    version text NOT NULL,
    started_at timestamptz NOT NULL DEFAULT now(),
    seen_at timestamptz NOT NULL DEFAULT now(),
    ended_at timestamptz
);

CREATE TABLE access_group (
    id uuid CONSTRAINT pk_access_group PRIMARY KEY,
    kind text NOT NULL,
    name text COLLATE "C" NOT NULL,
    name_key text COLLATE "C" NOT NULL,
    person_id uuid CONSTRAINT fk_access_group_person_id_person REFERENCES person (id),
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid CONSTRAINT fk_access_group_created_by_id_person REFERENCES person (id),
    CONSTRAINT uq_access_group_person_id UNIQUE (person_id),
    CONSTRAINT ck_access_group_kind CHECK (kind IN ('person', 'email', 'custom', 'affiliation', 'admins')),
    CONSTRAINT ck_access_group_person CHECK ((kind = 'person') = (person_id IS NOT NULL))
) WITH (autovacuum_analyze_threshold = 0);
CREATE UNIQUE INDEX uq_access_group_email ON access_group (name_key) WHERE kind = 'email';
CREATE UNIQUE INDEX uq_access_group_name ON access_group (name_key) WHERE kind IN ('custom', 'affiliation', 'admins');

CREATE TABLE blob (
    id uuid CONSTRAINT pk_blob PRIMARY KEY,
    store_id text NOT NULL DEFAULT 'main',
    key text NOT NULL,
    size_bytes bigint NOT NULL,
    crc64nvme bytea,
    sha256 bytea NOT NULL,
    md5 bytea,
    state text NOT NULL DEFAULT 'stored',
    state_reason text,
    verified_at timestamptz,
    damaged_at timestamptz,
    uploaded_by_id uuid NOT NULL CONSTRAINT fk_blob_uploaded_by_id_person REFERENCES person (id),
    created_at timestamptz NOT NULL DEFAULT now(),
    marked_for_deletion_at timestamptz,
    content text NOT NULL DEFAULT 'pending',
    content_reason text,
    format text,
    message_count bigint,
    start_ns bigint,
    end_ns bigint,
    compression text[] NOT NULL DEFAULT '{}',
    problems jsonb NOT NULL DEFAULT '[]',
    depth text,
    lost jsonb,
    facts jsonb NOT NULL DEFAULT '[]',
    summarised_at timestamptz,
    CONSTRAINT uq_blob_store_id_key UNIQUE (store_id, key),
    CONSTRAINT ck_blob_content CHECK (content IN ('pending', 'indexed', 'recovered', 'broken', 'opaque', 'error')),
    CONSTRAINT ck_blob_crc64nvme CHECK (octet_length(crc64nvme) = 8),
    CONSTRAINT ck_blob_depth CHECK (depth IN ('summary', 'scan')),
    CONSTRAINT ck_blob_md5 CHECK (octet_length(md5) = 16),
    CONSTRAINT ck_blob_verified CHECK (state <> 'verified' OR (md5 IS NOT NULL AND verified_at IS NOT NULL)),
    CONSTRAINT ck_blob_sha256 CHECK (octet_length(sha256) = 32),
    CONSTRAINT ck_blob_size_bytes CHECK (size_bytes >= 0),
    CONSTRAINT ck_blob_span CHECK (start_ns <= end_ns),
    CONSTRAINT ck_blob_state CHECK (state IN ('stored', 'verified', 'lost', 'corrupt'))
);
CREATE INDEX ix_blob_damaged ON blob (id) WHERE state IN ('corrupt', 'lost') OR content IN ('broken', 'recovered', 'error');
CREATE INDEX ix_blob_marked_for_deletion ON blob (marked_for_deletion_at) WHERE marked_for_deletion_at IS NOT NULL;
CREATE INDEX ix_blob_duration ON blob ((end_ns::numeric - start_ns::numeric));
CREATE INDEX ix_blob_key ON blob (store_id, key text_pattern_ops);
CREATE INDEX ix_blob_verified_at ON blob (verified_at) WHERE state = 'verified' AND marked_for_deletion_at IS NULL;
CREATE INDEX ix_blob_size_sha256 ON blob (size_bytes, sha256) WHERE marked_for_deletion_at IS NULL;
CREATE INDEX ix_blob_unverified ON blob (created_at) WHERE state = 'stored' AND marked_for_deletion_at IS NULL;

CREATE TABLE identity (
    id uuid CONSTRAINT pk_identity PRIMARY KEY,
    person_id uuid NOT NULL CONSTRAINT fk_identity_person_id_person REFERENCES person (id),
    issuer text NOT NULL,
    subject text NOT NULL,
    email text,
    created_at timestamptz NOT NULL DEFAULT now(),
    last_used_at timestamptz NOT NULL DEFAULT now(),
    unlinked_at timestamptz,
    CONSTRAINT uq_identity_issuer_subject UNIQUE (issuer, subject)
);
CREATE INDEX ix_identity_person_id ON identity (person_id);

CREATE TABLE one_time_code (
    id uuid CONSTRAINT pk_one_time_code PRIMARY KEY,
    purpose text NOT NULL,
    secret_sha256 bytea NOT NULL,
    person_id uuid CONSTRAINT fk_one_time_code_person_id_person REFERENCES person (id),
    email text,
    name text,
    created_by_id uuid CONSTRAINT fk_one_time_code_created_by_id_person REFERENCES person (id),
    created_at timestamptz NOT NULL DEFAULT now(),
    expires_at timestamptz NOT NULL,
    used_at timestamptz,
    CONSTRAINT uq_one_time_code_secret_sha256 UNIQUE (secret_sha256),
    CONSTRAINT ck_one_time_code_email CHECK ((purpose = 'invitation') = (email IS NOT NULL)),
    CONSTRAINT ck_one_time_code_person CHECK ((purpose IN ('owner', 'reset')) = (person_id IS NOT NULL)),
    CONSTRAINT ck_one_time_code_purpose CHECK (purpose IN ('bootstrap', 'owner', 'invitation', 'reset')),
    CONSTRAINT ck_one_time_code_secret_sha256 CHECK (octet_length(secret_sha256) = 32)
);
CREATE INDEX ix_one_time_code_person_id ON one_time_code (person_id);

CREATE TABLE password (
    person_id uuid CONSTRAINT pk_password PRIMARY KEY CONSTRAINT fk_password_person_id_person REFERENCES person (id),
    hash text NOT NULL,
    changed_at timestamptz NOT NULL DEFAULT now(),
    CONSTRAINT ck_password_hash CHECK (hash LIKE '$argon2id$%')
);

CREATE TABLE person_email (
    email_key text COLLATE "C" CONSTRAINT pk_person_email PRIMARY KEY,
    email text NOT NULL,
    person_id uuid NOT NULL CONSTRAINT fk_person_email_person_id_person REFERENCES person (id),
    verified_at timestamptz,
    verified_by text,
    CONSTRAINT ck_person_email_verified CHECK ((verified_at IS NULL) = (verified_by IS NULL))
);
CREATE INDEX ix_person_email_person_id ON person_email (person_id);

CREATE TABLE project (
    id uuid CONSTRAINT pk_project PRIMARY KEY,
    name text COLLATE "C" NOT NULL,
    name_key text COLLATE "C" NOT NULL,
    description text NOT NULL DEFAULT '',
    metadata_fields jsonb NOT NULL,
    is_public boolean NOT NULL DEFAULT false,
    licence text NOT NULL DEFAULT '',
    citation text NOT NULL DEFAULT '',
    quota_bytes bigint,
    quota_files bigint,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_project_created_by_id_person REFERENCES person (id),
    deleted_at timestamptz,
    deleted_by_id uuid CONSTRAINT fk_project_deleted_by_id_person REFERENCES person (id),
    CONSTRAINT ck_project_deleted CHECK ((deleted_at IS NULL) = (deleted_by_id IS NULL)),
    CONSTRAINT ck_project_name_length CHECK (char_length(name) BETWEEN 1 AND 128),
    CONSTRAINT ck_project_quota CHECK (quota_bytes >= 0 AND quota_files >= 0)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_project_created_at ON project (created_at, id);
CREATE INDEX ix_project_name ON project (name);
CREATE INDEX ix_project_public ON project (id) WHERE is_public;
CREATE UNIQUE INDEX uq_project_name_key_live ON project (name_key) WHERE deleted_at IS NULL;

CREATE TABLE runner (
    id uuid CONSTRAINT pk_runner PRIMARY KEY,
    person_id uuid NOT NULL CONSTRAINT fk_runner_person_id_person REFERENCES person (id),
    token_id uuid,
    name text NOT NULL,
    labels text[] NOT NULL DEFAULT '{}',
    capacity jsonb NOT NULL,
    abilities jsonb NOT NULL,
    default_image text,
    version text NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    last_seen_at timestamptz NOT NULL DEFAULT now()
);
CREATE INDEX ix_runner_person_id ON runner (person_id);

CREATE TABLE scrub (
    id uuid CONSTRAINT pk_scrub PRIMARY KEY,
    store_id text NOT NULL,
    requested_by_id uuid CONSTRAINT fk_scrub_requested_by_id_person REFERENCES person (id),
    accept_losses boolean NOT NULL DEFAULT false,
    created_at timestamptz NOT NULL DEFAULT now(),
    started_at timestamptz,
    seen_at timestamptz NOT NULL DEFAULT now(),
    ended_at timestamptz,
    aborted_reason text,
    compared bigint NOT NULL DEFAULT '0',
    compared_bytes bigint NOT NULL DEFAULT '0',
    lost bigint NOT NULL DEFAULT '0',
    corrupt bigint NOT NULL DEFAULT '0',
    recovered bigint NOT NULL DEFAULT '0',
    unknown bigint NOT NULL DEFAULT '0',
    CONSTRAINT ck_scrub_aborted CHECK (aborted_reason IS NULL OR ended_at IS NOT NULL)
);
CREATE INDEX ix_scrub_created_at ON scrub (store_id, created_at);

CREATE TABLE session (
    id uuid CONSTRAINT pk_session PRIMARY KEY,
    person_id uuid NOT NULL CONSTRAINT fk_session_person_id_person REFERENCES person (id),
    secret_sha256 bytea NOT NULL,
    method text NOT NULL,
    address text,
    user_agent text,
    created_at timestamptz NOT NULL DEFAULT now(),
    last_used_at timestamptz NOT NULL DEFAULT now(),
    expires_at timestamptz NOT NULL,
    revoked_at timestamptz,
    authenticated_at timestamptz NOT NULL DEFAULT now(),
    CONSTRAINT uq_session_secret_sha256 UNIQUE (secret_sha256),
    CONSTRAINT ck_session_secret_sha256 CHECK (octet_length(secret_sha256) = 32)
);
CREATE INDEX ix_session_person_id ON session (person_id);

CREATE TABLE totp (
    person_id uuid CONSTRAINT pk_totp PRIMARY KEY CONSTRAINT fk_totp_person_id_person REFERENCES person (id),
    secret text NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    confirmed_at timestamptz,
    last_step bigint NOT NULL DEFAULT '0',
    failed_count integer NOT NULL DEFAULT '0',
    failed_at timestamptz
);

CREATE TABLE action (
    id uuid CONSTRAINT pk_action PRIMARY KEY,
    project_id uuid CONSTRAINT fk_action_project_id_project REFERENCES project (id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    name_key text COLLATE "C" NOT NULL,
    created_by_id uuid NOT NULL CONSTRAINT fk_action_created_by_id_person REFERENCES person (id),
    created_at timestamptz NOT NULL DEFAULT now(),
    archived_at timestamptz
);
CREATE INDEX ix_action_name ON action (name, id);
CREATE UNIQUE INDEX uq_action_name_key_live ON action (project_id, name_key) NULLS NOT DISTINCT WHERE archived_at IS NULL;

CREATE TABLE affiliation (
    group_id uuid CONSTRAINT pk_affiliation PRIMARY KEY CONSTRAINT fk_affiliation_group_id_access_group REFERENCES access_group (id) ON DELETE CASCADE,
    default_level smallint,
    CONSTRAINT ck_affiliation_default_level CHECK (default_level BETWEEN 1 AND 4)
);

CREATE TABLE login_request (
    id uuid CONSTRAINT pk_login_request PRIMARY KEY,
    kind text NOT NULL,
    secret_sha256 bytea NOT NULL,
    label text COLLATE "C" NOT NULL,
    address text,
    user_code text,
    code_challenge text,
    port integer,
    created_at timestamptz NOT NULL DEFAULT now(),
    expires_at timestamptz NOT NULL,
    polled_at timestamptz,
    approved_at timestamptz,
    approved_by_id uuid CONSTRAINT fk_login_request_approved_by_id_person REFERENCES person (id),
    approved_session_id uuid CONSTRAINT fk_login_request_approved_session_id_session REFERENCES session (id),
    denied_at timestamptz,
    redeemed_at timestamptz,
    CONSTRAINT uq_login_request_secret_sha256 UNIQUE (secret_sha256),
    CONSTRAINT ck_login_request_approved CHECK ((approved_at IS NULL) = (approved_by_id IS NULL)),
    CONSTRAINT ck_login_request_decided CHECK (approved_at IS NULL OR denied_at IS NULL),
    CONSTRAINT ck_login_request_kind CHECK (kind IN ('loopback', 'device')),
    CONSTRAINT ck_login_request_loopback CHECK ((kind = 'loopback') = (code_challenge IS NOT NULL AND port IS NOT NULL)),
    CONSTRAINT ck_login_request_redeemed CHECK (redeemed_at IS NULL OR approved_at IS NOT NULL),
    CONSTRAINT ck_login_request_secret_sha256 CHECK (octet_length(secret_sha256) = 32),
    CONSTRAINT ck_login_request_user_code CHECK ((kind = 'device') = (user_code IS NOT NULL))
);
CREATE INDEX ix_login_request_expires_at ON login_request (expires_at);
CREATE UNIQUE INDEX uq_login_request_user_code ON login_request (user_code) WHERE redeemed_at IS NULL AND denied_at IS NULL;

CREATE TABLE membership (
    group_id uuid NOT NULL CONSTRAINT fk_membership_group_id_access_group REFERENCES access_group (id) ON DELETE CASCADE,
    person_id uuid NOT NULL CONSTRAINT fk_membership_person_id_person REFERENCES person (id),
    is_editor boolean NOT NULL DEFAULT false,
    expires_at timestamptz,
    created_at timestamptz NOT NULL DEFAULT now(),
    added_by_id uuid CONSTRAINT fk_membership_added_by_id_person REFERENCES person (id),
    CONSTRAINT pk_membership PRIMARY KEY (group_id, person_id)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_membership_person_id ON membership (person_id, group_id);

CREATE TABLE mission (
    id uuid CONSTRAINT pk_mission PRIMARY KEY,
    project_id uuid NOT NULL CONSTRAINT fk_mission_project_id_project REFERENCES project (id),
    name text COLLATE "C" NOT NULL,
    name_key text COLLATE "C" NOT NULL,
    metadata jsonb NOT NULL,
    metadata_yaml text,
    metadata_problems jsonb NOT NULL DEFAULT '[]',
    notes text NOT NULL DEFAULT '',
    completed_at timestamptz,
    start_ns bigint,
    end_ns bigint,
    files_revision bigint NOT NULL DEFAULT '0',
    derived_revision bigint NOT NULL DEFAULT '0',
    file_count integer,
    size_bytes numeric,
    message_count numeric,
    unread_count integer,
    duration_ns numeric,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_mission_created_by_id_person REFERENCES person (id),
    deleted_at timestamptz,
    deleted_by_id uuid CONSTRAINT fk_mission_deleted_by_id_person REFERENCES person (id),
    CONSTRAINT ck_mission_deleted CHECK ((deleted_at IS NULL) = (deleted_by_id IS NULL)),
    CONSTRAINT ck_mission_metadata CHECK (jsonb_typeof(metadata) = 'object'),
    CONSTRAINT ck_mission_name_length CHECK (char_length(name) BETWEEN 1 AND 128),
    CONSTRAINT ck_mission_span CHECK ((start_ns IS NULL) = (end_ns IS NULL) AND start_ns <= end_ns)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_mission_amounts ON mission (project_id) INCLUDE (id, file_count, size_bytes, duration_ns) WHERE deleted_at IS NULL;
CREATE INDEX ix_mission_start_order ON mission (coalesce(start_ns, '-9223372036854775808'::bigint), id);
CREATE INDEX ix_mission_created_at ON mission (created_at, id);
CREATE INDEX ix_mission_metadata ON mission USING gin (metadata jsonb_path_ops) WITH (gin_pending_list_limit = 256);
CREATE INDEX ix_mission_metadata_words ON mission USING gin ((metadata::text) gin_trgm_ops) WITH (gin_pending_list_limit = 256);
CREATE INDEX ix_mission_name ON mission (name, id);
CREATE INDEX ix_mission_name_words ON mission USING gin (name_key gin_trgm_ops) WITH (gin_pending_list_limit = 256);
CREATE INDEX ix_mission_note_words ON mission USING gin (notes gin_trgm_ops) WITH (gin_pending_list_limit = 256);
CREATE INDEX ix_mission_start_ns ON mission (start_ns, id);
CREATE UNIQUE INDEX uq_mission_name_key_live ON mission (project_id, name_key) INCLUDE (id) WHERE deleted_at IS NULL;

CREATE TABLE oidc_login (
    state_sha256 bytea CONSTRAINT pk_oidc_login PRIMARY KEY,
    provider text NOT NULL,
    nonce text NOT NULL,
    code_verifier text NOT NULL,
    browser_sha256 bytea NOT NULL,
    session_id uuid CONSTRAINT fk_oidc_login_session_id_session REFERENCES session (id),
    reauthenticates boolean NOT NULL DEFAULT false,
    return_to text NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    expires_at timestamptz NOT NULL,
    CONSTRAINT ck_oidc_login_sha256 CHECK (octet_length(state_sha256) = 32 AND octet_length(browser_sha256) = 32)
);
CREATE INDEX ix_oidc_login_expires_at ON oidc_login (expires_at);

CREATE TABLE recovery_code (
    secret_sha256 bytea CONSTRAINT pk_recovery_code PRIMARY KEY,
    person_id uuid NOT NULL CONSTRAINT fk_recovery_code_person_id_totp REFERENCES totp (person_id) ON DELETE CASCADE,
    CONSTRAINT ck_recovery_code_secret_sha256 CHECK (octet_length(secret_sha256) = 32)
);
CREATE INDEX ix_recovery_code_person_id ON recovery_code (person_id);

CREATE TABLE topic (
    id bigint GENERATED ALWAYS AS IDENTITY CONSTRAINT pk_topic PRIMARY KEY,
    blob_id uuid NOT NULL CONSTRAINT fk_topic_blob_id_blob REFERENCES blob (id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    message_type text COLLATE "C",
    schema_name text,
    schema_encoding text,
    message_encoding text,
    count bigint,
    first_ns bigint,
    last_ns bigint,
    rate_hz double precision,
    longest_gap_ns bigint,
    head_gap_ns bigint,
    tail_gap_ns bigint,
    out_of_order_count bigint,
    stored_bytes bigint,
    density bytea,
    CONSTRAINT uq_topic_blob_id_name_message_type UNIQUE NULLS NOT DISTINCT (blob_id, name, message_type)
);
CREATE INDEX ix_topic_message_type ON topic (message_type, blob_id);
CREATE INDEX ix_topic_name ON topic (name, blob_id);

CREATE TABLE access_grant (
    id uuid CONSTRAINT pk_access_grant PRIMARY KEY,
    group_id uuid NOT NULL CONSTRAINT fk_access_grant_group_id_access_group REFERENCES access_group (id) ON DELETE CASCADE,
    project_id uuid CONSTRAINT fk_access_grant_project_id_project REFERENCES project (id) ON DELETE CASCADE,
    mission_id uuid CONSTRAINT fk_access_grant_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    level smallint NOT NULL,
    expires_at timestamptz,
    created_at timestamptz NOT NULL DEFAULT now(),
    granted_by_id uuid CONSTRAINT fk_access_grant_granted_by_id_person REFERENCES person (id),
    CONSTRAINT ck_access_grant_level CHECK (level BETWEEN 1 AND 4),
    CONSTRAINT ck_access_grant_resource CHECK (num_nonnulls(project_id, mission_id) = 1)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_access_grant_group_id ON access_grant (group_id) INCLUDE (project_id, mission_id, level, expires_at);
CREATE INDEX ix_access_grant_missions ON access_grant (group_id) INCLUDE (mission_id, level, expires_at) WHERE mission_id IS NOT NULL;
CREATE INDEX ix_access_grant_projects ON access_grant (group_id) INCLUDE (project_id, level, expires_at) WHERE project_id IS NOT NULL;
CREATE UNIQUE INDEX uq_access_grant_mission ON access_grant (mission_id, group_id) INCLUDE (level, expires_at);
CREATE UNIQUE INDEX uq_access_grant_project ON access_grant (project_id, group_id) INCLUDE (level, expires_at);

CREATE TABLE action_version (
    id uuid CONSTRAINT pk_action_version PRIMARY KEY,
    action_id uuid CONSTRAINT fk_action_version_action_id_action REFERENCES action (id) ON DELETE CASCADE,
    number integer,
    definition jsonb NOT NULL,
    definition_sha256 bytea NOT NULL,
    image_digest text,
    created_by_id uuid NOT NULL CONSTRAINT fk_action_version_created_by_id_person REFERENCES person (id),
    created_at timestamptz NOT NULL DEFAULT now(),
    CONSTRAINT uq_action_version_action_id_number UNIQUE (action_id, number),
    CONSTRAINT ck_action_version_published CHECK ((action_id IS NULL) = (number IS NULL))
);
CREATE UNIQUE INDEX uq_action_version_unpublished ON action_version (definition_sha256) WHERE action_id IS NULL;

CREATE TABLE affiliation_domain (
    domain text COLLATE "C" NOT NULL,
    group_id uuid NOT NULL CONSTRAINT fk_affiliation_domain_group_id_affiliation REFERENCES affiliation (group_id) ON DELETE CASCADE,
    CONSTRAINT pk_affiliation_domain PRIMARY KEY (domain, group_id)
);

CREATE TABLE mission_topics (
    mission_id uuid CONSTRAINT pk_mission_topics PRIMARY KEY CONSTRAINT fk_mission_topics_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    revision bigint NOT NULL,
    recording_ids uuid[] NOT NULL,
    bin_ns bigint NOT NULL
);

CREATE TABLE recording (
    id uuid CONSTRAINT pk_recording PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_recording_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    kind text NOT NULL,
    missing text[] NOT NULL DEFAULT '{}',
    unlisted text[] NOT NULL DEFAULT '{}',
    problems jsonb NOT NULL DEFAULT '[]',
    message_count bigint,
    start_ns bigint,
    end_ns bigint,
    content text NOT NULL DEFAULT 'pending',
    content_reason text,
    lost jsonb,
    CONSTRAINT uq_recording_mission_id_name_kind UNIQUE (mission_id, name, kind),
    CONSTRAINT ck_recording_content CHECK (content IN ('pending', 'indexed', 'recovered', 'broken', 'opaque', 'error')),
    CONSTRAINT ck_recording_span CHECK (start_ns <= end_ns)
);

CREATE TABLE share (
    id uuid CONSTRAINT pk_share PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_share_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    name text NOT NULL,
    is_whole_mission boolean NOT NULL,
    prefix text NOT NULL,
    secret_sha256 bytea NOT NULL,
    created_by_id uuid NOT NULL CONSTRAINT fk_share_created_by_id_person REFERENCES person (id),
    created_at timestamptz NOT NULL DEFAULT now(),
    expires_at timestamptz NOT NULL,
    revoked_at timestamptz,
    last_used_at timestamptz,
    download_count bigint NOT NULL DEFAULT '0',
    download_bytes bigint NOT NULL DEFAULT '0',
    CONSTRAINT uq_share_secret_sha256 UNIQUE (secret_sha256),
    CONSTRAINT ck_share_secret_sha256 CHECK (octet_length(secret_sha256) = 32)
);
CREATE INDEX ix_share_mission_id ON share (mission_id);

CREATE TABLE file (
    id uuid CONSTRAINT pk_file PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_file_mission_id_mission REFERENCES mission (id),
    recording_id uuid CONSTRAINT fk_file_recording_id_recording REFERENCES recording (id) ON DELETE SET NULL,
    blob_id uuid NOT NULL CONSTRAINT fk_file_blob_id_blob REFERENCES blob (id),
    start_ns bigint,
    path text COLLATE "C" NOT NULL,
    path_key text COLLATE "C" NOT NULL,
    origin text NOT NULL,
    uploaded_by_id uuid NOT NULL CONSTRAINT fk_file_uploaded_by_id_person REFERENCES person (id),
    labels text[] NOT NULL DEFAULT '{}',
    created_at timestamptz NOT NULL DEFAULT now(),
    deleted_at timestamptz,
    deleted_by_id uuid CONSTRAINT fk_file_deleted_by_id_person REFERENCES person (id),
    CONSTRAINT ck_file_deleted CHECK ((deleted_at IS NULL) = (deleted_by_id IS NULL)),
    CONSTRAINT ck_file_origin CHECK (origin IN ('upload', 'link', 'run')),
    CONSTRAINT ck_file_path_length CHECK (char_length(path) BETWEEN 1 AND 1024)
);
CREATE INDEX ix_file_start_order ON file (coalesce(start_ns, '-9223372036854775808'::bigint), id) INCLUDE (start_ns, blob_id, mission_id) WHERE deleted_at IS NULL;
CREATE INDEX ix_file_blob_id ON file (blob_id);
CREATE INDEX ix_file_created_at ON file (created_at, id);
CREATE INDEX ix_file_deleted_at ON file (deleted_at) WHERE deleted_at IS NOT NULL;
CREATE INDEX ix_file_label_words ON file USING gin (joined(labels) gin_trgm_ops) WITH (gin_pending_list_limit = 256);
CREATE INDEX ix_file_labels ON file USING gin (labels) WITH (gin_pending_list_limit = 256);
CREATE INDEX ix_file_path ON file (mission_id, path, id);
CREATE INDEX ix_file_recording_id ON file (recording_id);
CREATE INDEX ix_file_words_timed ON file USING gin (path_key gin_trgm_ops) WITH (gin_pending_list_limit = 256) WHERE start_ns IS NOT NULL;
CREATE INDEX ix_file_words_untimed ON file USING gin (path_key gin_trgm_ops) WITH (gin_pending_list_limit = 256) WHERE start_ns IS NULL;
CREATE UNIQUE INDEX uq_file_path_key_live ON file (mission_id, path_key) WHERE deleted_at IS NULL;

CREATE TABLE mission_topic (
    id bigint GENERATED ALWAYS AS IDENTITY CONSTRAINT pk_mission_topic PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_mission_topic_mission_id_mission_topics REFERENCES mission_topics (mission_id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    message_type text COLLATE "C",
    count bigint,
    file_count integer NOT NULL,
    recording_count integer NOT NULL,
    recording_ranges integer[] NOT NULL,
    first_ns bigint,
    last_ns bigint,
    rate_hz double precision,
    longest_gap_ns bigint,
    stored_bytes bigint,
    density bytea,
    CONSTRAINT uq_mission_topic_mission_id_name_message_type UNIQUE NULLS NOT DISTINCT (mission_id, name, message_type)
);

CREATE TABLE run (
    id uuid CONSTRAINT pk_run PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_run_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    version_id uuid NOT NULL CONSTRAINT fk_run_version_id_action_version REFERENCES action_version (id),
    parameters jsonb NOT NULL,
    network text NOT NULL,
    cores double precision NOT NULL,
    memory_bytes bigint NOT NULL,
    disk_bytes bigint NOT NULL,
    gpus integer NOT NULL,
    labels text[] NOT NULL DEFAULT '{}',
    needs_images boolean NOT NULL,
    state text NOT NULL DEFAULT 'queued',
    reason text,
    message text NOT NULL DEFAULT '',
    exit_code integer,
    image_digest text,
    inputs_fingerprint bytea NOT NULL,
    reuses_id uuid CONSTRAINT fk_run_reuses_id_run REFERENCES run (id) ON DELETE SET NULL,
    retry_of_id uuid CONSTRAINT fk_run_retry_of_id_run REFERENCES run (id) ON DELETE SET NULL,
    started_by_id uuid NOT NULL CONSTRAINT fk_run_started_by_id_person REFERENCES person (id),
    attempt integer NOT NULL DEFAULT '0',
    lost_count integer NOT NULL DEFAULT '0',
    runner_id uuid CONSTRAINT fk_run_runner_id_runner REFERENCES runner (id),
    lease_ends_at timestamptz,
    progress jsonb,
    usage jsonb,
    samples jsonb NOT NULL DEFAULT '[]',
    problems jsonb NOT NULL DEFAULT '[]',
    proposed jsonb NOT NULL DEFAULT '{}',
    previews jsonb NOT NULL DEFAULT '[]',
    input_count integer NOT NULL,
    input_bytes bigint NOT NULL,
    artifact_count integer NOT NULL DEFAULT '0',
    metric_count integer NOT NULL DEFAULT '0',
    finding_counts jsonb NOT NULL DEFAULT '{}',
    log_blob_id uuid CONSTRAINT fk_run_log_blob_id_blob REFERENCES blob (id),
    created_at timestamptz NOT NULL DEFAULT now(),
    claimed_at timestamptz,
    started_at timestamptz,
    ended_at timestamptz,
    cancel_requested_at timestamptz,
    CONSTRAINT ck_run_ended CHECK ((ended_at IS NULL) = (state IN ('queued', 'preparing', 'running', 'collecting'))),
    CONSTRAINT ck_run_assigned CHECK ((lease_ends_at IS NOT NULL) = (state IN ('preparing', 'running', 'collecting')) AND (state NOT IN ('preparing', 'running', 'collecting') OR runner_id IS NOT NULL)),
    CONSTRAINT ck_run_network CHECK (network IN ('none', 'api', 'open')),
    CONSTRAINT ck_run_reason CHECK (reason IN ('done', 'exit_code', 'signal', 'memory', 'time', 'disk', 'cancelled', 'command_not_found', 'image_unavailable', 'not_possible', 'inputs_unavailable', 'broken_report', 'results_not_stored', 'lost')),
    CONSTRAINT ck_run_state CHECK (state IN ('queued', 'preparing', 'running', 'collecting', 'done', 'failed', 'cancelled'))
);
CREATE INDEX ix_run_created_at ON run (created_at, id);
CREATE INDEX ix_run_inputs ON run (inputs_fingerprint) WHERE state = 'done';
CREATE INDEX ix_run_lease_ends_at ON run (lease_ends_at) WHERE state IN ('preparing', 'running', 'collecting');
CREATE INDEX ix_run_log_blob_id ON run (log_blob_id);
CREATE INDEX ix_run_mission_id ON run (mission_id, created_at);
CREATE INDEX ix_run_queue ON run (created_at, id) WHERE state = 'queued';
CREATE INDEX ix_run_retry_of_id ON run (retry_of_id);
CREATE INDEX ix_run_reuses_id ON run (reuses_id);
CREATE INDEX ix_run_runner_id ON run (runner_id);
CREATE INDEX ix_run_started_by_id ON run (started_by_id);
CREATE INDEX ix_run_version_id ON run (version_id);

CREATE TABLE log_chunk (
    key text CONSTRAINT pk_log_chunk PRIMARY KEY,
    store_id text NOT NULL DEFAULT 'main',
    run_id uuid CONSTRAINT fk_log_chunk_run_id_run REFERENCES run (id) ON DELETE SET NULL,
    attempt integer NOT NULL,
    offset_bytes bigint NOT NULL,
    size_bytes bigint NOT NULL,
    confirmed_at timestamptz,
    created_at timestamptz NOT NULL DEFAULT now()
);
CREATE INDEX ix_log_chunk_run_id ON log_chunk (run_id, attempt, offset_bytes);

CREATE TABLE run_artifact (
    id uuid CONSTRAINT pk_run_artifact PRIMARY KEY,
    run_id uuid NOT NULL CONSTRAINT fk_run_artifact_run_id_run REFERENCES run (id) ON DELETE CASCADE,
    path text COLLATE "C" NOT NULL,
    blob_id uuid NOT NULL CONSTRAINT fk_run_artifact_blob_id_blob REFERENCES blob (id),
    file_id uuid CONSTRAINT fk_run_artifact_file_id_file REFERENCES file (id) ON DELETE SET NULL,
    derived_from text[],
    CONSTRAINT uq_run_artifact_run_id_path UNIQUE (run_id, path)
);
CREATE INDEX ix_run_artifact_blob_id ON run_artifact (blob_id);
CREATE INDEX ix_run_artifact_file_id ON run_artifact (file_id);

CREATE TABLE run_finding (
    id bigint GENERATED ALWAYS AS IDENTITY CONSTRAINT pk_run_finding PRIMARY KEY,
    run_id uuid NOT NULL CONSTRAINT fk_run_finding_run_id_run REFERENCES run (id) ON DELETE CASCADE,
    severity text NOT NULL,
    code text COLLATE "C" NOT NULL,
    message text NOT NULL,
    file text,
    topic text,
    time_ns bigint,
    CONSTRAINT ck_run_finding_severity CHECK (severity IN ('info', 'warning', 'error'))
);
CREATE INDEX ix_run_finding_code ON run_finding (code, id);
CREATE INDEX ix_run_finding_run_id ON run_finding (run_id, id);

CREATE TABLE run_input (
    run_id uuid NOT NULL CONSTRAINT fk_run_input_run_id_run REFERENCES run (id) ON DELETE CASCADE,
    path text COLLATE "C" NOT NULL,
    size_bytes bigint NOT NULL,
    sha256 bytea NOT NULL,
    blob_id uuid CONSTRAINT fk_run_input_blob_id_blob REFERENCES blob (id) ON DELETE SET NULL,
    file_id uuid CONSTRAINT fk_run_input_file_id_file REFERENCES file (id) ON DELETE SET NULL,
    CONSTRAINT pk_run_input PRIMARY KEY (run_id, path)
);
CREATE INDEX ix_run_input_blob_id ON run_input (blob_id);
CREATE INDEX ix_run_input_file_id ON run_input (file_id);

CREATE TABLE run_metric (
    id bigint GENERATED ALWAYS AS IDENTITY CONSTRAINT pk_run_metric PRIMARY KEY,
    run_id uuid NOT NULL CONSTRAINT fk_run_metric_run_id_run REFERENCES run (id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    value double precision NOT NULL,
    unit text,
    file text
);
CREATE INDEX ix_run_metric_name ON run_metric (name, id);
CREATE INDEX ix_run_metric_run_id ON run_metric (run_id, id);

CREATE TABLE share_file (
    share_id uuid NOT NULL CONSTRAINT fk_share_file_share_id_share REFERENCES share (id) ON DELETE CASCADE,
    file_id uuid NOT NULL CONSTRAINT fk_share_file_file_id_file REFERENCES file (id) ON DELETE CASCADE,
    CONSTRAINT pk_share_file PRIMARY KEY (share_id, file_id)
);
CREATE INDEX ix_share_file_file_id ON share_file (file_id);

CREATE TABLE token (
    id uuid CONSTRAINT pk_token PRIMARY KEY,
    person_id uuid NOT NULL CONSTRAINT fk_token_person_id_person REFERENCES person (id),
    kind text NOT NULL DEFAULT 'personal',
    name text NOT NULL,
    prefix text NOT NULL DEFAULT '',
    secret_sha256 bytea NOT NULL,
    scopes text[] NOT NULL,
    is_limited boolean NOT NULL DEFAULT false,
    created_at timestamptz NOT NULL DEFAULT now(),
    expires_at timestamptz,
    last_used_at timestamptz,
    revoked_at timestamptz,
    created_by_token_id uuid CONSTRAINT fk_token_created_by_token_id_token REFERENCES token (id),
    run_id uuid CONSTRAINT fk_token_run_id_run REFERENCES run (id) ON DELETE SET NULL,
    max_right text,
    runner_id uuid,
    runner_labels text[],
    CONSTRAINT uq_token_secret_sha256 UNIQUE (secret_sha256),
    CONSTRAINT ck_token_kind CHECK (kind IN ('personal', 'robot', 'runner', 'run')),
    CONSTRAINT ck_token_max_right CHECK (max_right IN ('READ', 'CREATE', 'WRITE', 'DELETE')),
    CONSTRAINT ck_token_run CHECK ((run_id IS NULL OR kind = 'run') AND (kind = 'run') = (max_right IS NOT NULL)),
    CONSTRAINT ck_token_runner CHECK (kind = 'runner' OR (runner_id IS NULL AND runner_labels IS NULL)),
    CONSTRAINT ck_token_scopes CHECK (scopes <@ ARRAY['read', 'upload', 'write', 'run', 'admin']::text[]),
    CONSTRAINT ck_token_secret_sha256 CHECK (octet_length(secret_sha256) = 32)
);
CREATE INDEX ix_token_created_by_token_id ON token (created_by_token_id);
CREATE INDEX ix_token_person_id ON token (person_id);
CREATE INDEX ix_token_run_id ON token (run_id);
CREATE INDEX ix_token_runner_id ON token (runner_id) WHERE runner_id IS NOT NULL;

CREATE TABLE upload (
    id uuid CONSTRAINT pk_upload PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_upload_mission_id_mission REFERENCES mission (id),
    person_id uuid NOT NULL CONSTRAINT fk_upload_person_id_person REFERENCES person (id),
    run_id uuid CONSTRAINT fk_upload_run_id_run REFERENCES run (id),
    path text COLLATE "C" NOT NULL,
    path_key text COLLATE "C" NOT NULL,
    size_bytes bigint NOT NULL,
    part_size_bytes bigint NOT NULL,
    checksum text NOT NULL,
    store_id text NOT NULL DEFAULT 'main',
    key text NOT NULL,
    multipart_id text,
    signed_checksum text,
    state text NOT NULL DEFAULT 'open',
    sha256 bytea,
    crc64nvme bytea,
    file_id uuid CONSTRAINT fk_upload_file_id_file REFERENCES file (id) ON DELETE SET NULL,
    failure text,
    created_at timestamptz NOT NULL DEFAULT now(),
    renewed_at timestamptz NOT NULL DEFAULT now(),
    lease_ends_at timestamptz NOT NULL,
    expires_at timestamptz NOT NULL,
    completing_since timestamptz,
    cleaned_at timestamptz,
    CONSTRAINT uq_upload_key UNIQUE (key),
    CONSTRAINT ck_upload_checksum CHECK (checksum IN ('crc64nvme', 'sha256', 'md5')),
    CONSTRAINT ck_upload_completing CHECK (state <> 'completing' OR (sha256 IS NOT NULL AND crc64nvme IS NOT NULL AND completing_since IS NOT NULL)),
    CONSTRAINT ck_upload_sizes CHECK (size_bytes >= 0 AND part_size_bytes > 0),
    CONSTRAINT ck_upload_state CHECK (state IN ('open', 'completing', 'done', 'aborted', 'expired'))
);
CREATE INDEX ix_upload_expires_at ON upload (expires_at) WHERE state IN ('open', 'completing');
CREATE INDEX ix_upload_file_id ON upload (file_id) WHERE file_id IS NOT NULL;
CREATE INDEX ix_upload_mission_id ON upload (mission_id);
CREATE INDEX ix_upload_renewed_at ON upload (renewed_at) WHERE state = 'open';
CREATE INDEX ix_upload_run_id ON upload (run_id);
CREATE INDEX ix_upload_uncleaned ON upload (created_at) WHERE cleaned_at IS NULL;
CREATE UNIQUE INDEX uq_upload_path_key_active ON upload (mission_id, path_key) WHERE state IN ('open', 'completing') AND run_id IS NULL;
CREATE UNIQUE INDEX uq_upload_run_path_active ON upload (run_id, path) WHERE state IN ('open', 'completing') AND run_id IS NOT NULL;

CREATE TABLE audit_event (
    id bigint GENERATED ALWAYS AS IDENTITY CONSTRAINT pk_audit_event PRIMARY KEY,
    at timestamptz NOT NULL DEFAULT now(),
    actor_id uuid CONSTRAINT fk_audit_event_actor_id_person REFERENCES person (id),
    token_id uuid CONSTRAINT fk_audit_event_token_id_token REFERENCES token (id),
    session_id uuid CONSTRAINT fk_audit_event_session_id_session REFERENCES session (id),
    share_id uuid,
    address text,
    as_admin boolean NOT NULL DEFAULT false,
    operation text NOT NULL,
    resource_type text NOT NULL,
    resource_id uuid,
    resource_name text NOT NULL,
    project_id uuid,
    mission_id uuid,
    before jsonb NOT NULL DEFAULT '{}',
    after jsonb NOT NULL DEFAULT '{}',
    request_id text
);
CREATE INDEX ix_audit_event_actor_id ON audit_event (actor_id, id);
CREATE INDEX ix_audit_event_as_admin ON audit_event (id) WHERE as_admin;
CREATE INDEX ix_audit_event_at ON audit_event USING brin (at);
CREATE INDEX ix_audit_event_mission_id ON audit_event (mission_id, id);
CREATE INDEX ix_audit_event_resource_id ON audit_event (resource_id, id);
CREATE INDEX ix_audit_event_project_id ON audit_event (project_id, id);
CREATE INDEX ix_audit_event_token_id ON audit_event (token_id, id);

CREATE TABLE token_limit (
    id uuid CONSTRAINT pk_token_limit PRIMARY KEY,
    token_id uuid NOT NULL CONSTRAINT fk_token_limit_token_id_token REFERENCES token (id) ON DELETE CASCADE,
    project_id uuid CONSTRAINT fk_token_limit_project_id_project REFERENCES project (id) ON DELETE CASCADE,
    mission_id uuid CONSTRAINT fk_token_limit_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    CONSTRAINT ck_token_limit_resource CHECK (num_nonnulls(project_id, mission_id) = 1)
);
CREATE INDEX ix_token_limit_token_id ON token_limit (token_id);

ALTER TABLE job_error ADD CONSTRAINT fk_job_error_job_id_procrastinate_jobs
    FOREIGN KEY (job_id) REFERENCES procrastinate_jobs (id) ON DELETE CASCADE;

-- Each topic name once. Inserted in order, so that two transactions adding the same names cannot deadlock.
CREATE FUNCTION add_topic_names() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  INSERT INTO topic_name (name)
    SELECT DISTINCT added.name FROM added
    WHERE NOT EXISTS (SELECT FROM topic_name WHERE topic_name.name = added.name)
    ORDER BY 1
  ON CONFLICT DO NOTHING;
  RETURN NULL;
END $$;
CREATE TRIGGER add_topic_names AFTER INSERT ON topic REFERENCING NEW TABLE AS added
  FOR EACH STATEMENT EXECUTE FUNCTION add_topic_names();

-- file.start_ns repeats blob.start_ns, so that lists by time need one index only. The share lock orders a new file
-- after a concurrent update of its blob, or before it, in which case that update sees the file.
CREATE FUNCTION copy_start_from_blob() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  SELECT blob.start_ns INTO NEW.start_ns FROM blob WHERE blob.id = NEW.blob_id FOR SHARE;
  RETURN NEW;
END $$;
CREATE TRIGGER copy_start_from_blob BEFORE INSERT OR UPDATE OF blob_id ON file
  FOR EACH ROW EXECUTE FUNCTION copy_start_from_blob();

CREATE FUNCTION copy_start_to_files() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  UPDATE file SET start_ns = NEW.start_ns WHERE file.blob_id = NEW.id;
  RETURN NULL;
END $$;
CREATE TRIGGER copy_start_to_files AFTER UPDATE OF start_ns ON blob
  FOR EACH ROW WHEN (OLD.start_ns IS DISTINCT FROM NEW.start_ns) EXECUTE FUNCTION copy_start_to_files();

-- A mission whose files changed has no file_count until it is derived again, rather than an outdated one.
CREATE FUNCTION clear_file_count() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  NEW.file_count := NULL;
  RETURN NEW;
END $$;
CREATE TRIGGER clear_file_count BEFORE UPDATE OF files_revision ON mission
  FOR EACH ROW WHEN (OLD.files_revision <> NEW.files_revision) EXECUTE FUNCTION clear_file_count();

-- The queue: jobs are looked up by what they refer to, and each candidate's lock is compared with those of waiting jobs.
CREATE INDEX ix_procrastinate_jobs_ref ON procrastinate_jobs (task_name, (args ->> 'ref'))
    WHERE status IN ('todo', 'doing');
CREATE INDEX ix_procrastinate_jobs_lock ON procrastinate_jobs (lock) WHERE status IN ('todo', 'doing');
-- Plans made while the queue is empty read all jobs for each job (250 ms at 2000); without sorting they use the index.
ALTER FUNCTION procrastinate_fetch_job_v2 (varchar[], bigint) SET enable_sort = off;

-- The oldest program version that works on the schema.
ALTER TABLE alembic_version ADD COLUMN compatible_from text;

INSERT INTO access_group (id, kind, name, name_key)
  VALUES ('61646d69-6e73-4000-8000-000000000001', 'admins', 'admins', 'admins');
