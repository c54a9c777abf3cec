# ruff: noqa: E501  (tables of names, and statements whose lines are rows)
"""The SQL of the seeding. Each step: its name, a query that returns a row once it is done, and the statement.

Everything is drawn by hashes of numbers, so it is the same every time. `%(projects)s` and so on are how many there are.
"""

_METADATA = """(SELECT
  ARRAY['Ada', 'Bao', 'Chiara', 'Dimitri', 'Elif', 'Farah', 'Goran', 'Hana', 'Ibrahim', 'Jun', 'Katya', 'Luis'] first,
  ARRAY['Abegg', 'Baumann', 'Conti', 'Dubois', 'Eriksen', 'Frei', 'Gupta', 'Huber', 'Ito', 'Jovic', 'Keller'] last,
  ARRAY['forest', 'alps', 'mine', 'harbour', 'glacier', 'campus', 'tunnel', 'vineyard', 'quarry', 'lake'] place,
  ARRAY['anymal', 'husky', 'spot', 'hydra', 'falcon'] robot,
  ARRAY['sunny', 'overcast', 'rain', 'snow', 'fog'] weather) said"""
# One mission in a thousand is large; the others have sixteen files on average.
_LARGE, _LARGE_FILES = 1000, 4050
_FILES_OF = f"CASE WHEN m %% {_LARGE} = 0 THEN {_LARGE_FILES} ELSE 8 + abs(hashtext('files' || m)) %% 17 END"
_TEN_YEARS_NS = 315_360_000_000_000_000
_BEGAN_NS = 1_388_534_400_000_000_000  # 2014
_PART_NS = 600_000_000_000
# Maps numbers to values; the first projects have most missions, as in a real lab.
_MISSION = f"""
  SELECT m, md5('mission' || m)::uuid AS id, 1 + abs(hashtext('robot' || m)) %% 5 AS robot,
    1 + floor(%(projects)s * power((abs(hashtext('in' || m)) %% 1000000) / 1e6, 1.6))::int AS p,
    ({_BEGAN_NS} + m * ({_TEN_YEARS_NS} / %(missions)s) / 1000000 * 1000000)::bigint AS start_ns,
    {_FILES_OF} AS files
  FROM generate_series(1, %(missions)s::int) m
"""
# The eighth and ninth of every ten files are no recordings. Two consecutive files are one recording in two parts.
_FILE = f"""
  SELECT m, i, id AS mission_id, robot, md5('blob' || m || '-' || i)::uuid AS blob_id,
    i %% 10 < 8 AS is_recording, abs(hashtext('luck' || m || '-' || i)) %% 1000 AS luck,
    (start_ns + i * {_PART_NS})::bigint AS start_ns,
    (ARRAY['.mcap', '.bag', '.db3'])[1 + robot %% 3] AS ending, (ARRAY['mcap', 'rosbag1', 'db3'])[1 + robot %% 3] AS format
  FROM ({_MISSION}) missions, generate_series(0, files - 1) i
"""
_PEOPLE = f"""
INSERT INTO person (id, name, created_at)
  SELECT md5('person' || n)::uuid, first[1 + n %% 12] || ' ' || last[1 + n / 12 %% 11] || ' ' || n, now() - n * interval '1 day'
  FROM generate_series(1, %(people)s::int) n, {_METADATA};
"""
_OWN_GROUPS = """
INSERT INTO access_group (id, kind, name, name_key, person_id)
  SELECT md5('own' || n)::uuid, 'person', name, lower(name), person.id
  FROM generate_series(1, %(people)s::int) n JOIN person ON person.id = md5('person' || n)::uuid
"""
_GROUPS = """
INSERT INTO access_group (id, kind, name, name_key)
  SELECT md5('team' || n)::uuid, 'custom', 'Team ' || n, 'team ' || n FROM generate_series(1, %(groups)s::int) n
"""
# The first person is in ten groups that together read everything, the second in one of them, the third in none.
_MEMBERSHIPS = """
INSERT INTO membership (group_id, person_id)
  SELECT md5('own' || n)::uuid, md5('person' || n)::uuid FROM generate_series(1, %(people)s::int) n
  UNION ALL
  SELECT md5('team' || t)::uuid, md5('person' || n)::uuid
  FROM generate_series(1, %(groups)s::int) t, generate_series(1, %(people)s::int) n
  WHERE n = 1 AND t <= 10 OR n = 2 AND t = 3 OR n > 3 AND (n + t) %% 12 = 0
"""
_PROJECTS = f"""
INSERT INTO project (id, name, name_key, description, metadata_fields, created_by_id, created_at, is_public)
  SELECT md5('project' || n)::uuid, place[1 + n %% 10] || ' ' || robot[1 + n %% 5] || ' ' || lpad(n::text, 4, '0'),
    place[1 + n %% 10] || ' ' || robot[1 + n %% 5] || ' ' || lpad(n::text, 4, '0'),
    'What ' || robot[1 + n %% 5] || ' did in the ' || place[1 + n %% 10], '{{"fields": []}}', %(owner)s,
    now() - n * interval '3 days', n %% 100 = 50
  FROM generate_series(1, %(projects)s::int) n, {_METADATA}
"""
_MISSIONS = f"""
INSERT INTO mission (id, project_id, name, name_key, metadata, metadata_problems, notes, created_by_id, created_at,
    start_ns, end_ns, deleted_at, deleted_by_id)
  SELECT id, md5('project' || p)::uuid, place[1 + m %% 10] || '_' || lpad(m::text, 6, '0'),
    place[1 + m %% 10] || '_' || lpad(m::text, 6, '0'),
    jsonb_build_object('robot', said.robot[missions.robot] || '-' || lpad((m %% 12)::text, 2, '0'), 'operator', last[1 + m / 7 %% 11],
      'temperature', round((abs(hashtext('t' || m)) %% 500 - 150) / 10.0, 1), 'weather', weather[1 + m %% 5], 'indoor', m %% 9 = 0,
      'site', jsonb_build_object('name', place[1 + m %% 10], 'latitude', 46 + m %% 100 / 50.0), 'run', m,
      'goals', jsonb_build_array('mapping', CASE WHEN m %% 4 = 0 THEN 'grasping' ELSE 'locomotion' END)),
    CASE WHEN m %% 40 = 0 THEN '[{{"field": "payload", "message": "is missing; it is required"}}]'::jsonb ELSE '[]' END,
    CASE WHEN m %% 25 = 0 THEN 'the left knee was replaced before run ' || m ELSE '' END, %(owner)s,
    to_timestamp(start_ns / 1e9) + interval '1 day', start_ns, start_ns + files * {_PART_NS},
    CASE WHEN m %% 200 = 77 THEN now() - interval '3 days' END, CASE WHEN m %% 200 = 77 THEN %(owner)s::uuid END
  FROM ({_MISSION}) missions, {_METADATA}
"""
_RECORDINGS = f"""
INSERT INTO recording (id, mission_id, name, kind, message_count, start_ns, end_ns, content)
  SELECT md5('recording' || m || '-' || i / 2)::uuid, mission_id, 'part_' || lpad((i / 2)::text, 4, '0'), 'split', 200000,
    start_ns, start_ns + 2 * {_PART_NS} - 1000000, 'indexed'
  FROM ({_FILE}) files WHERE is_recording AND i %% 2 = 0
"""
_BLOBS = f"""
INSERT INTO blob (id, store_id, key, size_bytes, sha256, md5, state, state_reason, verified_at, uploaded_by_id, created_at, content,
    content_reason, format, depth, message_count, start_ns, end_ns, summarised_at)
  SELECT blob_id, 'scale', blob_id || '/' || robot || '/' || i, CASE WHEN is_recording THEN 200000000 + abs(hashtext('s' || m || '-' || i)) %% 1000000000
      ELSE 500 + abs(hashtext('s' || m || '-' || i)) %% 100000 END,
    sha256((m || '-' || i)::bytea), decode(md5(m || '-' || i), 'hex'),
    CASE luck WHEN 1 THEN CASE WHEN m %% 10 = 0 THEN 'corrupt' ELSE 'verified' END ELSE 'verified' END,
    NULL, to_timestamp(start_ns / 1e9) + interval '2 days', %(owner)s, to_timestamp(start_ns / 1e9) + interval '1 day',
    CASE WHEN NOT is_recording THEN 'opaque' WHEN luck < 10 THEN 'broken' WHEN luck < 13 THEN 'recovered' ELSE 'indexed' END,
    CASE WHEN is_recording AND luck < 10 THEN 'the chunk at 1048576 ends in its middle' END,
    CASE WHEN is_recording THEN format WHEN i %% 10 = 8 THEN 'yaml' ELSE 'csv' END, CASE WHEN is_recording THEN 'summary' END,
    CASE WHEN is_recording AND luck >= 10 THEN 100000 END, CASE WHEN is_recording AND luck >= 10 THEN start_ns END,
    CASE WHEN is_recording AND luck >= 10 THEN start_ns + {_PART_NS} - 1000000 END, to_timestamp(start_ns / 1e9) + interval '2 days'
  FROM ({_FILE}) files ORDER BY blob_id
"""
_FILES = f"""
INSERT INTO file (id, mission_id, recording_id, blob_id, path, path_key, origin, uploaded_by_id, labels, created_at, deleted_at,
    deleted_by_id)
  SELECT md5('file' || m || '-' || i)::uuid, mission_id, CASE WHEN is_recording THEN md5('recording' || m || '-' || i / 2)::uuid END,
    blob_id, path, path, 'upload', %(owner)s,
    CASE WHEN luck %% 20 = 3 THEN '{{calibrated}}'::text[] WHEN luck %% 100 = 4 THEN '{{ground truth,train}}' ELSE '{{}}' END,
    to_timestamp(start_ns / 1e9) + interval '1 day', CASE WHEN luck = 999 THEN now() - interval '2 days' END,
    CASE WHEN luck = 999 THEN %(owner)s::uuid END
  FROM ({_FILE}) files, {_METADATA},
    LATERAL (SELECT CASE WHEN is_recording THEN 'drive_' || place[1 + m %% 10] || '_' || lpad((i / 2)::text, 4, '0') || '_' || i %% 2 || ending
      WHEN i %% 10 = 8 THEN 'config/calibration_' || i || '.yaml' ELSE 'logs/power_' || i || '.csv' END AS path) named
"""
# Five kinds of robots: topics of all, topics of each kind, and now and then a topic of one mission only.
TOPICS = """
WITH vocabulary (robot, names, types) AS (VALUES
  (1, ARRAY['/anymal/joint_states', '/anymal/feet/contacts', '/anymal/elevation_map', '/anymal/lidar/points', '/anymal/front/image_raw/compressed', '/anymal/gait'],
      ARRAY['sensor_msgs/msg/JointState', 'anymal_msgs/msg/Contacts', 'grid_map_msgs/msg/GridMap', 'sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/CompressedImage', 'std_msgs/msg/String']),
  (2, ARRAY['/husky/cmd_vel', '/husky/wheels', '/husky/velodyne_points', '/husky/gps/fix', '/husky/battery', '/husky/front/image_raw'],
      ARRAY['geometry_msgs/msg/Twist', 'husky_msgs/msg/Wheels', 'sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/NavSatFix', 'sensor_msgs/msg/BatteryState', 'sensor_msgs/msg/Image']),
  (3, ARRAY['/spot/joint_states', '/spot/depth/left', '/spot/depth/right', '/spot/camera/frontleft', '/spot/camera/frontright', '/spot/gripper', '/spot/status'],
      ARRAY['sensor_msgs/msg/JointState', 'sensor_msgs/msg/Image', 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage', 'sensor_msgs/msg/CompressedImage', 'spot_msgs/msg/Gripper', 'spot_msgs/msg/Status']),
  (4, ARRAY['/hydra/sonar', '/hydra/pressure', '/hydra/thrusters', '/hydra/dvl', '/hydra/usbl', '/hydra/camera/image_raw/compressed', '/hydra/leak'],
      ARRAY['marine_msgs/msg/Sonar', 'sensor_msgs/msg/FluidPressure', 'marine_msgs/msg/Thrusters', 'marine_msgs/msg/Dvl', 'marine_msgs/msg/Usbl', 'sensor_msgs/msg/CompressedImage', 'std_msgs/msg/Bool']),
  (5, ARRAY['/falcon/mavros/state', '/falcon/mavros/rc/in', '/falcon/gps/fix', '/falcon/event_camera/events', '/falcon/motors', '/falcon/wind', '/falcon/camera/image_raw'],
      ARRAY['mavros_msgs/msg/State', 'mavros_msgs/msg/RCIn', 'sensor_msgs/msg/NavSatFix', 'dvs_msgs/msg/EventArray', 'falcon_msgs/msg/Motors', 'geometry_msgs/msg/Vector3Stamped', 'sensor_msgs/msg/Image'])
), common (names, types) AS (VALUES
  (ARRAY['/tf', '/tf_static', '/rosout', '/imu/data', '/odom', '/diagnostics'],
   ARRAY['tf2_msgs/msg/TFMessage', 'tf2_msgs/msg/TFMessage', 'rcl_interfaces/msg/Log', 'sensor_msgs/msg/Imu', 'nav_msgs/msg/Odometry', 'diagnostic_msgs/msg/DiagnosticArray'])
), chosen AS (
  SELECT blob.id, blob.start_ns, blob.end_ns, vocabulary.names || common.names ||
      CASE WHEN abs(hashtext(key)) %% 2000 = 0 THEN ARRAY['/experiment/trial_' || abs(hashtext(key)) %% 100000] ELSE '{}' END AS names,
    vocabulary.types || common.types || CASE WHEN abs(hashtext(key)) %% 2000 = 0 THEN ARRAY['std_msgs/msg/Float64'] ELSE '{}' END AS types
  FROM blob JOIN vocabulary ON vocabulary.robot = split_part(key, '/', 2)::int, common
  WHERE blob.id BETWEEN %(low)s::uuid AND %(high)s::uuid AND store_id = 'scale' AND content IN ('indexed', 'recovered') ORDER BY blob.id
)
INSERT INTO topic (blob_id, name, message_type, schema_name, schema_encoding, message_encoding, count, first_ns, last_ns, rate_hz,
    longest_gap_ns, head_gap_ns, tail_gap_ns, out_of_order_count, stored_bytes)
  SELECT id, name, type, type, 'ros2msg', 'cdr', 600 * rate, start_ns, end_ns, rate, 1000000000 / rate, 0, 0, 0, 60000 * rate
  FROM chosen, unnest(names, types) each(name, type), LATERAL (SELECT (ARRAY[1, 10, 20, 50, 100])[1 + abs(hashtext(name)) %% 5] AS rate) of
"""
TOPICS_DONE = "SELECT FROM topic WHERE blob_id = (SELECT max(id::text)::uuid FROM blob WHERE store_id = 'scale' AND content = 'indexed' AND id BETWEEN %(low)s::uuid AND %(high)s::uuid)"
_MISSION_TOPICS = """
WITH headers AS (
  INSERT INTO mission_topics (mission_id, revision, recording_ids, bin_ns)
    SELECT id, 0, '{}', 1 FROM mission WHERE id IN (SELECT md5('mission' || m)::uuid FROM generate_series(1, %(missions)s::int) m)
)
INSERT INTO mission_topic (mission_id, name, message_type, count, file_count, recording_count, recording_ranges, first_ns, last_ns, rate_hz)
  SELECT file.mission_id, topic.name, topic.message_type, sum(topic.count), count(*), count(DISTINCT recording_id), '{}', min(topic.first_ns), max(topic.last_ns), max(rate_hz)
  FROM topic JOIN file USING (blob_id) JOIN blob ON blob.id = blob_id WHERE store_id = 'scale' AND file.deleted_at IS NULL
  GROUP BY file.mission_id, topic.name, topic.message_type
"""
# The amounts stored with each mission when its recordings are derived.
_AMOUNTS = """
UPDATE mission SET file_count = held.files, size_bytes = held.bytes, message_count = held.messages, unread_count = held.unread,
    duration_ns = coalesce((SELECT sum(end_ns - start_ns) FROM recording WHERE recording.mission_id = mission.id), 0)
  FROM (
    SELECT mission.id, count(blob.id) AS files, coalesce(sum(blob.size_bytes), 0) AS bytes, coalesce(sum(blob.message_count), 0) AS messages,
      count(blob.id) FILTER (WHERE blob.summarised_at IS NULL OR blob.content = 'pending') AS unread
    FROM mission LEFT JOIN file ON file.mission_id = mission.id AND file.deleted_at IS NULL LEFT JOIN blob ON blob.id = file.blob_id
    GROUP BY mission.id
  ) held WHERE held.id = mission.id
"""
# Grants to the ten groups of the first person, to single people, and to groups on single missions.
_GRANTS = """
INSERT INTO access_grant (id, group_id, project_id, level)
  SELECT gen_random_uuid(), md5('team' || t)::uuid, md5('project' || n)::uuid, 1 + n %% 4
  FROM generate_series(1, %(projects)s::int) n, LATERAL unnest(ARRAY[1 + n %% 10, 11 + n %% 25, 36 + n %% 25]) t
  UNION ALL
  SELECT gen_random_uuid(), md5('own' || 4 + (n * 97 + p * 5) %% (%(people)s - 3))::uuid, md5('project' || n)::uuid, 4
  FROM generate_series(1, %(projects)s::int) n, generate_series(1, 50) p
"""
_MISSION_GRANTS = """
INSERT INTO access_grant (id, group_id, mission_id, level)
  SELECT gen_random_uuid(), md5('team' || 1 + m %% %(groups)s)::uuid, md5('mission' || m)::uuid, 1 + m %% 3
  FROM generate_series(1, %(missions)s::int) m
  UNION ALL
  SELECT gen_random_uuid(), md5('own' || 4 + m %% (%(people)s - 3))::uuid, md5('mission' || m)::uuid, 2
  FROM generate_series(1, %(missions)s::int, 2) m
  UNION ALL
  SELECT gen_random_uuid(), md5('own3')::uuid, md5('mission' || m)::uuid, 1
  FROM generate_series(7, %(missions)s::int, %(missions)s / 12) m
"""
_TOKENS = """
INSERT INTO token (id, person_id, name, secret_sha256, scopes)
  SELECT gen_random_uuid(), md5('person' || n)::uuid, 'bench', secret, '{admin}'
  FROM (VALUES (1, %(secret_0)s::bytea), (2, %(secret_1)s::bytea), (3, %(secret_2)s::bytea)) of(n, secret)
"""


