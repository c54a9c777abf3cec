"""Words are looked up as fast after a large import as before."""

import json
from typing import Any

from tests.integration.conftest import StartApi
from tests.integration.sample import Sample

_FILES = 20_000
_COPY = """
INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)
  SELECT gen_random_uuid(), mission_id, blob_id, name, name, origin, uploaded_by_id
  FROM file, generate_series(1, %s) n, LATERAL (SELECT 'run_' || n || '/part_' || n || '.mcap' AS name) named
"""
_LOOK = "EXPLAIN (ANALYZE, BUFFERS, FORMAT JSON) SELECT id FROM file WHERE start_ns IS NULL AND path_key LIKE %s"


def test_recent_rows_are_not_read_for_each_word(start_api: StartApi) -> None:
    api = start_api()
    Sample(api).file(api.mission(api.project(name="last")["id"], name="forest")["id"], "one.mcap")
    api.sql(_COPY, _FILES)
    api.sql("SET enable_seqscan = off")
    (plan,) = api.sql(_LOOK, "%zzyzx%")[0][0]
    assert "ix_file_words_untimed" in json.dumps(plan)
    assert _pages(plan["Plan"]) < 80


def _pages(plan: dict[str, Any]) -> int:
    return int(plan["Shared Hit Blocks"] + plan["Shared Read Blocks"])
