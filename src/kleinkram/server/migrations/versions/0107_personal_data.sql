ALTER TABLE person ADD COLUMN erased_at timestamptz;
ALTER TABLE person ADD CONSTRAINT ck_person_erased CHECK (erased_at IS NULL OR deactivated_at IS NOT NULL);

CREATE TABLE erasure (
    person_id uuid CONSTRAINT pk_erasure PRIMARY KEY CONSTRAINT fk_erasure_person_id_person REFERENCES person (id),
    names text[],
    addresses text[],
    finished_at timestamptz,
    event_count bigint,
    CONSTRAINT ck_erasure_finished CHECK (num_nulls(names, addresses) = 0 AND num_nonnulls(finished_at, event_count) = 0
        OR num_nulls(names, addresses) = 2 AND num_nonnulls(finished_at, event_count) = 2)
);

CREATE TABLE audit_retention (
    is_set boolean DEFAULT true CONSTRAINT pk_audit_retention PRIMARY KEY,
    days integer NOT NULL,
    CONSTRAINT ck_audit_retention_is_set CHECK (is_set),
    CONSTRAINT ck_audit_retention_days CHECK (days >= 30)
);

ALTER TABLE identity
    ADD COLUMN confirmed_at timestamptz DEFAULT now() NOT NULL,
    ADD COLUMN checked_at timestamptz,
    ADD COLUMN refresh_token text;
UPDATE identity SET confirmed_at = last_used_at;

ALTER TABLE session
    ADD COLUMN identity_id uuid
        CONSTRAINT fk_session_identity_id_identity REFERENCES identity (id) ON DELETE SET NULL,
    ADD COLUMN provider_session_id text;
CREATE INDEX ix_session_identity_id ON session (identity_id);
-- Of each session by a provider, the account there: a person seldom has two of one provider.
UPDATE session SET identity_id = (
    SELECT identity.id FROM identity
        WHERE identity.person_id = session.person_id AND identity.issuer = session.method
            AND identity.unlinked_at IS NULL
        ORDER BY identity.last_used_at DESC LIMIT 1
) WHERE revoked_at IS NULL;

ALTER TABLE token ADD COLUMN identity_id uuid
    CONSTRAINT fk_token_identity_id_identity REFERENCES identity (id) ON DELETE SET NULL;
CREATE INDEX ix_token_identity_id ON token (identity_id);

CREATE TABLE used_logout_token (
    issuer text COLLATE "C" NOT NULL,
    jti text COLLATE "C" NOT NULL,
    expires_at timestamptz NOT NULL,
    CONSTRAINT pk_used_logout_token PRIMARY KEY (issuer, jti)
);
CREATE INDEX ix_used_logout_token_expires_at ON used_logout_token (expires_at);

-- Replaces what matches `pattern`, and each text that is one of `names`, in a JSON document.
CREATE FUNCTION pseudonymise(document jsonb, names text[], pattern text, pseudonym text) RETURNS jsonb
LANGUAGE plpgsql IMMUTABLE AS $$
DECLARE
    name text;
    result text := document::text;
BEGIN
    IF pattern IS NOT NULL THEN
        result := regexp_replace(result, pattern, pseudonym, 'gi');
    END IF;
    FOREACH name IN ARRAY names LOOP
        result := replace(result, to_jsonb(name)::text, to_jsonb(pseudonym)::text);
    END LOOP;
    RETURN result::jsonb;
END $$;

-- The only way in which the serving role can change the audit log: in events of or about an erased person, it replaces
-- names and addresses by the pseudonym, and removes network addresses. It never changes who did what to what, and when.
CREATE FUNCTION redact_audit_log(erased uuid) RETURNS bigint
LANGUAGE plpgsql SECURITY DEFINER SET search_path = public, pg_temp AS $$
DECLARE
    pseudonym text;
    found_names text[];
    found_addresses text[];
    unique_names text[];
    own_ids uuid[];
    pattern text;
    redacted bigint;
