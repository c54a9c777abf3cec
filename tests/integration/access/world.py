"""The objects of the matrix: a private and a public project with their contents, and principals of every level.

Created once, mostly by direct inserts into the database. The calls of the matrix change nothing permanently.
"""

import random
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kleinkram.contract.access import Right, TokenKind
from kleinkram.server.access.builtin_groups import ADMINS_ID, OWNER_ID
from tests.integration import people
from tests.integration.access.credentials import MEMBER, WITH_GRANTS, WITHOUT_GRANTS, Credential, Kind, Reach
from tests.integration.access.expectations import AccessLevels
from tests.integration.api_server import Api
from tests.integration.people import Person, Token
from tests.integration.sample import Sample

LEVELS = range(5)
ACCESS_LEVELS = (
    *(AccessLevels(project, mission) for project in LEVELS for mission in LEVELS),
    *(
        AccessLevels(project, mission, is_public=True)
        for project, mission in ((0, 0), (1, 0), (0, 1), (2, 3), (0, 4), (4, 0))
    ),
)
_PAST_S, _AHEAD_S = -1, 3600


@dataclass(frozen=True)
class Objects:
    """The ids of one project, of its contents, and of the destinations of moves."""

    project: str
    project_name: str
    mission: str
    mission_name: str
    file: str
    other_file: str
    recording: str
    # In the trash, each deleted separately.
    trashed_mission: str
    trashed_file: str
    trashed_project: str
    # All principals with grants may create objects in this project.
    destination: str
    destination_mission: str
    # A link to the mission.
    link: str
    # An action of the project, an ended run of it on the mission, and an artifact of that run.
    action: str
    run: str
    artifact: str
    # An acceptance of a failing check of the mission, and a note on one.
    acceptance: str
    note: str
    # An event of the mission, which the owner added.
    event: str
    # A shared layout of the project, which the owner added.
    layout: str
    # A person who shares no group or project with anybody.
    unrelated_person: str
    unrelated_person_name: str


@dataclass(frozen=True)
class Principal:
    """A credential with access levels: its request headers, and an open upload of its person in the mission."""

    api: Api
    credential: Credential
    levels: AccessLevels
    objects: Objects
    headers: dict[str, str]
    upload: str
    person_id: str | None = None

    @property
    def named(self) -> str:
        """A description for the messages of failed tests."""
        granted = f"{self.levels.project} on the project, {self.levels.mission} on the mission"
        return f"{self.credential.name} with {granted}{' (public)' if self.levels.is_public else ''}"


@dataclass(frozen=True)
class World:
    """The API and all principals."""

    api: Api
    principals: Sequence[Principal]


def build(api: Api, *, levels_per_credential: int = len(ACCESS_LEVELS)) -> World:
    """Create all objects and principals: the member with all access levels, other credentials with a sample of them."""
    objects_by_visibility = {is_public: create_objects(api, is_public=is_public) for is_public in (False, True)}
    sampled = {
        credential: set(random.Random(credential.name).sample(ACCESS_LEVELS, levels_per_credential))
        for credential in WITH_GRANTS
    }
    sampled[MEMBER] = set(ACCESS_LEVELS)
    principals: list[Principal] = []
    for levels in ACCESS_LEVELS:
        credentials = [credential for credential in WITH_GRANTS if levels in sampled[credential]]
        principals += _principals_with_grants(api, levels, objects_by_visibility[levels.is_public], credentials)
    for is_public, items in objects_by_visibility.items():
        principals += _principals_without_grants(api, AccessLevels(is_public=is_public), items)
    return World(api, principals)