def _last(table: str, kind: str, number: str) -> str:
    return f"SELECT FROM {table} WHERE id = md5('{kind}' || %({number})s)::uuid"


_ALL_BLOBS = "SELECT FROM blob WHERE id = md5('blob' || %(missions)s || '-0')::uuid"
WHOLE_BEFORE = (
    ("people", _last("person", "person", "people"), _PEOPLE),
    ("own groups", _last("access_group", "own", "people"), _OWN_GROUPS),
    ("groups", _last("access_group", "team", "groups"), _GROUPS),
    ("memberships", "SELECT FROM membership WHERE person_id = md5('person2')::uuid", _MEMBERSHIPS),
    ("projects", _last("project", "project", "projects"), _PROJECTS),
    ("missions", _last("mission", "mission", "missions"), _MISSIONS),
    ("recordings", "SELECT FROM recording WHERE id = md5('recording' || %(missions)s || '-0')::uuid", _RECORDINGS),
    ("bytes", _ALL_BLOBS, _BLOBS),
    ("files", "SELECT FROM file WHERE id = md5('file' || %(missions)s || '-0')::uuid", _FILES),
)
WHOLE_AFTER = (
    ("amounts of missions", "SELECT FROM mission WHERE file_count IS NOT NULL LIMIT 1", _AMOUNTS),
    ("topics of missions", "SELECT FROM mission_topic LIMIT 1", _MISSION_TOPICS),
    ("grants on projects", "SELECT FROM access_grant WHERE project_id = md5('project1')::uuid", _GRANTS),
    ("grants on missions", "SELECT FROM access_grant WHERE group_id = md5('own3')::uuid", _MISSION_GRANTS),
    ("tokens", "SELECT FROM token WHERE name = 'bench'", _TOKENS),
)
