"""The expected response of each call, computed from the table of operations and the facts about the credential.

This module does not use the code under test to decide what is permitted; from `operations` it takes only the permission
that each operation requires.
"""

import enum
from dataclasses import dataclass

from kleinkram.server.access.operations import Permission, ResourceKind
from tests.integration.access.credentials import Credential, Kind, Reach

_READ = 1
_WRITE = 3
_OWNER = 4


class Target(enum.Enum):
    """The object of a request."""

    server = enum.auto()
    project = enum.auto()
    mission = enum.auto()
    # An event of the mission, which links to some files do not show.
    event = enum.auto()
    file = enum.auto()
    # Shares, groups and people.
    link = enum.auto()
    edited_group = enum.auto()
    joined_group = enum.auto()
    other_group = enum.auto()
    unrelated_person = enum.auto()
    owner = enum.auto()


@dataclass(frozen=True)
class AccessLevels:
    """The granted levels on the project and on the mission, 0 for none, and whether the project is public."""

    project: int = 0
    mission: int = 0
    is_public: bool = False


_PROJECT_REACHES = {Reach.everything, Reach.project}
_MISSION_REACHES = {Reach.everything, Reach.project, Reach.mission}
# The links that show a target.
_LINK_REACHES = {
    Target.mission: {Reach.mission, Reach.file, Reach.other_file},
    Target.event: {Reach.mission},
    Target.file: {Reach.mission, Reach.file},
}

# Targets that are independent of projects: a person without any relation to the principal, the owner of the server, and
# groups, of which each principal edits one and is a member of another.
_PEOPLE_TARGETS = {
    Target.link,
    Target.edited_group,
    Target.joined_group,
    Target.other_group,
    Target.unrelated_person,
    Target.owner,
}
_MEMBER_LEVELS = {Target.edited_group: _WRITE, Target.joined_group: _READ}


class Verdict(enum.Enum):
    """The result of a request, by its status."""

    ok = "2xx"
    unauthenticated = "401"
    forbidden = "403"
    not_found = "404"

    @classmethod
    def of_status(cls, status: int) -> "Verdict | int":
        """Return the verdict of a status, or the status itself if it has none."""
        named = {401: cls.unauthenticated, 403: cls.forbidden, 404: cls.not_found}
        return cls.ok if 200 <= status < 300 else named.get(status, status)


def credential_verdict(need: Permission, credential: Credential, *, is_change: bool) -> Verdict:
    """Return the verdict that depends on the credential only; `ok` if the rights on the target decide."""
    if credential.kind is Kind.invalid or (credential.kind is Kind.cross_site and is_change):
        return Verdict.unauthenticated
    if credential.kind is Kind.anonymous and not need.guests:
        return Verdict.unauthenticated
    if credential.kind is Kind.link and not need.guests:
        return Verdict.forbidden
    if credential.kind is Kind.runner and not need.runners:
        return Verdict.forbidden
    if need.only_runners and credential.kind is not Kind.runner:
        return Verdict.forbidden
    if not need.scopes & credential.scopes and credential.kind is not Kind.runner:
        return Verdict.forbidden
    if need.also is not None and need.also not in credential.scopes:
        return Verdict.forbidden
    if need.browsers and not credential.is_browser:
        return Verdict.forbidden
    if need.unrestricted and credential.is_limited:
        return Verdict.forbidden
    if need.on is ResourceKind.server and (not credential.is_admin or credential.is_limited):
        return Verdict.forbidden
    return Verdict.ok


def level(credential: Credential, levels: AccessLevels, target: Target) -> int:
    """Return the level that a credential has on a target, if its person was granted these levels."""
    if target in _PEOPLE_TARGETS:
        return _people_level(credential, target)
    if credential.kind is Kind.link:
        return _READ if credential.reach in _LINK_REACHES.get(target, ()) else 0
    if credential.reach not in (_PROJECT_REACHES if target is Target.project else _MISSION_REACHES):
        return 0
    if credential.is_admin:
        return _OWNER
    granted = levels.project if target is Target.project else max(levels.project, levels.mission)
    has_grants = credential.kind in {Kind.person, Kind.cross_site} and credential.has_grants
    return max(granted if has_grants else 0, _READ if levels.is_public else 0)


def _people_level(credential: Credential, target: Target) -> int:
    if target is Target.link:
        return _READ if credential.kind is Kind.link else 0
    if target is Target.owner or credential.is_limited:
        return 0
    return _OWNER if credential.is_admin else _MEMBER_LEVELS.get(target, 0)


def required_level(need: Permission) -> int:
    """Return the level that an operation requires."""
    return need.right.level if need.right else _READ
