"""The exit codes of failures, and how failures are printed. Scripts rely on the codes: never change one."""

import enum
from collections.abc import Iterable, Mapping
from typing import Any

import typer
from pydantic import ValidationError

from kleinkram.cli.commands import ClickException, is_json_requested
from kleinkram.cli.render import escape, note, plain
from kleinkram.client import errors as local
from kleinkram.client.errors import request_id_of
from kleinkram.contract import errors as remote
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.problems import first_message
from kleinkram.failures import code_of, failure_line
from kleinkram.recordings.errors import (
    CannotWrite,
    NoSuchTopic,
    NotConvertible,
    OutsideRecording,
    RecordingError,
)


class ExitCode(enum.IntEnum):
    """The kind of a failure, for scripts."""

    server_failed = 1
    usage = 2
    not_found = 3
    not_allowed = 4
    conflict = 5
    metadata = 6
    unreachable = 7
    local_file = 8
    bytes_differ = 9
    several = 10
    destination = 11
    timed_out = 12
    no_room = 13
    run_failed = 14
    verdict_bad = 15
    not_good = 16
    interrupted = 130


class Interrupted(local.ClientError):
    """Stopped. {remedy}"""

    remedy: str = "Run the same command again to continue."


class NotConfirmed(local.ClientError):
    """Not done, because it was not confirmed. Use --yes to skip the confirmation."""


_CLASSES: dict[ExitCode, tuple[type[KleinkramError], ...]] = {
    ExitCode.server_failed: (remote.MethodNotAllowed, remote.InternalError, local.AnswerNotUnderstood),
    ExitCode.usage: (
        remote.WrongClient,
        remote.InvalidRequest,
        remote.InvalidQuery,
        remote.InvalidCursor,
        remote.BodyTooLarge,
        local.NotConfigured,
        local.ConfigurationBroken,
        local.NoBrowser,
        local.InvalidInput,
        local.ReadingMissing,
        NotConfirmed,
    ),
    ExitCode.not_found: (
        remote.NotFound,
        remote.UploadGone,
        remote.NoInputs,
        local.NoSuchEndpoint,
        local.NothingToDo,
        local.NoChecks,
        local.PreviewMissing,
    ),
    ExitCode.not_allowed: (
        remote.NotAuthenticated,
        remote.SignInPending,
        remote.SlowDown,
        remote.SignInDenied,
        remote.SignInFailed,
        remote.SignInRefused,
        remote.SignInTooOld,
        remote.SecondFactorNeeded,
        remote.SecondFactorWrong,
        remote.Forbidden,
        remote.ScopeMissing,
        remote.TokenTooWide,
        remote.RightExceeded,
        local.CredentialsExposed,
    ),
    ExitCode.conflict: (
        remote.LastOwner,
        remote.LastAdmin,
        remote.LastSignInMethod,
        remote.GroupFixed,
        remote.PersonErased,
        remote.AmbiguousName,
        remote.NameTaken,
        remote.NotFromLibrary,
        remote.EditConflict,
        remote.FileExists,
        remote.PathConflict,
        remote.NameLeased,
        remote.RunGone,
        remote.NoRunner,
        remote.CannotSlice,
        local.EndpointTaken,
        local.PathsCollide,
        local.UploadElsewhere,
    ),
    ExitCode.metadata: (remote.YamlInvalid, remote.FieldsInvalid, remote.MetadataInvalid, local.ChecksInvalid),
    ExitCode.unreachable: (
        remote.ProviderUnavailable,
        remote.RateLimited,
        remote.TooManyStreams,
        remote.TooManySlices,
        remote.StoreUnavailable,
        remote.DatabaseUnavailable,
        local.ServerUnreachable,
        local.StoreUnreachable,
        local.TransferFailed,
        local.StoreRetriesExhausted,
    ),
    ExitCode.local_file: (
        local.FileChanged,
        local.StillRecording,
        local.NotAFile,
        local.FileUnreadable,
        local.NameUnusable,
    ),
    ExitCode.bytes_differ: (
        remote.UploadIncomplete,
        remote.ChecksumMismatch,
        remote.FileUnavailable,
        local.VerifyFailed,
    ),
    ExitCode.destination: (local.DestinationRefused, local.DestinationDiffers, local.DiskFull),
    ExitCode.timed_out: (remote.SignInExpired, remote.CodeGone, local.TimedOut),
    ExitCode.no_room: (remote.QuotaExceeded,),
    ExitCode.not_good: (local.MissionNotGood,),
    ExitCode.interrupted: (Interrupted,),
}
EXIT_CODES = {error: code for code, errors in _CLASSES.items() for error in errors}
RECORDING_CODES: dict[type[RecordingError], ExitCode] = {
    NoSuchTopic: ExitCode.not_found,
    OutsideRecording: ExitCode.not_found,
    NotConvertible: ExitCode.local_file,
    CannotWrite: ExitCode.destination,
    RecordingError: ExitCode.local_file,
}
"""The first class that an error has decides."""


