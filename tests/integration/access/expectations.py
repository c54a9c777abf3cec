"""The expected answer of each call, computed from the table of operations and the facts about the caller.

Nothing here asks the code under test what somebody may do; of `operations` it takes only what each operation needs.
"""

import enum
from dataclasses import dataclass

from kleinkram.contract.access import Scope
from kleinkram.server.access.operations import Permission, ResourceKind
from tests.integration.access.credentials import Carrier, Kind, Reach

_READ = 1
_WRITE = 3
_OWNER = 4


class About(enum.Enum):
    """What a request is about."""

    server = enum.auto()
    project = enum.auto()
    mission = enum.auto()
    file = enum.auto()
    # What is about people.
    link = enum.auto()
    edited_group = enum.auto()
    joined_group = enum.auto()
    other_group = enum.auto()
    hermit = enum.auto()
    owner = enum.auto()


@dataclass(frozen=True)
class Place:
    """What is granted: the level on the project and on the mission, 0 for none; and whether anybody may read it."""

    project: int = 0
    mission: int = 0
    is_public: bool = False


_REACHING_A_PROJECT = {Reach.everything, Reach.project}
_REACHING_A_MISSION = {Reach.everything, Reach.project, Reach.mission}
# What a link shows, by what it is a link to.
_SHOWN = {
    About.mission: {Reach.mission, Reach.file, Reach.other_file},
    About.file: {Reach.mission, Reach.file},
}

# Somebody whom nobody knows, the owner of the server, and groups of which everybody edits one and is in another.
_AMONG_PEOPLE = {About.link, About.edited_group, About.joined_group, About.other_group, About.hermit, About.owner}
_OF_MEMBERS = {About.edited_group: _WRITE, About.joined_group: _READ}


class Verdict(enum.Enum):
    """How a request must end, by its status."""

    done = "2xx"
    unknown = "401"
    refused = "403"
    unseen = "404"

    @classmethod
    def of_status(cls, status: int) -> "Verdict | int":
        """Return what a status stands for, or the status itself where it stands for none of these."""
        named = {401: cls.unknown, 403: cls.refused, 404: cls.unseen}
        return cls.done if 200 <= status < 300 else named.get(status, status)


def admitted(need: Permission, carrier: Carrier, *, is_change: bool) -> Verdict:
    """Return how a request ends before anybody looks at what it is about; `done` where it goes on."""
    if carrier.kind is Kind.nobody or (carrier.kind is Kind.lured and is_change):
        return Verdict.unknown
    if carrier.kind is Kind.stranger and not need.guests:
        return Verdict.unknown
    if carrier.kind is Kind.link and not need.guests:
        return Verdict.refused
    if carrier.kind is Kind.runner and not need.runners:
        return Verdict.refused
    if need.only_runners and carrier.kind is not Kind.runner:
        return Verdict.refused
    if not need.scopes & carrier.scopes and carrier.kind is not Kind.runner:
        return Verdict.refused
    if need.reads and Scope.read not in carrier.scopes:
        return Verdict.refused
    if need.browsers and not carrier.is_browser:
        return Verdict.refused
    if need.unrestricted and carrier.is_limited:
        return Verdict.refused
    if need.on is ResourceKind.server and (not carrier.is_admin or carrier.is_limited):
        return Verdict.refused
    return Verdict.done


def level(carrier: Carrier, place: Place, about: About) -> int:
    """Return the level that somebody has on the place's project, its mission, or the file in that."""
    if about in _AMONG_PEOPLE:
        return _among_people(carrier, about)
    if carrier.kind is Kind.link:
        return _READ if carrier.reach in _SHOWN.get(about, ()) else 0
    if carrier.reach not in (_REACHING_A_PROJECT if about is About.project else _REACHING_A_MISSION):
        return 0
    if carrier.is_admin:
        return _OWNER
    granted = place.project if about is About.project else max(place.project, place.mission)
    is_theirs = carrier.kind in {Kind.person, Kind.lured} and carrier.holds
    return max(granted if is_theirs else 0, _READ if place.is_public else 0)


def _among_people(carrier: Carrier, about: About) -> int:
    if about is About.link:
        return _READ if carrier.kind is Kind.link else 0
    if about is About.owner or carrier.is_limited:
        return 0
    return _OWNER if carrier.is_admin else _OF_MEMBERS.get(about, 0)


def needed(need: Permission) -> int:
    """Return the level that an operation takes."""
    return need.right.level if need.right else _READ
