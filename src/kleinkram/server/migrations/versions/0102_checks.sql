-- Checks and verdicts. Tables and columns repeat src/kleinkram/server/tables/checks.py.

-- The version of the project's checks.yaml that applies; 0 for none.
ALTER TABLE project ADD COLUMN checks_number integer NOT NULL DEFAULT 0;

CREATE TABLE project_checks (
    project_id uuid NOT NULL CONSTRAINT fk_project_checks_project_id_project REFERENCES project (id) ON DELETE CASCADE,
    number integer NOT NULL,
    text text NOT NULL,
    sha256 bytea NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_project_checks_created_by_id_person REFERENCES person (id),
    CONSTRAINT pk_project_checks PRIMARY KEY (project_id, number),
    CONSTRAINT ck_project_checks_number CHECK (number > 0),
    CONSTRAINT ck_project_checks_sha256 CHECK (octet_length(sha256) = 32)
) WITH (autovacuum_analyze_threshold = 0);

CREATE TABLE mission_checks (
    mission_id uuid CONSTRAINT pk_mission_checks PRIMARY KEY CONSTRAINT fk_mission_checks_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    verdict text NOT NULL,
    files_revision bigint NOT NULL,
    project_id uuid NOT NULL CONSTRAINT fk_mission_checks_project_id_project REFERENCES project (id) ON DELETE CASCADE,
    checks_number integer NOT NULL,
    is_outdated boolean NOT NULL DEFAULT false,
    counts jsonb NOT NULL,
    checks jsonb NOT NULL,
    statuses jsonb NOT NULL,
    profiles_applied text[] NOT NULL DEFAULT '{}',
    profiles_left_out jsonb NOT NULL DEFAULT '[]',
    failed text[] NOT NULL DEFAULT '{}',
    evaluated_at timestamptz NOT NULL DEFAULT now(),
    bad_since timestamptz,
    CONSTRAINT ck_mission_checks_verdict CHECK (verdict IN ('good', 'warnings', 'bad', 'outdated', 'running', 'unchecked')),
    CONSTRAINT ck_mission_checks_bad_since CHECK (verdict <> 'bad' OR bad_since IS NOT NULL)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_mission_checks_bad_since ON mission_checks (bad_since) WHERE verdict = 'bad';
CREATE INDEX ix_mission_checks_failed ON mission_checks USING gin (failed) WITH (gin_pending_list_limit = 256);
CREATE INDEX ix_mission_checks_project_id ON mission_checks (project_id);
CREATE INDEX ix_mission_checks_verdict ON mission_checks (verdict);

CREATE TABLE check_report (
    id uuid CONSTRAINT pk_check_report PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_check_report_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    document_sha256 bytea NOT NULL,
    depth text NOT NULL,
    verdict text NOT NULL,
    files jsonb NOT NULL,
    checks jsonb NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_check_report_created_by_id_person REFERENCES person (id),
    CONSTRAINT ck_check_report_depth CHECK (depth IN ('index', 'content')),
    CONSTRAINT ck_check_report_verdict CHECK (verdict IN ('good', 'warnings', 'bad', 'outdated', 'running', 'unchecked')),
    CONSTRAINT ck_check_report_document_sha256 CHECK (octet_length(document_sha256) = 32)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_check_report_mission_id ON check_report (mission_id, created_at);

CREATE TABLE check_acceptance (
    id uuid CONSTRAINT pk_check_acceptance PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_check_acceptance_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    check_name text COLLATE "C" NOT NULL,
    topic text COLLATE "C",
    because text NOT NULL,
    inputs_sha256 bytea NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_check_acceptance_created_by_id_person REFERENCES person (id),
    ended text,
    ended_at timestamptz,
    ended_by_id uuid CONSTRAINT fk_check_acceptance_ended_by_id_person REFERENCES person (id),
    CONSTRAINT ck_check_acceptance_ended CHECK (ended IN ('withdrawn', 'files_changed')),
    CONSTRAINT ck_check_acceptance_ended_at CHECK ((ended IS NULL) = (ended_at IS NULL)),
    CONSTRAINT ck_check_acceptance_inputs_sha256 CHECK (octet_length(inputs_sha256) = 32)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_check_acceptance_mission_id ON check_acceptance (mission_id, created_at);
CREATE UNIQUE INDEX uq_check_acceptance_current ON check_acceptance (mission_id, check_name, topic) NULLS NOT DISTINCT WHERE ended IS NULL;

CREATE TABLE check_note (
    id uuid CONSTRAINT pk_check_note PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_check_note_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    check_name text COLLATE "C" NOT NULL,
    topic text COLLATE "C",
    text text NOT NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_check_note_created_by_id_person REFERENCES person (id)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_check_note_mission_id ON check_note (mission_id, created_at);