BEGIN
    SELECT person.name, erasure.names, erasure.addresses INTO pseudonym, found_names, found_addresses
        FROM erasure JOIN person ON person.id = erasure.person_id
        WHERE person.id = erased AND person.erased_at IS NOT NULL AND erasure.finished_at IS NULL
        FOR UPDATE OF erasure;
    IF NOT FOUND THEN
        RETURN 0;
    END IF;
    -- Addresses that the person had earlier.
    found_addresses := found_addresses || ARRAY(
        SELECT DISTINCT email FROM audit_event, LATERAL (VALUES (before ->> 'email'), (after ->> 'email')) AS past (email)
            WHERE email IS NOT NULL AND (resource_id = erased OR after ->> 'person_id' = erased::text
                OR before ->> 'person_id' = erased::text));
    -- Backslashes make all other characters ordinary ones. Neither in the middle of a longer address.
    SELECT '(?<![\w!#$%&''*+/=?^`{|}~.-])(' || string_agg(regexp_replace(address, '(\W)', '\\\1', 'g'), '|')
        || ')(?![\w-]|\.\w)' INTO pattern FROM unnest(found_addresses) AS address WHERE address <> '';
    -- Alone, a name that somebody else has does not say who is meant.
    unique_names := ARRAY(SELECT found.name FROM unnest(found_names) AS found (name)
        WHERE NOT EXISTS (SELECT FROM person WHERE person.name = found.name AND person.id <> erased));
    own_ids := ARRAY(SELECT erased UNION ALL SELECT id FROM session WHERE person_id = erased
        UNION ALL SELECT id FROM token WHERE person_id = erased
        UNION ALL SELECT id FROM runner WHERE person_id = erased);
    WITH matching AS (
        SELECT id, (actor_id = erased OR resource_id = ANY (own_ids) OR before ->> 'person_id' = erased::text
            OR after ->> 'person_id' = erased::text) IS TRUE AS is_own
        FROM audit_event
        WHERE actor_id = erased OR resource_id = ANY (own_ids) OR before ->> 'person_id' = erased::text
            OR after ->> 'person_id' = erased::text OR resource_name = ANY (unique_names)
            OR concat(resource_name, ' ', before, ' ', after) ~* pattern
            OR EXISTS (SELECT FROM unnest(unique_names) AS found (name)
                WHERE strpos(concat(before, after), to_jsonb(found.name)::text) > 0)
    )
    UPDATE audit_event SET
        address = CASE WHEN actor_id IS NULL OR actor_id = erased THEN NULL ELSE address END,
        resource_name = CASE
            WHEN resource_id = ANY (own_ids) OR (resource_type = 'login' AND actor_id = erased)
                OR resource_name = ANY (CASE WHEN is_own THEN found_names ELSE unique_names END) THEN pseudonym
            ELSE coalesce(regexp_replace(resource_name, pattern, pseudonym, 'gi'), resource_name) END,
        before = pseudonymise(before, CASE WHEN is_own THEN found_names ELSE unique_names END, pattern, pseudonym),
        after = pseudonymise(after, CASE WHEN is_own THEN found_names ELSE unique_names END, pattern, pseudonym)
    FROM matching WHERE matching.id = audit_event.id;
    GET DIAGNOSTICS redacted = ROW_COUNT;
    INSERT INTO audit_event (operation, resource_type, resource_id, resource_name, after)
        VALUES ('audit.redact', 'person', erased, pseudonym, jsonb_build_object('events', redacted));
    UPDATE erasure SET names = NULL, addresses = NULL, finished_at = now(), event_count = redacted
        WHERE person_id = erased;
    RETURN redacted;
END $$;

-- Deletes events that are older than `audit_retention` says, which the serving role cannot change; without a row there,
-- it deletes nothing. The creation of a credential stays as long as the credential is valid.
CREATE FUNCTION delete_expired_audit_events(up_to_id bigint, most integer) RETURNS bigint
LANGUAGE plpgsql SECURITY DEFINER SET search_path = public, pg_temp AS $$
DECLARE
    expired bigint;
BEGIN
    DELETE FROM audit_event WHERE id IN (
        SELECT id FROM audit_event
            WHERE id <= up_to_id AND at < (SELECT now() - make_interval(days => days) FROM audit_retention)
                AND NOT (operation = 'token.create' AND EXISTS (SELECT FROM token WHERE token.id = resource_id
                    AND token.revoked_at IS NULL AND coalesce(token.expires_at > now(), true)))
            ORDER BY id LIMIT most);
    GET DIAGNOSTICS expired = ROW_COUNT;
    IF expired > 0 THEN
        INSERT INTO audit_event (operation, resource_type, resource_name, after)
            VALUES ('audit.expire', 'server', 'audit log', jsonb_build_object('events', expired));
    END IF;
    RETURN expired;
END $$;

REVOKE EXECUTE ON FUNCTION redact_audit_log(uuid), delete_expired_audit_events(bigint, integer),
    pseudonymise(jsonb, text[], text, text) FROM PUBLIC;
