"""Failures of backups. Each message is a sentence or two: what, where, what to do; each has the CLI's exit code."""


class BackupError(Exception):
    """It could not be done."""

    exit_code = 1


class NothingThere(BackupError):
    """No such backup."""

    exit_code = 3


class CannotBeMeant(BackupError):
    """What was asked for contradicts itself, or lacks something."""

    exit_code = 2


class NotOpened(BackupError):
    """The backups are sealed, and the passphrase is missing or another's."""

    exit_code = 4


class InTheWay(BackupError):
    """Somebody else is at work there, or something is there already."""

    exit_code = 5


class Unreachable(BackupError):
    """Database or store do not answer."""

    exit_code = 7


class Damaged(BackupError):
    """What a backup holds is not what was put into it."""

    exit_code = 9


class CannotWrite(BackupError):
    """The place for backups takes nothing more."""

    exit_code = 11