def explain(error: Exception) -> int | None:
    """Print a failure on stderr and return its exit code; None for an unexpected error, which is a bug.

    With `--json` on the command line, the failure is one JSON document in one line.
    """
    if isinstance(error, typer.Abort):
        return fail("interrupted", "Aborted.", ExitCode.server_failed)
    if isinstance(error, ClickException):
        usage: Any = error  # the exception of whichever click Typer uses
        if isinstance(error.__cause__, ValidationError):  # newer versions of Typer check values with pydantic
            usage.message = first_message(error.__cause__)
        if is_json_requested():
            return fail("usage", usage.format_message(), usage.exit_code)
        usage.show()
        return int(usage.exit_code)
    if isinstance(error, RecordingError | FileNotFoundError):
        return fail(_code_of(error), str(error), recording_code(error))
    if not isinstance(error, KleinkramError):
        return None
    if is_json_requested():
        fields = {"request_id": request_id_of(error), **error.fields()}
        return fail(_code_of(error), str(error), EXIT_CODES[type(error)], fields)
    problems = getattr(error, "problems", None)
    note(f"Error: {error if problems is None else type(error).__doc__ or ''}")
    for problem in problems or ():
        position = f" (line {problem.line}, column {problem.column})" if problem.line is not None else ""
        note(f"Error:   {problem.field}{position}: {problem.message}")
    if (request_id := request_id_of(error)) is not None and not isinstance(error, remote.InternalError):
        note(f"Request id: {request_id}")
    return EXIT_CODES[type(error)]


def recording_code(error: RecordingError | FileNotFoundError) -> ExitCode:
    """Return the exit code of a failure with a recording on this machine."""
    return next((code for kind, code in RECORDING_CODES.items() if isinstance(error, kind)), ExitCode.local_file)


def fail(code: str, message: str, exit_code: int, fields: Mapping[str, object] | None = None) -> int:
    """Print a failure, with `--json` as JSON, and return the exit code."""
    known = {name: plain(value) for name, value in (fields or {}).items() if value is not None}
    as_json = is_json_requested()
    text = failure_line(message, code=code, exit_code=int(exit_code), as_json=as_json, fields=known)
    typer.echo(text if as_json else escape(text), err=True)  # JSON has escapes of its own
    return exit_code


def _code_of(error: Exception) -> str:
    """Return the code of the contract; for failures of this machine, the class name in snake case."""
    code = getattr(type(error), "code", None)
    return str(code.value) if code else code_of(error)


def exit_code_of(failures: Iterable[KleinkramError]) -> int:
    """Return the exit code that all failures have, otherwise `several`; 0 for no failures."""
    codes = {EXIT_CODES[type(error)] for error in failures}
    if not codes:
        return 0
    return codes.pop() if len(codes) == 1 else ExitCode.several
