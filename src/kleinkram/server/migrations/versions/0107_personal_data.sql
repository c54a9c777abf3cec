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

-- Redacts the texts of a JSON document: addresses that match `pattern` anywhere, and whole values that are one of `names`.
-- A name of one word may be a word of ours, such as a right: it is replaced only under the keys that name somebody.
CREATE FUNCTION pseudonymise(document jsonb, names text[], pattern text, pseudonym text, key text DEFAULT '')
RETURNS jsonb LANGUAGE plpgsql IMMUTABLE SET search_path = pg_catalog, pg_temp AS $$
DECLARE
    content text := document #>> '{}';
BEGIN
    RETURN CASE jsonb_typeof(document)
        WHEN 'object' THEN (
            SELECT coalesce(jsonb_object_agg(coalesce(regexp_replace(field.key, pattern, pseudonym, 'gi'), field.key),
                public.pseudonymise(field.value, names, pattern, pseudonym, field.key)), '{}')
            FROM jsonb_each(document) AS field)
        WHEN 'array' THEN (
            SELECT coalesce(jsonb_agg(public.pseudonymise(item.value, names, pattern, pseudonym, key)
                ORDER BY item.ordinality), '[]')
            FROM jsonb_array_elements(document) WITH ORDINALITY AS item)
        WHEN 'string' THEN to_jsonb(CASE
            WHEN content = ANY (names) AND (key IN ('person', 'editor', 'made_with') OR content ~ '\s') THEN pseudonym
            ELSE coalesce(regexp_replace(content, pattern, pseudonym, 'gi'), content) END)
        ELSE document
    END;
END $$;

-- The only way in which the serving role can change the audit log: in events of or about an erased person, it replaces
-- names and addresses by the pseudonym, and removes network addresses. It never changes who did what to what, and when.
CREATE FUNCTION redact_audit_log(erased uuid) RETURNS bigint
LANGUAGE plpgsql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
DECLARE
    pseudonym text;
    found_names text[];
    found_addresses text[];
    own_names text[];
    unique_names text[];
    own_ids uuid[];
    pattern text;
    redacted bigint;
