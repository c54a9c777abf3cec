"""Words of access: what a right lets one do, what a token may be used for, what kinds of groups there are."""

import enum


class Right(str, enum.Enum):
    """What somebody may do with a project or a mission. Each contains those before it; compare by `level`."""

    read = "READ"
    create = "CREATE"
    write = "WRITE"
    delete = "DELETE"

    @property
    def level(self) -> int:
        """Its place, from 1 (READ) to 4 (DELETE)."""
        return _RIGHTS.index(self) + 1

    @classmethod
    def of_level(cls, level: int) -> "Right":
        """Return the right at a place from 1 to 4."""
        return _RIGHTS[level - 1]


_RIGHTS = tuple(Right)


class Scope(str, enum.Enum):
    """What a token may be used for, within what its person may do.

    `read`: see and download. `upload`: make missions and send files, seeing no more than names. `write`: change and
    delete, with `read` and `upload`. `run`: start and cancel runs. `admin`: all of these, grant rights, and use the
    power of an admin.
    """

    read = "read"
    upload = "upload"
    write = "write"
    run = "run"
    admin = "admin"


class TokenKind(str, enum.Enum):
    """Who carries a token: a person's script, a robot, a runner of actions, or one run while it lasts."""

    personal = "personal"
    robot = "robot"
    runner = "runner"
    run = "run"


class GroupKind(str, enum.Enum):
    """How a group gets its members.

    `person`: one person's own, always just that person. `email`: whoever proves that address. `custom`: by its editors.
    `affiliation`: by the domain of a verified address. `admins`: by admins.
    """

    person = "person"
    email = "email"
    custom = "custom"
    affiliation = "affiliation"
    admins = "admins"
