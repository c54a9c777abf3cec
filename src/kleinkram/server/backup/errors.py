"""Failures of backups. Each message says what happened, where, and what to do; each class has the CLI's exit code."""

from typing import ClassVar


class BackupError(Exception):
    """A command on backups failed."""

    exit_code: ClassVar[int] = 1

    def __init_subclass__(cls, *, exit_code: int) -> None:
        """Set the exit code of a kind of failure."""
        cls.exit_code = exit_code


class BackupRequestInvalid(BackupError, exit_code=2):
    """The options contradict each other, or something required is missing."""


class BackupNotFound(BackupError, exit_code=3):
    """There is no such backup."""


class PassphraseWrong(BackupError, exit_code=4):
    """The backups are encrypted, and the passphrase is missing or wrong."""


class BackupConflict(BackupError, exit_code=5):
    """Another process uses the location, or it contains something else."""


class BackupUnreachable(BackupError, exit_code=7):
    """The database, the store or the location does not answer."""


class BackupDamaged(BackupError, exit_code=9):
    """A backup does not contain what was written to it."""


class BackupLocationFull(BackupError, exit_code=11):
    """The location accepts no more data."""
