"""Failures of running Kleinkram on one machine. Each message is one sentence or two: what, where, and what to do."""


class StandaloneError(Exception):
    """Kleinkram could not be run on this machine."""


class BinaryNotFound(StandaloneError):
    """A program that `klein up` needs is not installed."""


class AlreadyRunning(StandaloneError):
    """Another supervisor holds this data directory."""


class NotRunning(StandaloneError):
    """No supervisor holds this data directory."""


class PortTaken(StandaloneError):
    """Another program listens on a port that was asked for."""


class DataDirUnusable(StandaloneError):
    """The data directory cannot be read, written or trusted."""


class VersionMismatch(StandaloneError):
    """The data directory was written by another version of Kleinkram or PostgreSQL."""


class PartFailed(StandaloneError):
    """A part could not be started, or did not become ready."""
