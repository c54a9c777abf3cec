"""Failures of backups. Each message says what happened, where, and what to do; each class has the CLI's exit code."""


class BackupError(Exception):
    """A command on backups failed."""

    exit_code = 1


class BackupRequestInvalid(BackupError):
    """The options contradict each other, or something required is missing."""

    exit_code = 2


class BackupNotFound(BackupError):
    """There is no such backup."""

    exit_code = 3


class PassphraseWrong(BackupError):
    """The backups are encrypted, and the passphrase is missing or wrong."""

    exit_code = 4


class BackupConflict(BackupError):
    """Another process uses the location, or it contains something else."""

    exit_code = 5


class BackupUnreachable(BackupError):
    """The database, the store or the location does not answer."""

    exit_code = 7


class BackupDamaged(BackupError):
    """A backup does not contain what was written to it."""

    exit_code = 9


class BackupLocationFull(BackupError):
    """The location accepts no more data."""

    exit_code = 11
