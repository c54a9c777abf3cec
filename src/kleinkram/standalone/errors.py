"""Failures of running Kleinkram on one machine. Each message says what happened, where, and what to do."""


class StandaloneError(Exception):
    """Kleinkram could not be run on this machine."""


class BinaryNotFound(StandaloneError):
    """A program that `klein up` needs is not installed."""


class AlreadyRunning(StandaloneError):
    """Another supervisor runs on this data directory."""


class NotRunning(StandaloneError):
    """No supervisor runs on this data directory."""


class PortTaken(StandaloneError):
    """Another program listens on a requested port."""


class DataDirUnusable(StandaloneError):
    """The data directory cannot be read, written or trusted."""


class VersionMismatch(StandaloneError):
    """The data directory was written by another version of Kleinkram or PostgreSQL."""


class ServiceFailed(StandaloneError):
    """A service could not be started, or did not become ready."""
