"""From failure to exit code: the one table. Scripts rely on these numbers; add, never change."""

import enum
from collections.abc import Iterable, Mapping
from typing import Any

import typer
from pydantic import ValidationError

from kleinkram.cli.commands import ClickException, wants_json
from kleinkram.cli.render import escape, note, plain
from kleinkram.client import errors as local
from kleinkram.client.errors import request_id_of
from kleinkram.contract import errors as remote
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.problems import in_plain_words
from kleinkram.failures import code_of, failure_line
from kleinkram.recordings.errors import RecordingError


class ExitCode(enum.IntEnum):
    """What went wrong, for scripts."""

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
    interrupted = 130


class Interrupted(local.ClientError):
    """Stopped. Run the same command again to go on from here."""


class Refused(local.ClientError):
    """Not done: it was not confirmed. Give --yes to do it without being asked."""


EXIT_CODES: dict[type[KleinkramError], ExitCode] = {
    remote.NotAuthenticated: ExitCode.not_allowed,
    remote.SignInPending: ExitCode.not_allowed,
    remote.SlowDown: ExitCode.not_allowed,
    remote.SignInDenied: ExitCode.not_allowed,
    remote.SignInExpired: ExitCode.timed_out,
    remote.SignInFailed: ExitCode.not_allowed,
    remote.SignInRefused: ExitCode.not_allowed,
    remote.SignInTooOld: ExitCode.not_allowed,
    remote.SecondFactorNeeded: ExitCode.not_allowed,
    remote.SecondFactorWrong: ExitCode.not_allowed,
    remote.CodeGone: ExitCode.timed_out,
    remote.ProviderUnavailable: ExitCode.unreachable,
    remote.RateLimited: ExitCode.unreachable,
    remote.TooManyStreams: ExitCode.unreachable,
    remote.Forbidden: ExitCode.not_allowed,
    remote.ScopeMissing: ExitCode.not_allowed,
    remote.TokenTooWide: ExitCode.not_allowed,
    remote.RightExceeded: ExitCode.not_allowed,
    remote.LastOwner: ExitCode.conflict,
    remote.LastAdmin: ExitCode.conflict,
    remote.LastSignInMethod: ExitCode.conflict,
    remote.GroupFixed: ExitCode.conflict,
    remote.NotFound: ExitCode.not_found,
    remote.WrongClient: ExitCode.usage,
    remote.AmbiguousName: ExitCode.conflict,
    remote.NameTaken: ExitCode.conflict,
    remote.EditConflict: ExitCode.conflict,
    remote.InvalidRequest: ExitCode.usage,
    remote.InvalidQuery: ExitCode.usage,
    remote.InvalidCursor: ExitCode.usage,
    remote.YamlInvalid: ExitCode.metadata,
    remote.FieldsInvalid: ExitCode.metadata,
    remote.MetadataInvalid: ExitCode.metadata,
    remote.BodyTooLarge: ExitCode.usage,
    remote.FileExists: ExitCode.conflict,
    remote.PathConflict: ExitCode.conflict,
    remote.NameLeased: ExitCode.conflict,
    remote.UploadGone: ExitCode.not_found,
    remote.UploadIncomplete: ExitCode.bytes_differ,
    remote.ChecksumMismatch: ExitCode.bytes_differ,
    remote.FileUnavailable: ExitCode.bytes_differ,
    remote.QuotaExceeded: ExitCode.no_room,
    remote.RunGone: ExitCode.conflict,
    remote.NoInputs: ExitCode.not_found,
    remote.NoRunner: ExitCode.conflict,
    remote.MethodNotAllowed: ExitCode.server_failed,
    remote.StoreUnavailable: ExitCode.unreachable,
    remote.DatabaseUnavailable: ExitCode.unreachable,
    remote.InternalError: ExitCode.server_failed,
    local.NotConfigured: ExitCode.usage,
    local.ConfigurationBroken: ExitCode.usage,
    local.CredentialsExposed: ExitCode.not_allowed,
    local.NoSuchEndpoint: ExitCode.not_found,
    local.EndpointTaken: ExitCode.conflict,
    local.NoBrowser: ExitCode.usage,
    local.ServerUnreachable: ExitCode.unreachable,
    local.StoreUnreachable: ExitCode.unreachable,
    local.AnswerNotUnderstood: ExitCode.server_failed,
    local.TransferFailed: ExitCode.unreachable,
    local.StoreTroubled: ExitCode.unreachable,
    local.FileChanged: ExitCode.local_file,
    local.StillRecording: ExitCode.local_file,
    local.NotAFile: ExitCode.local_file,
    local.FileUnreadable: ExitCode.local_file,
    local.NameUnusable: ExitCode.local_file,
    local.PathsCollide: ExitCode.conflict,
    local.NothingToDo: ExitCode.not_found,
    local.UploadElsewhere: ExitCode.conflict,
    local.DestinationRefused: ExitCode.destination,
    local.DestinationDiffers: ExitCode.destination,
    local.DiskFull: ExitCode.destination,
    local.VerifyFailed: ExitCode.bytes_differ,
    local.InvalidInput: ExitCode.usage,
    local.ReadingMissing: ExitCode.usage,
    local.TimedOut: ExitCode.timed_out,
    Interrupted: ExitCode.interrupted,
    Refused: ExitCode.usage,
}