def create_objects(api: Api, *, is_public: bool) -> Objects:
    """Create a project and its contents."""
    sample = Sample(api)
    project, destination = api.project(), api.project()["id"]
    mission, destination_mission = api.mission(project["id"]), api.mission(destination)["id"]
    trashed_project, trashed_mission = api.project()["id"], api.mission(project["id"])["id"]
    topics = [{"name": "/imu", "message_type": "sensor_msgs/Imu", "count": 3}]
    file, other, trashed = (
        sample.file(mission["id"], f"{name}.mcap", topics=topics) for name in ("one", "two", "gone")
    )
    api.sql(
        "INSERT INTO recording_preview (blob_id, state, version, thumbnail) "
        "SELECT blob_id, 'failed', 1, 'JPEG' FROM file WHERE id = %s",
        file,
    )
    unrelated_person = people.person(api)
    action, run, artifact = _create_run(api, project["id"], mission["id"], file)
    acceptance, note = _create_checks(api, project["id"], mission["id"])
    added = api.post(f"/missions/{mission['id']}/events", {"name": "stumble", "start_ns": 1}).ok(201)
    layout_body = {"name": "cameras", "panels": ["raw:1@/imu"], "is_shared": True}
    layout = api.post(f"/projects/{project['id']}/viewer-layouts", layout_body).ok(201)
    items = Objects(
        project=project["id"],
        project_name=project["name"],
        mission=mission["id"],
        mission_name=mission["name"],
        file=file,
        other_file=other,
        recording=sample.recording(mission["id"], "one", [file]),
        trashed_mission=trashed_mission,
        trashed_file=trashed,
        trashed_project=trashed_project,
        destination=destination,
        destination_mission=destination_mission,
        link=people.share(api, mission["id"]).id,
        action=action,
        run=run,
        artifact=artifact,
        acceptance=acceptance,
        note=note,
        event=added["id"],
        layout=layout["id"],
        unrelated_person=unrelated_person.id,
        unrelated_person_name=unrelated_person.name,
    )
    api.sql("UPDATE project SET is_public = %s WHERE id = ANY(%s::uuid[])", is_public, [project["id"], trashed_project])
    # Old enough that uploaders may no longer delete their own files as recent uploads.
    api.sql("UPDATE file SET created_at = now() - interval '2 hours' WHERE mission_id = %s", mission["id"])
    for table, gone in (("mission", trashed_mission), ("file", trashed), ("project", trashed_project)):
        trash(api, table, gone)
    return items


ACTION = {"name": "count", "script": "print(1)"}


def _create_run(api: Api, project_id: str, mission_id: str, file_id: str) -> tuple[str, str, str]:
    """Create an action and an ended run; return the ids of the action, the run and an artifact of the run."""
    made = api.post("/actions", {"project_id": project_id, "definition": ACTION}).ok(201)
    expected = {"mission_ids": [mission_id], "action_id": made["id"], "force": True}
    run = api.post("/runs", expected).ok()["items"][0]["run"]["id"]
    api.post(f"/runs/{run}/cancel").ok()
    artifact = str(uuid.uuid4())
    api.sql(
        "INSERT INTO run_artifact (id, run_id, path, blob_id) SELECT %s, %s, %s, blob_id FROM file WHERE id = %s",
        *(artifact, run, "left.png", file_id),
    )
    shown = '[{"path": "left.png"}]'
    api.sql("UPDATE run SET state = 'done', reason = 'done', previews = %s WHERE id = %s", shown, run)
    api.sql("INSERT INTO run_check (run_id, name, status, message) VALUES (%s, 'a.check', 'ok', 'A check.')", run)
    api.sql("INSERT INTO run_finding (run_id, severity, code, message) VALUES (%s, 'info', 'code', 'A finding.')", run)
    api.sql("INSERT INTO run_metric (run_id, name, value) VALUES (%s, 'count', 1)", run)
    return made["id"], run, artifact


def _create_checks(api: Api, project_id: str, mission_id: str) -> tuple[str, str]:
    """Insert a version of a project's checks, an acceptance and a note; return the ids of the last two."""
    acceptance, note, hash_ = str(uuid.uuid4()), str(uuid.uuid4()), bytes(32)
    api.sql(
        "INSERT INTO project_checks (project_id, number, text, sha256, created_by_id) VALUES (%s, 1, '', %s, %s)",
        *(project_id, hash_, OWNER_ID),
    )
    api.sql(
        "INSERT INTO check_acceptance (id, mission_id, check_name, because, inputs_sha256, created_by_id)"
        " VALUES (%s, %s, 'topic.gap', 'A reason.', %s, %s)",
        *(acceptance, mission_id, hash_, OWNER_ID),
    )
    api.sql(
        "INSERT INTO check_note (id, mission_id, check_name, text, created_by_id)"
        " VALUES (%s, %s, 'topic.gap', 'x', %s)",
        *(note, mission_id, OWNER_ID),
    )
    return acceptance, note


def trash(api: Api, table: str, ref: str) -> None:
    """Move one object to the trash."""
    api.sql(f"UPDATE {table} SET deleted_at = now(), deleted_by_id = %s WHERE id = %s", OWNER_ID, ref)