BEGIN
    SELECT person.name, erasure.names, erasure.addresses INTO pseudonym, found_names, found_addresses
        FROM public.erasure JOIN public.person ON person.id = erasure.person_id
        WHERE person.id = erased AND person.erased_at IS NOT NULL AND erasure.finished_at IS NULL
        FOR UPDATE OF erasure;
    IF NOT FOUND THEN
        RETURN 0;
    END IF;
    -- Addresses that the person had earlier. Providers send any text as one; only addresses are replaced inside texts.
    found_addresses := ARRAY(
        SELECT DISTINCT lower(past.address) FROM (
            SELECT unnest(found_addresses) AS address
            UNION ALL SELECT email FROM public.audit_event,
                LATERAL (VALUES (before ->> 'email'), (after ->> 'email')) AS field (email)
                WHERE resource_id = erased OR after ->> 'person_id' = erased::text
                    OR before ->> 'person_id' = erased::text) AS past
        WHERE past.address ~ '^[\w!#$%&''*+/=?^`{|}~.-]+@[\w.-]+$');
    -- Backslashes make all other characters ordinary ones. Neither in the middle of a longer address.
    SELECT '(?<![\w!#$%&''*+/=?^`{|}~.-])(' || string_agg(regexp_replace(address, '(\W)', '\\\1', 'g'), '|')
        || ')(?![\w-]|\.\w)' INTO pattern FROM unnest(found_addresses) AS address;
    -- Alone, a name that somebody else has does not say who is meant.
    unique_names := ARRAY(SELECT found.name FROM unnest(found_names) AS found (name)
        WHERE NOT EXISTS (SELECT FROM public.person WHERE person.name = found.name AND person.id <> erased));
    own_ids := ARRAY(SELECT id FROM public.session WHERE person_id = erased
        UNION ALL SELECT id FROM public.token WHERE person_id = erased
        UNION ALL SELECT id FROM public.runner WHERE person_id = erased) || erased;
    -- Tokens and runners, too, have names that people gave them.
    own_names := found_names || ARRAY(SELECT DISTINCT resource_name FROM public.audit_event
        WHERE resource_type IN ('token', 'runner') AND resource_id = ANY (own_ids));
    WITH matching AS MATERIALIZED (
        SELECT id, (actor_id = erased OR resource_id = ANY (own_ids) OR before ->> 'person_id' = erased::text
            OR after ->> 'person_id' = erased::text) IS TRUE AS is_own
        FROM public.audit_event
        WHERE actor_id = erased OR resource_id = ANY (own_ids) OR before ->> 'person_id' = erased::text
            OR after ->> 'person_id' = erased::text OR resource_name = ANY (unique_names)
            OR EXISTS (SELECT FROM unnest(found_addresses) AS found (address)
                WHERE strpos(lower(concat(resource_name, ' ', before, ' ', after)), found.address) > 0)
            OR EXISTS (SELECT FROM unnest(unique_names) AS found (name)
                WHERE strpos(concat(before, after), to_jsonb(found.name)::text) > 0)
    ), changed AS (
        SELECT event.id,
            CASE WHEN actor_id IS NULL OR actor_id = erased THEN NULL ELSE address END AS address,
            CASE WHEN resource_id = ANY (own_ids) OR (resource_type = 'login' AND actor_id = erased)
                    OR (resource_type IN ('grant', 'person', 'session') AND resource_name = ANY (names.replaced))
                THEN pseudonym
                ELSE coalesce(regexp_replace(resource_name, pattern, pseudonym, 'gi'), resource_name)
            END AS resource_name,
            public.pseudonymise(before, names.replaced, pattern, pseudonym) AS before,
            public.pseudonymise(
                -- From where a program asked to sign in.
                CASE WHEN resource_type = 'login' AND actor_id = erased THEN after - 'from' ELSE after END,
                names.replaced, pattern, pseudonym) AS after
        FROM public.audit_event AS event JOIN matching ON matching.id = event.id,
            LATERAL (SELECT CASE WHEN matching.is_own THEN own_names ELSE unique_names END) AS names (replaced)
    )
    UPDATE public.audit_event SET address = changed.address, resource_name = changed.resource_name,
            before = changed.before, after = changed.after
        FROM changed WHERE changed.id = audit_event.id
            AND (audit_event.address, audit_event.resource_name, audit_event.before, audit_event.after)
                IS DISTINCT FROM (changed.address, changed.resource_name, changed.before, changed.after);
    GET DIAGNOSTICS redacted = ROW_COUNT;
    INSERT INTO public.audit_event (operation, resource_type, resource_id, resource_name, after)
        VALUES ('audit.redact', 'person', erased, pseudonym, jsonb_build_object('events', redacted));
    UPDATE public.erasure SET names = NULL, addresses = NULL, finished_at = now(), event_count = redacted
        WHERE person_id = erased;
    RETURN redacted;
END $$;

-- Deletes events that are older than `audit_retention` says, which the serving role cannot change; without a row there,
-- it deletes nothing. The creation of a credential stays as long as the credential is valid.
CREATE FUNCTION delete_expired_audit_events(up_to_id bigint, most integer) RETURNS bigint
LANGUAGE plpgsql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
DECLARE
    expired bigint;
BEGIN
    DELETE FROM public.audit_event WHERE id IN (
        SELECT id FROM public.audit_event
            WHERE id <= up_to_id AND at < (SELECT now() - make_interval(days => days) FROM public.audit_retention)
                AND NOT (operation = 'token.create' AND EXISTS (SELECT FROM public.token WHERE token.id = resource_id
                    AND token.revoked_at IS NULL AND coalesce(token.expires_at > now(), true)))
            ORDER BY id LIMIT most);
    GET DIAGNOSTICS expired = ROW_COUNT;
    IF expired > 0 THEN
        INSERT INTO public.audit_event (operation, resource_type, resource_name, after)
            VALUES ('audit.expire', 'server', 'audit log', jsonb_build_object('events', expired));
    END IF;
    RETURN expired;
END $$;

REVOKE EXECUTE ON FUNCTION redact_audit_log(uuid), delete_expired_audit_events(bigint, integer),
    pseudonymise(jsonb, text[], text, text, text) FROM PUBLIC;
