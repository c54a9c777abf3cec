"""A model of what each credential may see, in sets in memory, to compare with lists and numbers of the API.

A seed determines a small lab: projects, missions, files and recordings, some public, some in the trash; people with
direct grants and grants of groups, some expired; and credentials with and without limits.
"""

import random
import uuid
from dataclasses import dataclass, field

from kleinkram.contract.access import Right, Scope
from kleinkram.server.access.builtin_groups import OWNER_ID
from tests.integration import people
from tests.integration.access.world import trash
from tests.integration.api_server import Api
from tests.integration.people import Person
from tests.integration.sample import Sample

_READ, _OWNER = 1, 4


@dataclass
class File:
    """A file with a topic of a unique name, in a recording of its own or in the recording of the split files."""

    id: str
    path: str
    mission: "Mission"
    size_bytes: int
    messages: int
    recording: str
    by: str
    is_deleted: bool = False


@dataclass
class Mission:
    """A mission."""

    id: str
    name: str
    project: "Project"
    files: list[File] = field(default_factory=list)
    is_deleted: bool = False


@dataclass
class Project:
    """A project."""

    id: str
    name: str
    is_public: bool
    missions: list[Mission] = field(default_factory=list)
    is_deleted: bool = False


@dataclass
class Viewer:
    """A credential: its `levels` by id of project or mission, and the ids that it is limited to; None for no limit."""

    name: str
    secret: str | None
    levels: dict[str, int] = field(default_factory=dict)
    person_id: str = ""
    reads: bool = True
    is_admin: bool = False
    is_link: bool = False
    reach: set[str] | None = None
    files: set[str] | None = None


@dataclass
class Lab:
    """The API, its objects, and the credentials that list them."""

    api: Api
    seed: int
    projects: list[Project]
    viewers: list[Viewer]

    @property
    def missions(self) -> list[Mission]:
        """All missions."""
        return [mission for project in self.projects for mission in project.missions]

    @property
    def files(self) -> list[File]:
        """All files."""
        return [file for mission in self.missions for file in mission.files]


def level(viewer: Viewer, place: Project | Mission) -> int:
    """Return the level that a credential has on a project or a mission, whether or not it is in the trash."""
    project = place if isinstance(place, Project) else place.project
    if viewer.reach is not None and not viewer.reach & {place.id, project.id}:
        return 0
    if viewer.is_link:
        return 0 if place is project else _READ
    public = _READ if project.is_public else 0
    return _OWNER if viewer.is_admin else max(public, *(viewer.levels.get(item.id, 0) for item in (place, project)))


def sees_project(viewer: Viewer, project: Project) -> bool:
    """Whether a project is listed."""
    return not project.is_deleted and level(viewer, project) >= _READ


def sees_mission(viewer: Viewer, mission: Mission) -> bool:
    """Whether a mission is listed."""
    return not mission.is_deleted and not mission.project.is_deleted and level(viewer, mission) >= _READ


def is_shown(viewer: Viewer, file: File) -> bool:
    """Whether a file of a listed mission is shown. A link shows its files, an upload-only token its own uploads."""
    return (viewer.files is None or file.id in viewer.files) and (viewer.reads or file.by == viewer.person_id)


def sees_file(viewer: Viewer, file: File) -> bool:
    """Whether a file is listed."""
    return not file.is_deleted and sees_mission(viewer, file.mission) and is_shown(viewer, file)


def recordings(viewer: Viewer, files: list[File]) -> set[str]:
    """Return the listed recordings of these files: those of which every file is shown."""
    hidden = {file.recording for file in files if not file.is_deleted and not sees_file(viewer, file)}
    return {file.recording for file in files if sees_file(viewer, file)} - hidden


