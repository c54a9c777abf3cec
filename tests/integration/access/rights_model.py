"""A model of effective rights in plain Python: no query, no clock."""

from collections.abc import Iterator
from dataclasses import dataclass, field

# The expiry of a grant or membership: none, a time in the future, or a time in the past.
NEVER, LATER, OVER = "never", "later", "over"
READ, CREATE, WRITE, DELETE = 1, 2, 3, 4
ADMINS = "admins"


@dataclass
class Membership:
    """The membership of a person in a group."""

    ends: str = NEVER
    is_editor: bool = False


@dataclass
class Grant:
    """The right of a group on a project or mission."""

    level: int
    ends: str = NEVER


@dataclass
class Rights:
    """All rights, by names instead of ids. The group of an email address begins with `@`, that of a person with `~`."""

    active: dict[str, bool] = field(default_factory=dict)
    members: dict[str, dict[str, Membership]] = field(default_factory=dict)
    # (place, group) -> grant; a place is a project or a mission.
    grants: dict[tuple[str, str], Grant] = field(default_factory=dict)
    project_of: dict[str, str] = field(default_factory=dict)  # of each mission
    deleted: set[str] = field(default_factory=set)
    projects: list[str] = field(default_factory=list)

    def is_admin(self, person: str) -> bool:
        """Whether a person has admin rights."""
        return person in self.members[ADMINS]

    def is_deleted(self, place: str) -> bool:
        """Whether a place is in the trash, itself or with its project."""
        return place in self.deleted or self.project_of.get(place) in self.deleted

    def granted(self, person: str, place: str, *, last: tuple[str, ...] = (NEVER, LATER)) -> int:
        """The highest level of a person on a place by grants and memberships with one of these expiries."""
        return max(
            (grant.level for group, grant in self._on(place) if self._counts(person, group, grant, last)), default=0
        )

    def level(self, person: str, place: str, *, last: tuple[str, ...] = (NEVER, LATER)) -> int:
        """The level of a person on a place, 0 if it is in the trash."""
        if self.is_deleted(place) or not self.active[person]:
            return 0
        return DELETE if self.is_admin(person) else self.granted(person, place, last=last)

    def is_live_member(self, person: str, group: str) -> bool:
        """Whether a person is a member of a group, and the membership has not expired."""
        return person in self.members[group] and self.members[group][person].ends != OVER

    def unowned(self) -> list[str]:
        """The projects, even deleted ones, without an active, permanent owner. Groups of addresses do not count."""
        return [project for project in self.projects if not any(self._owns(person, project) for person in self.active)]

    def _owns(self, person: str, project: str) -> bool:
        owning = (group for group, grant in self._on(project) if (grant.level, grant.ends) == (DELETE, NEVER))
        return self.active[person] and any(
            not group.startswith("@") and person in self.members[group] and self.members[group][person].ends == NEVER
            for group in owning
        )

    def _on(self, place: str) -> Iterator[tuple[str, Grant]]:
        for (where, group), grant in self.grants.items():
            if where in (place, self.project_of.get(place)):
                yield group, grant

    def _counts(self, person: str, group: str, grant: Grant, last: tuple[str, ...]) -> bool:
        membership = self.members[group].get(person)
        return membership is not None and membership.ends in last and grant.ends in last
