"""The row about rights: the cost of a list for somebody with very many grants, compared with an admin.

500 people, 60 groups and 20 000 grants over 2000 projects, 10 000 missions and 40 000 files, put straight into the
database. The one who asks reads everything, by grants to ten groups, so that both lists have the same rows.
"""

import hashlib
import json
import secrets
import statistics
import time

import psycopg
import urllib3

_BAR = 1.3
# The number of filled tables that autovacuum has not analysed yet.
_UNSEEN = """
SELECT count(*) FROM pg_stat_user_tables WHERE last_autoanalyze IS NULL AND relname IN
  ('person', 'access_group', 'membership', 'access_grant', 'project', 'mission', 'file', 'blob')
"""
_TIMES = 100
_LISTS = (
    "projects?limit=100",
    "missions?limit=100",
    "missions?limit=100&sort=-created&count=true",
    "files?limit=100",
    "files?limit=100&count=true",
    "missions?text=mission-77",
)
# Ids are hashes of names: the serving role may not create tables to store them in.
_FILL = """
INSERT INTO person (id, name) SELECT md5('person' || n)::uuid, 'person ' || n FROM generate_series(1, 500) n;
INSERT INTO access_group (id, kind, name, name_key, person_id)
  SELECT md5('own' || n)::uuid, 'person', 'person ' || n, 'person ' || n, md5('person' || n)::uuid
  FROM generate_series(1, 500) n;
INSERT INTO access_group (id, kind, name, name_key)
  SELECT md5('team' || n)::uuid, 'custom', 'team ' || n, 'team ' || n FROM generate_series(1, 60) n;
INSERT INTO membership (group_id, person_id)
  SELECT md5('own' || n)::uuid, md5('person' || n)::uuid FROM generate_series(1, 500) n;
INSERT INTO membership (group_id, person_id)
  SELECT md5('team' || t)::uuid, md5('person' || n)::uuid FROM generate_series(1, 60) t, generate_series(1, 500) n
  WHERE n = 1 AND t <= 10 OR n > 1 AND (n + t) %% 12 = 0;
INSERT INTO project (id, name, name_key, metadata_fields, created_by_id)
  SELECT md5('project' || n)::uuid, 'project-' || n, 'project-' || n, '{"fields": []}', %(owner)s
  FROM generate_series(1, 2000) n;
INSERT INTO mission (id, project_id, name, name_key, metadata, created_by_id, created_at)
  SELECT md5('mission' || n)::uuid, md5('project' || (n - 1) / 5 + 1)::uuid, 'mission-' || n, 'mission-' || n, '{}',
    %(owner)s, now() - n * interval '1 minute'
  FROM generate_series(1, 10000) n;
INSERT INTO blob (id, key, size_bytes, sha256, uploaded_by_id, content)
  SELECT md5('blob' || n)::uuid, 'bench-' || n, 1000000, sha256(('blob' || n)::bytea), %(owner)s, 'opaque'
  FROM generate_series(1, 40000) n;
INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)
  SELECT md5('file' || n)::uuid, md5('mission' || (n - 1) / 4 + 1)::uuid, md5('blob' || n)::uuid,
    'drive_' || n || '.bag', 'drive_' || n || '.bag', 'upload', %(owner)s
  FROM generate_series(1, 40000) n;
INSERT INTO access_grant (id, group_id, project_id, level)
  SELECT gen_random_uuid(), md5('team' || t)::uuid, md5('project' || n)::uuid, 1 + n %% 4
  FROM generate_series(1, 2000) n, LATERAL unnest(ARRAY[1 + n %% 10, 11 + n %% 25, 36 + n %% 25]) t;
INSERT INTO access_grant (id, group_id, project_id, level)
  SELECT gen_random_uuid(), md5('own' || p)::uuid, md5('project' || n)::uuid, 4
  FROM generate_series(1, 2000) n, LATERAL unnest(ARRAY[2 + n %% 249, 251 + n %% 250]) p;
INSERT INTO access_grant (id, group_id, mission_id, level)
  SELECT gen_random_uuid(), md5('team' || 1 + n %% 60)::uuid, md5('mission' || n)::uuid, 1 + n %% 3
  FROM generate_series(1, 10000) n;
INSERT INTO access_grant (id, group_id, project_id, level)
  SELECT gen_random_uuid(), md5('own1')::uuid, id, 1 FROM project WHERE name_key NOT LIKE 'project-%%';
INSERT INTO token (id, person_id, name, secret_sha256, scopes)
  VALUES (gen_random_uuid(), md5('person1')::uuid, 'bench', %(secret)s, '{admin}');
"""


def rights_row(url: str, owner_token: str, database_url: str) -> dict[str, object]:
    """Fill the instance, then request each list as an admin and as a person with many grants, alternating."""
    reader = fill(database_url)
    ratios, lines = {}, []
    with urllib3.PoolManager(retries=False, timeout=60) as pool:
        for path in _LISTS:
            times: dict[str, list[float]] = {owner_token: [], reader: []}
            rows = {token: _ask(pool, url, path, token) for token in times}
            if rows[owner_token] != rows[reader]:
                raise SystemExit(f"{path}: the two lists are not the same")
            for number in range(_TIMES):
                for token in [owner_token, reader] if number % 2 else [reader, owner_token]:
                    started = time.perf_counter()
                    _ask(pool, url, path, token)
                    times[token].append(time.perf_counter() - started)
            admin_s, reader_s = (statistics.median(times[token]) for token in (owner_token, reader))
            ratios[path] = reader_s / admin_s
            lines.append(f"{path.replace('limit=100', '').strip('?&') or path} {reader_s * 1000:.0f} ms")
    worst = max(ratios, key=lambda path: ratios[path])
    return {
        "what": "lists of somebody with rights by 20 000 grants, beside an admin's",
        "measured": f"{ratios[worst]:.2f} x at worst ({worst})",
        "bar": f"<= {_BAR} x",
        "met": ratios[worst] <= _BAR,
        "also": ", ".join(lines),
        "ratios": ratios,
    }


def fill(database_url: str) -> str:
    """Insert people, groups, grants and their objects; returns the token of a person who can read everything."""
    token = secrets.token_urlsafe(32)
    secret = hashlib.sha256(token.encode()).digest()
    with psycopg.connect(database_url, autocommit=False) as database:
        (owner,) = database.execute("SELECT person_id FROM token WHERE name = 'local owner'").fetchone() or (None,)
        for statement in _FILL.split(";\n"):
            if statement.strip():
                database.execute(statement.encode(), {"owner": owner, "secret": secret})
        grants = database.execute("SELECT count(*) FROM access_grant").fetchone()
        if grants is None or grants[0] < 20_000:
            raise SystemExit(f"there are {grants} grants")
    # Wait for autovacuum: the serving role may not run ANALYZE.
    with psycopg.connect(database_url, autocommit=True) as database:
        while database.execute(_UNSEEN).fetchone() != (0,):
            time.sleep(1)
    return token


def _ask(pool: urllib3.PoolManager, url: str, path: str, token: str) -> list[str]:
    answer = pool.request("GET", f"{url}/api/v1/{path}", headers={"Authorization": f"Bearer {token}"})
    if answer.status >= 300:
        raise SystemExit(f"{path}: {answer.status} {answer.data.decode()}")
    return [item["id"] for item in json.loads(answer.data)["items"]]