def build(api: Api, seed: int) -> Lab:
    """Create a lab in the database of an API."""
    rng = random.Random(seed)
    owner = str(OWNER_ID)
    staff = [people.person(api) for _ in range(4)]
    projects = [_project(api, rng, number, [owner, *(who.id for who in staff)]) for number in range(5)]
    missions = [mission for project in projects for mission in project.missions]
    viewers = [Viewer("anonymous", None), Viewer("admin", people.person(api, admin=True).token, is_admin=True)]
    for who in staff:
        levels = _grants(api, rng, who, projects, missions)
        viewers.append(Viewer(f"{who.name}, signed in", who.token, levels, who.id))
        reach = {rng.choice(projects).id, rng.choice(missions).id}
        limited = people.token(api, who, [Scope.write], limits=sorted(reach))
        viewers.append(Viewer(f"{who.name}, limited", limited.secret, levels, who.id, reach=reach))
        robot = people.token(api, who, [Scope.upload], limits=sorted(reach))
        viewers.append(Viewer(f"{who.name}'s robot", robot.secret, levels, who.id, reads=False, reach=reach))
    limit = {projects[0].id}
    bounded = people.token(api, people.person(api, admin=True), limits=sorted(limit))
    viewers.append(Viewer("admin, limited", bounded.secret, is_admin=True, reach=limit))
    # A share of a mission in the trash is suspended: it is no valid credential.
    for mission in rng.sample([item for item in missions if not item.is_deleted and not item.project.is_deleted], 3):
        some = {file.id for file in rng.sample(mission.files, 2)}
        for chosen in (None, some):
            made = people.share(api, mission.id, file_ids=None if chosen is None else sorted(chosen))
            viewers.append(Viewer(f"link {len(viewers)}", made.secret, is_link=True, reach={mission.id}, files=chosen))
    return Lab(api, seed, projects, viewers)


def _project(api: Api, rng: random.Random, number: int, uploaders: list[str]) -> Project:
    made = api.project(name=f"lab {number} {uuid.uuid4().hex[:6]}")
    project = Project(made["id"], made["name"], is_public=number == 1)
    for item in range(3):
        mission = api.mission(project.id, name=f"outing {item}")
        project.missions.append(Mission(mission["id"], mission["name"], project))
        _fill(api, rng, project.missions[-1], uploaders)
    api.sql("UPDATE project SET is_public = %s WHERE id = %s", project.is_public, project.id)
    items: list[Project | Mission | File] = [rng.choice(project.missions), rng.choice(project.missions[0].files[:2])]
    items += [project] if number == 2 else []
    for object_ in items:
        trash(api, type(object_).__name__.lower(), object_.id)
        object_.is_deleted = True
    return project


def _fill(api: Api, rng: random.Random, mission: Mission, uploaders: list[str]) -> None:
    """Create three files in a mission: two of one recording, and one of another."""
    sample = Sample(api)
    for name in ("split/0.mcap", "split/1.mcap", "alone.mcap"):
        size_bytes, messages = rng.randrange(1, 10**6), rng.randrange(1, 1000)
        topics = [{"name": f"/{uuid.uuid4().hex}", "message_type": "std_msgs/String", "count": messages}]
        file_id = sample.file(mission.id, name, topics=topics, size_bytes=size_bytes, message_count=messages)
        by = rng.choice(uploaders)
        api.sql("UPDATE file SET uploaded_by_id = %s WHERE id = %s", by, file_id)
        mission.files.append(File(file_id, name, mission, size_bytes, messages, "", by))
    *split, alone = mission.files
    for name, members in (("split", split), ("alone", [alone])):
        span = {"start_ns": 0, "end_ns": rng.randrange(1, 10**12)}
        recording = sample.recording(mission.id, name, [item.id for item in members], **span)
        for item in members:
            item.recording = recording


def _grants(
    api: Api, rng: random.Random, who: Person, projects: list[Project], missions: list[Mission]
) -> dict[str, int]:
    """Create grants of a person, directly and by groups, some expired; return the effective levels."""
    levels: dict[str, int] = {}
    for _ in range(6):
        places: list[Project | Mission] = [*projects, *missions]
        place = rng.choice(places)
        right, is_over = rng.choice(list(Right)), rng.random() < 0.3
        expires_s = -1 if is_over else rng.choice([None, 3600])
        is_by_membership = rng.random() < 0.5
        group = people.group(api, members=[who], expires_s=expires_s if is_by_membership else None)
        of = {"project_id": place.id} if isinstance(place, Project) else {"mission_id": place.id}
        people.grant(api, group, right, **of, expires_s=None if is_by_membership else expires_s)
        if not is_over:
            levels[place.id] = max(levels.get(place.id, 0), right.level)
    return levels
