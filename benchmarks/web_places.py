"""Data for the measurements of the web interface: missions with many files and topics, inserted into the database.

500 recordings of 600 topics each, 10 000 files of which half are recordings, and 200 000 files for a search to find.
"""

import time
import uuid

import psycopg

from kleinkram.client import Client
from kleinkram.recordings.message_density import count_stamps, pack

PROJECT = "field tests"
MANY_TOPICS, MANY_FILES = "many topics", "many files"
RECORDINGS, TOPICS, FILES, FOUND = 500, 600, 10_000, 200_000
_START_NS = 1_700_000_000_000_000_000
_APART_NS, _LONG_NS = 60_000_000_000, 59_000_000_000
_MESSAGES = 2_950
_BLOBS = """
INSERT INTO blob (id, key, size_bytes, sha256, md5, state, verified_at, uploaded_by_id, content, format, depth,
   start_ns,    end_ns, message_count, summarised_at)
  SELECT md5(%(name)s || n)::uuid, %(name)s || n, 1000000 + n, sha256((%(name)s || n)::bytea),
    decode(md5(%(name)s || n), 'hex'), 'verified', now(), %(owner)s, CASE WHEN is_read THEN 'indexed' ELSE 'opaque' END,
    CASE WHEN is_read THEN 'mcap' END, CASE WHEN is_read THEN 'summary' END,
    CASE WHEN is_read THEN %(start_ns)s + n * %(apart_ns)s END,
    CASE WHEN is_read THEN %(start_ns)s + n * %(apart_ns)s + %(long_ns)s END, 1000, now()
  FROM generate_series(0, %(files)s::int - 1) n, LATERAL (SELECT n %% %(every)s = 0 AS is_read) read
"""
_FILES = """
INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id, created_at, labels)
  SELECT md5('file' || blob.id)::uuid, %(mission)s, blob.id, path, path, 'upload', %(owner)s,
    now() - (%(files)s - n) * interval '5 seconds', CASE n %% 50 WHEN 0 THEN '{calibrated}'::text[] ELSE '{}' END
  FROM generate_series(%(first)s::int, %(last)s::int) n
  JOIN blob ON blob.key = %(name)s || n,
  LATERAL (SELECT coalesce('run_' || lpad((n %% nullif(%(folders)s, 0))::text, 2, '0') || '/', '') ||
    lpad(n::text, 6, '0') || '_drive' || CASE WHEN blob.format IS NULL THEN '.txt' ELSE '.mcap' END AS path) named
"""
_TOPICS = """
INSERT INTO topic (blob_id, name, message_type, schema_name, schema_encoding, message_encoding, count, first_ns,
    last_ns, rate_hz, longest_gap_ns, head_gap_ns, tail_gap_ns, out_of_order_count, stored_bytes, density)
  SELECT %(blob)s, '/robot/part_' || n / 20 || '/topic_' || n, kind, kind, 'ros2msg', 'cdr', %(count)s, %(first_ns)s,
    %(last_ns)s, 50, 20000000, 0, 0, 0, 100000, %(density)s
  FROM generate_series(1, %(topics)s) n,
  LATERAL (SELECT (ARRAY['sensor_msgs/msg/Imu', 'nav_msgs/msg/Odometry', 'std_msgs/msg/Float64'])
    [1 + n %% 3] AS kind) of
"""
# The number of filled tables that autovacuum has not analysed yet.
_UNSEEN = """
SELECT count(*) FROM pg_stat_user_tables WHERE last_autoanalyze IS NULL AND relname IN
  ('project', 'mission', 'file', 'blob', 'topic')
"""


def fill(client: Client, database_url: str) -> tuple[uuid.UUID, uuid.UUID, uuid.UUID]:
    """Insert everything; returns the project and the missions of many topics and of many files.

    Recordings and topics of the missions are not derived yet: an upload to a mission starts that.
    """
    project = client.projects.create(PROJECT).id
    archive = client.projects.create("archive").id
    many = client.missions.create(MANY_TOPICS, project=project).id
    files = client.missions.create(MANY_FILES, project=project).id
    older = [client.missions.create(f"day {day:03}", project=archive).id for day in range(100)]
    with psycopg.connect(database_url) as database:
        owner = database.execute("SELECT person_id FROM token WHERE name = 'local owner'").fetchone()
        common = {"owner": owner and owner[0], "start_ns": _START_NS, "long_ns": _LONG_NS}
        for name, missions, count, every, folders, apart_ns in (
            ("topics", [many], RECORDINGS, 1, 0, _APART_NS),
            ("files", [files], FILES, 2, 20, _LONG_NS // 4),
            ("found", older, FOUND, 1, 10, _APART_NS),
        ):
            of_these = {**common, "name": name, "every": every, "folders": folders, "apart_ns": apart_ns}
            of_these["files"] = count
            database.execute(_BLOBS, of_these)
            share = count // len(missions)
            for number, mission in enumerate(missions):
                bounds = {"mission": mission, "first": number * share, "last": (number + 1) * share - 1}
                database.execute(_FILES, {**of_these, **bounds})
        for number in range(RECORDINGS):
            _add_topics(database, number)
    # Wait for autovacuum: the serving role may not run ANALYZE.
    with psycopg.connect(database_url, autocommit=True) as database:
        while database.execute(_UNSEEN).fetchone() != (0,):
            time.sleep(1)
    return project, many, files


def seconds_to_derive(client: Client, mission_id: uuid.UUID) -> float:
    """Wait until a mission's stored topics are current; returns the seconds that took."""
    began = time.perf_counter()
    while not client.missions.topics(mission_id, bins=0).is_current:
        time.sleep(0.05)
    return time.perf_counter() - began


def _add_topics(database: "psycopg.Connection[tuple[object, ...]]", number: int) -> None:
    begin_ns = _START_NS + number * _APART_NS
    stamps = [begin_ns + at * _LONG_NS // _MESSAGES for at in range(_MESSAGES) if number % 7 or not 900 < at < 1_200]
    blob = database.execute("SELECT id FROM blob WHERE key = 'topics' || %s::text", [number]).fetchone()
    numbers = {"count": len(stamps), "first_ns": stamps[0], "last_ns": stamps[-1]}
    density = pack(count_stamps(stamps))
    database.execute(_TOPICS, {"blob": blob and blob[0], "topics": TOPICS, "density": density, **numbers})