def explain(error: Exception) -> int | None:
    """Print a failure on stderr and return its exit code; None for one that has no name, which is a bug of ours.

    With `--json` on the command line it is one JSON document in one line.
    """
    if isinstance(error, typer.Abort):
        return fail("interrupted", "Aborted.", ExitCode.server_failed)
    if isinstance(error, ClickException):
        return _explain_usage(error)
    if isinstance(error, RecordingError | FileNotFoundError):
        return fail(_code_of(error), str(error), ExitCode.local_file)
    if not isinstance(error, KleinkramError):
        return None
    if wants_json():
        fields = {"request_id": request_id_of(error), **error.fields()}
        return fail(_code_of(error), str(error), EXIT_CODES[type(error)], fields)
    for line in sentences(error):
        note(f"Error: {line}")
    if (request_id := request_id_of(error)) is not None and not isinstance(error, remote.InternalError):
        note(f"Request id: {escape(request_id)}")
    return EXIT_CODES[type(error)]


def _explain_usage(error: Any) -> int:  # Any: the exception of whichever click Typer uses
    if isinstance(error.__cause__, ValidationError):  # newer versions of Typer check values with pydantic
        error.message = in_plain_words(error.__cause__)
    if wants_json():
        return fail("usage", error.format_message(), error.exit_code)
    error.show()
    return int(error.exit_code)


def fail(code: str, message: str, exit_code: int, fields: Mapping[str, object] | None = None) -> int:
    """Print why a command failed, as JSON where JSON was asked for, and return the exit code."""
    known = {name: plain(value) for name, value in (fields or {}).items() if value is not None}
    as_json = wants_json()
    failure_text = failure_line(message, code=code, exit_code=int(exit_code), as_json=as_json, fields=known)
    typer.echo(failure_text if as_json else escape(failure_text), err=True)  # JSON has escapes of its own
    return exit_code


def _code_of(error: Exception) -> str:
    """Return the code of the contract; for failures of this machine, the name of the class written likewise."""
    code = getattr(type(error), "code", None)
    return str(code.value) if code else code_of(error)


def sentences(error: KleinkramError) -> list[str]:
    """Return an error as lines: one sentence, and one line more for each of several problems."""
    problems = getattr(error, "problems", None)
    if problems is None:
        return [escape(str(error))]
    lines = [escape(type(error).__doc__ or "")]
    for problem in problems:
        place = f" (line {problem.line}, column {problem.column})" if problem.line is not None else ""
        lines.append(f"  {escape(problem.field)}{place}: {escape(problem.message)}")
    return lines


def exit_code_of(failures: Iterable[KleinkramError]) -> int:
    """Return the exit code for several failures: theirs when they are of one kind, else `several`; 0 for none."""
    codes = {EXIT_CODES[type(error)] for error in failures}
    if not codes:
        return 0
    return codes.pop() if len(codes) == 1 else ExitCode.several
