"""The objects of the matrix: a private and a public project with everything in it, and people at every level.

Made once, behind the API's back. Nothing that the matrix asks for changes it for good.
"""

import random
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kleinkram.contract.access import Right, TokenKind
from kleinkram.server.access.builtin_groups import ADMINS_ID, OWNER_ID
from tests.integration import people
from tests.integration.access.credentials import MEMBER, PLACED, UNPLACED, Carrier, Reach
from tests.integration.access.expectations import Place
from tests.integration.api_server import Api
from tests.integration.people import Person, Token
from tests.integration.sample import Sample

LEVELS = range(5)
PLACES = (
    *(Place(project, mission) for project in LEVELS for mission in LEVELS),
    *(Place(project, mission, is_public=True) for project, mission in ((0, 0), (1, 0), (0, 1), (2, 3), (0, 4), (4, 0))),
)
_PAST_S, _AHEAD_S = -1, 3600


@dataclass(frozen=True)
class Things:
    """The ids of one project, of all that it holds, and of where it may be moved."""

    project: str
    project_name: str
    mission: str
    mission_name: str
    file: str
    other_file: str
    recording: str
    # In the trash, each by itself.
    trashed_mission: str
    trashed_file: str
    trashed_project: str
    # In a project that all who hold anything may fill.
    target: str
    target_mission: str
    # A link to the mission, and somebody who shares nothing with anybody.
    link: str
    # An action of the project, and a run of it on the mission that is over, with what it left and said.
    action: str
    run: str
    artifact: str
    hermit: str
    hermit_name: str


@dataclass(frozen=True)
class Principal:
    """Somebody in one place, what their requests carry, an upload they began in the mission; `api` is for behind it."""

    api: Api
    carrier: Carrier
    place: Place
    objects: Things
    headers: dict[str, str]
    upload: str
    person_id: str | None = None

    @property
    def named(self) -> str:
        """Who it is, for the message of a test that failed."""
        levels = f"{self.place.project} on the project, {self.place.mission} on the mission"
        return f"{self.carrier.name} with {levels}{' (public)' if self.place.is_public else ''}"


@dataclass(frozen=True)
class World:
    """The API, what it holds, and all who ask."""

    api: Api
    principals: Sequence[Principal]


def build(api: Api, *, places_each: int = len(PLACES)) -> World:
    """Put everything and everybody into an API's database; the plain member in all places, others in so many."""
    sides = {is_public: put_things(api, is_public=is_public) for is_public in (False, True)}
    expected = {carrier: set(random.Random(carrier.name).sample(PLACES, places_each)) for carrier in PLACED}
    expected[MEMBER] = set(PLACES)
    principals: list[Principal] = []
    for place in PLACES:
        carriers = [carrier for carrier in PLACED if place in expected[carrier]]
        principals += _placed(api, place, sides[place.is_public], carriers)
    for is_public, items in sides.items():
        principals += _unplaced(api, Place(is_public=is_public), items)
    return World(api, principals)


def put_things(api: Api, *, is_public: bool) -> Things:
    """Put a project, public or not, and all that is in it."""
    sample = Sample(api)
    project, target = api.project(), api.project()["id"]
    mission, target_mission = api.mission(project["id"]), api.mission(target)["id"]
    trashed_project, trashed_mission = api.project()["id"], api.mission(project["id"])["id"]
    topics = [{"name": "/imu", "message_type": "sensor_msgs/Imu", "count": 3}]
    file, other, trashed = (
        sample.file(mission["id"], f"{name}.mcap", topics=topics) for name in ("one", "two", "gone")
    )
    hermit = people.person(api)
    action, run, artifact = _put_run(api, project["id"], mission["id"], file)
    items = Things(
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
        target=target,
        target_mission=target_mission,
        link=people.share(api, mission["id"]).id,
        action=action,
        run=run,
        artifact=artifact,
        hermit=hermit.id,
        hermit_name=hermit.name,
    )
    api.sql("UPDATE project SET is_public = %s WHERE id = ANY(%s::uuid[])", is_public, [project["id"], trashed_project])
    # Old enough that the uploader may no longer delete them as recent uploads.
    api.sql("UPDATE file SET created_at = now() - interval '2 hours' WHERE mission_id = %s", mission["id"])
    for table, gone in (("mission", trashed_mission), ("file", trashed), ("project", trashed_project)):
        trash(api, table, gone)
    return items


ACTION = {"name": "count", "script": "print(1)"}


def _put_run(api: Api, project_id: str, mission_id: str, file_id: str) -> tuple[str, str, str]:
    """Put an action, and a run of it that is over; returns the ids of both, and of what the run left."""
    made = api.post("/actions", {"project_id": project_id, "definition": ACTION}).ok(201)
    expected = {"mission_ids": [mission_id], "action_id": made["id"], "force": True}
    run = api.post("/runs", expected).ok()["items"][0]["run"]["id"]
    api.post(f"/runs/{run}/cancel").ok()
    artifact = str(uuid.uuid4())
    api.sql(
        "INSERT INTO run_artifact (id, run_id, path, blob_id) SELECT %s, %s, 'left', blob_id FROM file WHERE id = %s",
        *(artifact, run, file_id),
    )
    api.sql(
        "INSERT INTO run_finding (run_id, severity, code, message) VALUES (%s, 'info', 'seen', 'It was seen.')", run
    )
    api.sql("INSERT INTO run_metric (run_id, name, value) VALUES (%s, 'count', 1)", run)
    return made["id"], run, artifact


