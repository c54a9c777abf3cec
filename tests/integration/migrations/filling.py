"""Rows as a server of each schema would have written them, and statements as its processes send them.

By revision: those of an earlier one are valid at a later one too, which is what lets an old server go on meanwhile.
Each is written once for every revision a database passes, so `%(n)s` makes them differ.
"""

_BASE = """
INSERT INTO person (id, name) VALUES (%(person)s, 'Ada ' || %(n)s);
INSERT INTO project (id, name, name_key, metadata_fields, created_by_id)
  VALUES (%(project)s, 'walk ' || %(n)s, 'walk ' || %(n)s, '{"undeclared": "accept", "fields": []}', %(person)s);
INSERT INTO mission (id, project_id, name, name_key, metadata, notes, created_by_id, files_revision, derived_revision)
  VALUES (%(mission)s, %(project)s, 'Day 1', 'day 1', '{"robot": "anymal"}', 'rain', %(person)s, 3, 3);
INSERT INTO blob (id, key, size_bytes, sha256, crc64nvme, uploaded_by_id, content, summarised_at, message_count,
                  start_ns, end_ns, format)
  VALUES (%(blob)s, 'batch/' || %(n)s || '.mcap', 1000, sha256(%(n)s::bytea), '\\x0102030405060708', %(person)s,
          'indexed', now(), 7, 1, 2, 'mcap');
INSERT INTO blob (id, key, size_bytes, sha256, md5, state, verified_at, uploaded_by_id)
  VALUES (gen_random_uuid(), 'verified/' || %(n)s, 5, sha256('p'), '\\x00112233445566778899aabbccddeeff', 'verified',
          now(), %(person)s);
INSERT INTO blob (id, key, size_bytes, sha256, state, state_reason, uploaded_by_id)
  VALUES (gen_random_uuid(), 'lost/' || %(n)s, 6, sha256('l'), 'lost', 'the store no longer has the object',
          %(person)s);
INSERT INTO topic (blob_id, name, message_type, count, first_ns, last_ns, rate_hz)
  VALUES (%(blob)s, '/imu', 'sensor_msgs/Imu', 7, 1, 2, 200.0), (%(blob)s, '/tf', NULL, NULL, NULL, NULL, NULL);
INSERT INTO recording (id, mission_id, name, kind, message_count, start_ns, end_ns)
  VALUES (%(recording)s, %(mission)s, 'run', 'single', 7, 1, 2);
INSERT INTO file (id, mission_id, recording_id, blob_id, path, path_key, origin, uploaded_by_id, labels)
  VALUES (%(file)s, %(mission)s, %(recording)s, %(blob)s, 'run.mcap', 'run.mcap', 'upload', %(person)s, '{night}');
INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id, deleted_at, deleted_by_id)
  SELECT gen_random_uuid(), %(mission)s, id, 'old ' || key, 'old ' || key, 'link', %(person)s, now(), %(person)s
  FROM blob WHERE key IN ('verified/' || %(n)s, 'lost/' || %(n)s);
INSERT INTO upload (id, mission_id, person_id, path, path_key, size_bytes, part_size_bytes, checksum, key,
                    lease_ends_at, expires_at)
  VALUES (gen_random_uuid(), %(mission)s, %(person)s, 'coming.mcap', 'coming.mcap', 9000000, 8388608, 'crc64nvme',
          'coming/' || %(n)s, now(), now() + interval '7 days');
INSERT INTO store_probe (store_id, checksum, writes_once) VALUES ('main', 'crc64nvme', true) ON CONFLICT DO NOTHING;
INSERT INTO audit_event (actor_id, operation, noun, noun_id, noun_name, project_id, after)
  VALUES (%(person)s, 'file.upload', 'file', %(file)s, 'run.mcap', %(project)s, '{"size_bytes": 1000}');
INSERT INTO procrastinate_jobs (queue_name, task_name, args)
  VALUES ('default', 'verify_blob', jsonb_build_object('ref', %(blob)s));
"""
_RIGHTS = """
INSERT INTO access_group (id, kind, name, name_key, person_id)
  VALUES (%(group)s, 'person', 'Ada ' || %(n)s, 'ada ' || %(n)s, %(person)s);
INSERT INTO membership (group_id, person_id) VALUES (%(group)s, %(person)s);
INSERT INTO access_grant (id, group_id, project_id, level) VALUES (gen_random_uuid(), %(group)s, %(project)s, 4);
INSERT INTO access_grant (id, group_id, mission_id, level, expires_at)
  VALUES (gen_random_uuid(), %(group)s, %(mission)s, 1, now() + interval '1 day');
INSERT INTO person_email (email_key, email, person_id, verified_at, verified_by)
  VALUES ('ada' || %(n)s || '@lab.example', 'Ada' || %(n)s || '@lab.example', %(person)s, now(), 'test');
INSERT INTO token (id, person_id, kind, name, prefix, secret_sha256, scopes, is_limited)
  VALUES (%(token)s, %(person)s, 'robot', 'spot', 'klein_', sha256(('t' || %(n)s)::bytea), '{upload,read}', true);
INSERT INTO token_limit (id, token_id, project_id) VALUES (gen_random_uuid(), %(token)s, %(project)s);
INSERT INTO session (id, person_id, secret_sha256, way, expires_at)
  VALUES (gen_random_uuid(), %(person)s, sha256(('s' || %(n)s)::bytea), 'password', now() + interval '1 day');
INSERT INTO share (id, mission_id, name, is_whole, prefix, secret_sha256, created_by_id, expires_at)
  VALUES (%(share)s, %(mission)s, 'for Bob', false, 'klein_', sha256(('h' || %(n)s)::bytea), %(person)s,
          now() + interval '1 day');
INSERT INTO share_file (share_id, file_id) VALUES (%(share)s, %(file)s);
"""
_SIGNING_IN = """
INSERT INTO identity (id, person_id, issuer, subject) VALUES (gen_random_uuid(), %(person)s, 'https://idp', %(n)s);
INSERT INTO password (person_id, hash) VALUES (%(person)s, '$argon2id$v=19$m=65536,t=3,p=4$c2FsdA$aGFzaA');
INSERT INTO one_time_code (id, purpose, secret_sha256, person_id, created_by_id, expires_at)
  VALUES (gen_random_uuid(), 'reset', sha256(('o' || %(n)s)::bytea), %(person)s, %(person)s, now());
INSERT INTO login_request (id, kind, secret_sha256, label, user_code, expires_at)
  VALUES (gen_random_uuid(), 'device', sha256(('d' || %(n)s)::bytea), 'laptop', 'ABCD' || %(n)s, now());
"""
_TOPICS = """
INSERT INTO mission_topics (mission_id, revision, recording_ids, bin_ns)
  VALUES (%(mission)s, 3, ARRAY[%(recording)s::uuid], 10);
INSERT INTO mission_topic (mission_id, name, file_count, recording_count, places)
  VALUES (%(mission)s, '/imu', 1, 1, '{0}');
"""
_RUNS = """
INSERT INTO runner (id, person_id, name, capacity, abilities, version)
  VALUES (%(runner)s, %(person)s, 'desk', '{}', '{}', '0.1');
INSERT INTO action (id, project_id, name, name_key, created_by_id)
  VALUES (%(action)s, %(project)s, 'check', 'check', %(person)s);
INSERT INTO action_version (id, action_id, number, definition, definition_sha256, created_by_id)
  VALUES (%(version)s, %(action)s, 1, '{}', sha256(('v' || %(n)s)::bytea), %(person)s);
INSERT INTO run_finding (run_id, severity, code, message) SELECT id, 'info', 'fine', 'all well' FROM run LIMIT 1;
"""
# What is written at a revision, beside all before it; a token's scopes came with rights.
FILLS = {
    "0001": _BASE,
    "0004": _RIGHTS,
    "0005": _SIGNING_IN,
    "0009": _TOPICS,
    "0015": _RUNS,
}
BEFORE_RIGHTS = """
INSERT INTO token (id, person_id, name, secret_sha256)
  VALUES (%(token)s, %(person)s, 'local owner', sha256(('old' || %(n)s)::bytea));
"""
NAMES = ["person", "project", "mission", "blob", "recording", "file"]
NAMES += ["group", "token", "share", "runner", "action", "version"]

