"""A model of what each person may see, in sets in memory, to compare with lists and numbers of the API.

A small lab by chance, from a seed: projects, missions, files and recordings, some public, some in the trash; people
with grants to themselves and to groups, some expired; and credentials of every reach.
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
    """A file with a topic of its own name, in a recording of its own or in the one of its mission's shared folder."""

    id: str
    path: str
    mission: "Mission"
    size_bytes: int
    messages: int
    recording: str
    by: str
    is_gone: bool = False


@dataclass
class Mission:
    """A mission."""

    id: str
    name: str
    project: "Project"
    files: list[File] = field(default_factory=list)
    is_gone: bool = False


@dataclass
class Project:
    """A project."""

    id: str
    name: str
    is_public: bool
    missions: list[Mission] = field(default_factory=list)
    is_gone: bool = False


@dataclass
class Eye:
    """A credential: its `levels` by id of project or mission, and the ids in its `reach`; None for all."""

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
    """The API, what it holds, and who looks."""

    api: Api
    seed: int
    projects: list[Project]
    eyes: list[Eye]

    @property
    def missions(self) -> list[Mission]:
        """All missions."""
        return [mission for project in self.projects for mission in project.missions]

    @property
    def files(self) -> list[File]:
        """All files."""
        return [file for mission in self.missions for file in mission.files]


def level(eye: Eye, place: Project | Mission) -> int:
    """Return the level that somebody has on a project or a mission, whether or not it is in the trash."""
    project = place if isinstance(place, Project) else place.project
    if eye.reach is not None and not eye.reach & {place.id, project.id}:
        return 0
    if eye.is_link:
        return 0 if place is project else _READ
    public = _READ if project.is_public else 0
    return _OWNER if eye.is_admin else max(public, *(eye.levels.get(item.id, 0) for item in (place, project)))


def sees_project(eye: Eye, project: Project) -> bool:
    """Say whether a project is listed."""
    return not project.is_gone and level(eye, project) >= _READ


def sees_mission(eye: Eye, mission: Mission) -> bool:
    """Say whether a mission is listed."""
    return not mission.is_gone and not mission.project.is_gone and level(eye, mission) >= _READ


def is_shown(eye: Eye, file: File) -> bool:
    """Say whether a file of a mission that is listed is shown: not by a link to others, nor to who may only upload."""
    return (eye.files is None or file.id in eye.files) and (eye.reads or file.by == eye.person_id)


def sees_file(eye: Eye, file: File) -> bool:
    """Say whether a file is listed."""
    return not file.is_gone and sees_mission(eye, file.mission) and is_shown(eye, file)


def recordings(eye: Eye, files: list[File]) -> set[str]:
    """Return the recordings of a lab's files that are listed: those of which every file is shown."""
    hidden = {file.recording for file in files if not file.is_gone and not sees_file(eye, file)}
    return {file.recording for file in files if sees_file(eye, file)} - hidden


def build(api: Api, seed: int) -> Lab:
    """Put a lab into an API's database."""
    rng = random.Random(seed)
    owner = str(OWNER_ID)
    staff = [people.person(api) for _ in range(4)]
    projects = [_project(api, rng, number, [owner, *(who.id for who in staff)]) for number in range(5)]
    missions = [mission for project in projects for mission in project.missions]
    eyes = [Eye("stranger", None), Eye("admin", people.person(api, admin=True).token, is_admin=True)]
    for who in staff:
        levels = _grants(api, rng, who, projects, missions)
        eyes.append(Eye(f"{who.name}, signed in", who.token, levels, who.id))
        reach = {rng.choice(projects).id, rng.choice(missions).id}
        limited = people.token(api, who, [Scope.write], limits=sorted(reach))
        eyes.append(Eye(f"{who.name}, limited", limited.secret, levels, who.id, reach=reach))
        robot = people.token(api, who, [Scope.upload], limits=sorted(reach))
        eyes.append(Eye(f"{who.name}'s robot", robot.secret, levels, who.id, reads=False, reach=reach))
    limit = {projects[0].id}
    bounded = people.token(api, people.person(api, admin=True), limits=sorted(limit))
    eyes.append(Eye("admin, limited", bounded.secret, is_admin=True, reach=limit))
    # A share of a mission in the trash is suspended: it is no valid credential.
    for mission in rng.sample([item for item in missions if not item.is_gone and not item.project.is_gone], 3):
        some = {file.id for file in rng.sample(mission.files, 2)}
        for chosen in (None, some):
            made = people.share(api, mission.id, file_ids=None if chosen is None else sorted(chosen))
            eyes.append(Eye(f"link {len(eyes)}", made.secret, is_link=True, reach={mission.id}, files=chosen))
    return Lab(api, seed, projects, eyes)


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
        object_.is_gone = True
    return project


def _fill(api: Api, rng: random.Random, mission: Mission, uploaders: list[str]) -> None:
    """Put three files into a mission: two that make up one recording, and one by itself."""
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
    """Grant somebody this and that, by themselves, by groups, until later and until lately; return what holds."""
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