def trash(api: Api, table: str, ref: str) -> None:
    """Put something into the trash, by itself."""
    api.sql(f"UPDATE {table} SET deleted_at = now(), deleted_by_id = %s WHERE id = %s", OWNER_ID, ref)


def _grant(api: Api, group_id: str, place: Place, items: Things, *, expires_s: float | None = None) -> None:
    for project in (items.project, items.trashed_project):
        if place.project:
            people.grant(api, group_id, Right.of_level(place.project), project_id=project, expires_s=expires_s)
    for mission in (items.mission, items.trashed_mission):
        if place.mission:
            people.grant(api, group_id, Right.of_level(place.mission), mission_id=mission, expires_s=expires_s)
    people.grant(api, group_id, Right.create, project_id=items.target, expires_s=expires_s)


def _placed(api: Api, place: Place, items: Things, carriers: Sequence[Carrier]) -> Iterator[Principal]:
    """Give everybody who comes by a group, or by grants of their own, the levels of a place."""
    group_id, expired_id, elsewhere = people.group(api), people.group(api), api.project()["id"]
    _grant(api, group_id, place, items)
    _grant(api, expired_id, place, items, expires_s=_PAST_S)
    for carrier in carriers:
        who = people.person(api, admin=carrier.name.startswith("admin"))
        if carrier.name == "person with grants of their own":
            _grant(api, who.group_id, place, items)
        elif carrier.name == "person whose grants expired":
            people.join(api, who, expired_id)
        else:
            people.join(api, who, group_id, expires_s=_PAST_S if carrier.name == "expired member" else None)
        if carrier.name == "admin whose membership of the admins expired":
            people.join(api, who, str(ADMINS_ID), expires_s=_PAST_S)
        reached = {
            Reach.project: [items.project, items.target, items.trashed_project],
            Reach.mission: [items.mission, items.trashed_mission, items.target],
            Reach.elsewhere: [elsewhere],
        }
        headers = _headers(api, carrier, who, reached.get(carrier.reach))
        upload = begun(api, who.id, items.mission)
        yield Principal(api, carrier, place, items, headers, upload, who.id)


def _headers(api: Api, carrier: Carrier, who: Person, limits: list[str] | None) -> dict[str, str]:
    if "session" in carrier.name:
        cookie = people.session(api, who, expires_s=_PAST_S if carrier.name.startswith("expired") else _AHEAD_S)
        origin = "http://elsewhere.test" if "lured" in carrier.name else api.app.state.settings.public_origin
        return {"Cookie": f"kleinkram={cookie}", "Origin": origin}
    kind = TokenKind.personal
    if carrier.name == "runner":
        kind = TokenKind.runner
    elif carrier.is_robot:
        kind = TokenKind.robot
    expires_s = _PAST_S if carrier.name == "expired token" else _AHEAD_S
    made = people.token(api, who, carrier.scopes, limits=limits, kind=kind, expires_s=expires_s)
    if carrier.name == "revoked token":
        people.revoke(api, made)
    if carrier.name == "deactivated person":
        people.deactivate(api, who)
    return _bearer(made)


def _unplaced(api: Api, place: Place, items: Things) -> Iterator[Principal]:
    chosen = {Reach.file: [items.file], Reach.other_file: [items.other_file]}
    upload = begun(api, str(OWNER_ID), items.mission)
    for carrier in UNPLACED:
        headers = {}
        if "link" in carrier.name:
            expires_s = _PAST_S if carrier.name == "ended link" else _AHEAD_S
            made = people.share(api, items.mission, file_ids=chosen.get(carrier.reach), expires_s=expires_s)
            if carrier.name == "revoked link":
                api.sql("UPDATE share SET revoked_at = now() WHERE id = %s", made.id)
            headers = _bearer(made)
        elif carrier.name == "carrier of nonsense":
            headers = {"Authorization": "Bearer nonsense"}
        yield Principal(api, carrier, place, items, headers, upload)


def _bearer(made: Token) -> dict[str, str]:
    return {"Authorization": f"Bearer {made.secret}"}


def begun(api: Api, person_id: str, mission_id: str) -> str:
    """Put an upload that somebody began, of which nothing was sent yet; returns its id."""
    upload_id = str(uuid.uuid4())
    api.sql(
        "INSERT INTO upload (id, mission_id, person_id, path, path_key, size_bytes, part_size_bytes, checksum, key,"
        " lease_ends_at, expires_at) VALUES (%s, %s, %s, %s, %s, 8, 8388608, 'crc64nvme', %s,"
        " now() + interval '1 hour', now() + interval '1 day')",
        *(upload_id, mission_id, person_id, upload_id, upload_id, upload_id),
    )
    return upload_id