# What a server of the first schema reads and writes all day long.
OLD_READS = (
    "SELECT f.path, b.state, m.name, p.name, a.name FROM file f JOIN blob b ON b.id = f.blob_id"
    " JOIN mission m ON m.id = f.mission_id JOIN project p ON p.id = m.project_id"
    " JOIN person a ON a.id = f.uploaded_by_id WHERE f.deleted_at IS NULL ORDER BY f.path LIMIT 100",
    "SELECT t.name, t.count FROM topic t JOIN blob b ON b.id = t.blob_id LIMIT 100",
    "SELECT count(*) FROM upload WHERE state IN ('open', 'completing')",
)
OLD_WRITES = (
    "INSERT INTO blob (id, key, size_bytes, sha256, uploaded_by_id)"
    " VALUES (%(blob)s, 'load/' || %(n)s, 1, sha256('x'), %(person)s)",
    "INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)"
    " VALUES (%(file)s, %(mission)s, %(blob)s, 'load ' || %(n)s, 'load ' || %(n)s, 'upload', %(person)s)",
    "INSERT INTO audit_event (actor_id, operation, noun, noun_id, noun_name, project_id)"
    " VALUES (%(person)s, 'file.upload', 'file', %(file)s, 'load ' || %(n)s, %(project)s)",
    "UPDATE mission SET notes = notes || '.', files_revision = files_revision + 1 WHERE id = %(mission)s",
)
