"""The credentials of the matrix, one of each kind, with the facts that decide what it permits."""

import enum
from dataclasses import dataclass

from kleinkram.contract.access import Scope

READ, UPLOAD, WRITE, RUN, ADMIN = Scope.read, Scope.upload, Scope.write, Scope.run, Scope.admin
EVERY = frozenset({READ, UPLOAD, WRITE, RUN, ADMIN})


class Kind(enum.Enum):
    """The kind of a credential."""

    person = enum.auto()
    runner = enum.auto()
    link = enum.auto()
    # No credential.
    anonymous = enum.auto()
    # A credential that is malformed, expired or revoked.
    invalid = enum.auto()
    # The cookie of a browser, in a request from a page of another site.
    cross_site = enum.auto()


class Reach(enum.Enum):
    """The objects that a credential is limited to, independent of the rights of its person."""

    everything = enum.auto()
    project = enum.auto()
    mission = enum.auto()
    other_project = enum.auto()
    file = enum.auto()
    other_file = enum.auto()


@dataclass(frozen=True)
class Credential:
    """A credential. `has_grants`: its person has the grants of the access levels; `is_admin`: they are an admin."""

    name: str
    kind: Kind = Kind.person
    scopes: frozenset[Scope] = EVERY
    reach: Reach = Reach.everything
    has_grants: bool = True
    is_admin: bool = False
    is_robot: bool = False
    is_browser: bool = False

    @property
    def is_limited(self) -> bool:
        """Whether it is limited to some projects or missions."""
        return self.reach is not Reach.everything


# These credentials are tested with all access levels on the project and on the mission.
MEMBER = Credential("member of a group")
WITH_GRANTS = (
    MEMBER,
    Credential("person with grants of their own"),
    Credential("expired member", has_grants=False),
    Credential("person whose grants expired", has_grants=False),
    Credential("browser's session", is_browser=True),
    Credential("browser's session, cross-site request", Kind.cross_site, is_browser=True),
    Credential("expired session", Kind.invalid),
    Credential("token to read", scopes=frozenset({READ})),
    Credential("token to upload", scopes=frozenset({UPLOAD})),
    Credential("token to write", scopes=frozenset({READ, UPLOAD, WRITE})),
    Credential("token to run", scopes=frozenset({RUN})),
    Credential("token to read and run", scopes=frozenset({READ, RUN})),
    Credential("robot of the project", scopes=frozenset({UPLOAD}), reach=Reach.project, is_robot=True),
    Credential("robot of the mission", scopes=frozenset({UPLOAD}), reach=Reach.mission, is_robot=True),
    Credential(
        "robot of another project", scopes=frozenset({READ, UPLOAD, WRITE}), reach=Reach.other_project, is_robot=True
    ),
    Credential("token limited to the mission", scopes=frozenset({READ, UPLOAD, WRITE}), reach=Reach.mission),
    Credential("runner", Kind.runner, frozenset({RUN})),
    Credential("revoked token", Kind.invalid),
    Credential("expired token", Kind.invalid),
    Credential("deactivated person", Kind.invalid),
    Credential("admin", is_admin=True),
    Credential("admin whose membership of the admins expired"),
    Credential("admin's token without the scope admin", scopes=frozenset({READ, UPLOAD, WRITE, RUN})),
    Credential("admin's token limited to the project", reach=Reach.project, is_admin=True),
    Credential("admin's token limited to another project", reach=Reach.other_project, is_admin=True),
)
# These credentials never have grants: each is tested once with a private and once with a public project.
WITHOUT_GRANTS = (
    Credential("anonymous visitor", Kind.anonymous, frozenset({READ})),
    Credential("malformed token", Kind.invalid),
    Credential("link", Kind.link, frozenset({READ}), Reach.mission),
    Credential("ended link", Kind.invalid),
    Credential("revoked link", Kind.invalid),
    Credential("link to the file", Kind.link, frozenset({READ}), Reach.file),
    Credential("link to another file", Kind.link, frozenset({READ}), Reach.other_file),
)
