"""The callers of the matrix: one per kind of credential, with the facts that decide what each may do."""

import enum
from dataclasses import dataclass

from kleinkram.contract.access import Scope

READ, UPLOAD, WRITE, RUN, ADMIN = Scope.read, Scope.upload, Scope.write, Scope.run, Scope.admin
EVERY = frozenset({READ, UPLOAD, WRITE, RUN, ADMIN})


class Kind(enum.Enum):
    """How somebody comes."""

    person = enum.auto()
    runner = enum.auto()
    link = enum.auto()
    stranger = enum.auto()
    # With something that is no credential, or none any more.
    nobody = enum.auto()
    # With a browser's cookie, from another site's page.
    lured = enum.auto()


class Reach(enum.Enum):
    """What a credential reaches at most, whatever its carrier's rights."""

    everything = enum.auto()
    project = enum.auto()
    mission = enum.auto()
    elsewhere = enum.auto()
    file = enum.auto()
    other_file = enum.auto()


@dataclass(frozen=True)
class Carrier:
    """One kind of credential. `holds`: whether its carrier has the grants; `is_admin`: whether it has admin rights."""

    name: str
    kind: Kind = Kind.person
    scopes: frozenset[Scope] = EVERY
    reach: Reach = Reach.everything
    holds: bool = True
    is_admin: bool = False
    is_robot: bool = False
    is_browser: bool = False

    @property
    def is_limited(self) -> bool:
        """Whether it reaches only some projects or missions."""
        return self.reach is not Reach.everything


# Each comes in every place: with every level on the project and on the mission.
MEMBER = Carrier("member of a group")
PLACED = (
    MEMBER,
    Carrier("person with grants of their own"),
    Carrier("expired member", holds=False),
    Carrier("person whose grants expired", holds=False),
    Carrier("browser's session", is_browser=True),
    Carrier("browser's session, lured by another page", Kind.lured, is_browser=True),
    Carrier("expired session", Kind.nobody),
    Carrier("token to read", scopes=frozenset({READ})),
    Carrier("token to upload", scopes=frozenset({UPLOAD})),
    Carrier("token to write", scopes=frozenset({READ, UPLOAD, WRITE})),
    Carrier("token to run", scopes=frozenset({RUN})),
    Carrier("token to read and run", scopes=frozenset({READ, RUN})),
    Carrier("robot of the project", scopes=frozenset({UPLOAD}), reach=Reach.project, is_robot=True),
    Carrier("robot of the mission", scopes=frozenset({UPLOAD}), reach=Reach.mission, is_robot=True),
    Carrier("robot of another project", scopes=frozenset({READ, UPLOAD, WRITE}), reach=Reach.elsewhere, is_robot=True),
    Carrier("token limited to the mission", scopes=frozenset({READ, UPLOAD, WRITE}), reach=Reach.mission),
    Carrier("runner", Kind.runner, frozenset({RUN})),
    Carrier("revoked token", Kind.nobody),
    Carrier("expired token", Kind.nobody),
    Carrier("deactivated person", Kind.nobody),
    Carrier("admin", is_admin=True),
    Carrier("admin whose membership of the admins expired"),
    Carrier("admin's token without the scope admin", scopes=frozenset({READ, UPLOAD, WRITE, RUN})),
    Carrier("admin's token limited to the project", reach=Reach.project, is_admin=True),
    Carrier("admin's token limited to another project", reach=Reach.elsewhere, is_admin=True),
)
# These hold no grants: they come once for what is private and once for what is public.
UNPLACED = (
    Carrier("stranger", Kind.stranger, frozenset({READ})),
    Carrier("carrier of nonsense", Kind.nobody),
    Carrier("link", Kind.link, frozenset({READ}), Reach.mission),
    Carrier("ended link", Kind.nobody),
    Carrier("revoked link", Kind.nobody),
    Carrier("link to the file", Kind.link, frozenset({READ}), Reach.file),
    Carrier("link to another file", Kind.link, frozenset({READ}), Reach.other_file),
)