def _grant(api: Api, group_id: str, levels: AccessLevels, items: Objects, *, expires_s: float | None = None) -> None:
    for project in (items.project, items.trashed_project):
        if levels.project:
            people.grant(api, group_id, Right.of_level(levels.project), project_id=project, expires_s=expires_s)
    for mission in (items.mission, items.trashed_mission):
        if levels.mission:
            people.grant(api, group_id, Right.of_level(levels.mission), mission_id=mission, expires_s=expires_s)
    people.grant(api, group_id, Right.create, project_id=items.destination, expires_s=expires_s)


def _principals_with_grants(
    api: Api, levels: AccessLevels, items: Objects, credentials: Sequence[Credential]
) -> Iterator[Principal]:
    """Create a person with each credential, and grant them these levels by a group or directly."""
    group_id, expired_id, other_project = people.group(api), people.group(api), api.project()["id"]
    _grant(api, group_id, levels, items)
    _grant(api, expired_id, levels, items, expires_s=_PAST_S)
    for credential in credentials:
        who = people.person(api, admin=credential.name.startswith("admin"))
        if credential.name == "person with grants of their own":
            _grant(api, who.group_id, levels, items)
        elif credential.name == "person whose grants expired":
            people.join(api, who, expired_id)
        else:
            people.join(api, who, group_id, expires_s=_PAST_S if credential.name == "expired member" else None)
        if credential.name == "admin whose membership of the admins expired":
            people.join(api, who, str(ADMINS_ID), expires_s=_PAST_S)
        reached = {
            Reach.project: [items.project, items.destination, items.trashed_project],
            Reach.mission: [items.mission, items.trashed_mission, items.destination],
            Reach.other_project: [other_project],
        }
        headers = _headers(api, credential, who, reached.get(credential.reach))
        upload = create_upload(api, who.id, items.mission)
        yield Principal(api, credential, levels, items, headers, upload, who.id)


def _headers(api: Api, credential: Credential, who: Person, limits: list[str] | None) -> dict[str, str]:
    if "session" in credential.name:
        cookie = people.session(api, who, expires_s=_PAST_S if credential.name.startswith("expired") else _AHEAD_S)
        origin = (
            "http://other-site.test" if credential.kind is Kind.cross_site else api.app.state.settings.public_origin
        )
        return {"Cookie": f"kleinkram={cookie}", "Origin": origin}
    kind = TokenKind.personal
    if credential.name == "runner":
        kind = TokenKind.runner
    elif credential.is_robot:
        kind = TokenKind.robot
    expires_s = _PAST_S if credential.name == "expired token" else _AHEAD_S
    made = people.token(api, who, credential.scopes, limits=limits, kind=kind, expires_s=expires_s)
    if credential.name == "revoked token":
        people.revoke(api, made)
    if credential.name == "deactivated person":
        people.deactivate(api, who)
    return _bearer(made)


def _principals_without_grants(api: Api, levels: AccessLevels, items: Objects) -> Iterator[Principal]:
    chosen = {Reach.file: [items.file], Reach.other_file: [items.other_file]}
    upload = create_upload(api, str(OWNER_ID), items.mission)
    for credential in WITHOUT_GRANTS:
        headers = {}
        if "link" in credential.name:
            expires_s = _PAST_S if credential.name == "ended link" else _AHEAD_S
            made = people.share(api, items.mission, file_ids=chosen.get(credential.reach), expires_s=expires_s)
            if credential.name == "revoked link":
                api.sql("UPDATE share SET revoked_at = now() WHERE id = %s", made.id)
            headers = _bearer(made)
        elif credential.name == "malformed token":
            headers = {"Authorization": "Bearer nonsense"}
        yield Principal(api, credential, levels, items, headers, upload)


def _bearer(made: Token) -> dict[str, str]:
    return {"Authorization": f"Bearer {made.secret}"}


def create_upload(api: Api, person_id: str, mission_id: str) -> str:
    """Insert an open upload without parts; return its id."""
    upload_id = str(uuid.uuid4())
    api.sql(
        "INSERT INTO upload (id, mission_id, person_id, path, path_key, size_bytes, part_size_bytes, checksum, key,"
        " lease_ends_at, expires_at) VALUES (%s, %s, %s, %s, %s, 8, 8388608, 'crc64nvme', %s,"
        " now() + interval '1 hour', now() + interval '1 day')",
        *(upload_id, mission_id, person_id, upload_id, upload_id, upload_id),
    )
    return upload_id
