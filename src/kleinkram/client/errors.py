"""Failures of the client: no server, no configuration, local files. Those of the server are in `contract.errors`.

The docstring of a class is its sentence; its fields fill the braces.
"""

from dataclasses import dataclass

from typing_extensions import dataclass_transform

from kleinkram.contract.errors import KleinkramError


def request_id_of(error: BaseException) -> str | None:
    """Return the id of the request that failed, or None for a failure without a request."""
    request_id = error.__dict__.get("request_id")
    return request_id if isinstance(request_id, str) else None


def remember_request(error: KleinkramError, request_id: str | None) -> KleinkramError:
    """Keep the request's id on the error, for `request_id_of`, and return the error."""
    if request_id is not None and request_id_of(error) in {None, "unknown"}:
        error.__dict__["request_id"] = request_id
    return error


@dataclass_transform(eq_default=False)
class ClientError(KleinkramError):
    """Something went wrong on this machine."""

    def __init_subclass__(cls) -> None:
        """Make each failure a dataclass."""
        dataclass(eq=False)(cls)


class NotConfigured(ClientError):
    """No server is configured: {reason}. Start one with `klein up`, sign in to one with `klein login URL`, or set KLEINKRAM_URL and KLEINKRAM_TOKEN."""  # noqa: E501  one sentence

    reason: str


class ConfigurationBroken(ClientError):
    """{file} cannot be used: {reason}. Repair or remove it."""

    file: str
    reason: str


class NoSuchEndpoint(ClientError):
    """There is no endpoint {name!r}; the saved ones are: {known}. `klein login` adds one."""

    name: str
    known: str


class EndpointTaken(ClientError):
    """The endpoint {name!r} is {url}. Choose another --name, or remove it first with `klein logout {name}`."""

    name: str
    url: str


class CredentialsExposed(ClientError):
    """{file} contains tokens, and other users of this machine can read or change it (its mode is {mode}). Restrict it with `chmod 600`; if others may have read it, `klein logout --all` revokes the tokens, and `klein login` signs in again."""  # noqa: E501  one sentence

    file: str
    mode: str


class NoBrowser(ClientError):
    """No browser can be opened on this machine. `klein login {url} --device` shows a code to type on another machine."""  # noqa: E501  one sentence

    url: str


class ServerUnreachable(ClientError):
    """The server at {url} does not answer ({reason}). Is it running (`klein doctor`), and is this the right one (`klein endpoint`)?"""  # noqa: E501  one sentence

    url: str
    reason: str


class AnswerNotUnderstood(ClientError):
    """{url} answered {what} in a way that this client ({client_version}) does not understand: {reason}. Is it a Kleinkram server, and of the same version?"""  # noqa: E501  one sentence

    url: str
    what: str
    client_version: str
    reason: str


class StoreUnreachable(ClientError):
    """The object store at {store} is unreachable or full ({reason}). The server provides this address; `klein doctor` checks whether this machine can reach it."""  # noqa: E501  one sentence

    store: str
    reason: str


class TransferFailed(ClientError):
    """{path!r} could not be transferred: {reason}. Run the same command again; it continues where this one stopped."""

    path: str
    reason: str


class StoreRetriesExhausted(TransferFailed):
    """{path!r} could not be transferred: for several minutes, {reason}. When the store works again, run the same command again; it continues where this one stopped."""  # noqa: E501  one sentence


class FileChanged(ClientError):
    """{path!r} changed while it was being read ({reason}), so it was not uploaded. Wait until no program writes to it, then run the same command again."""  # noqa: E501  one sentence

    path: str
    reason: str


class StillRecording(ClientError):
    """{path!r} was skipped: {reason}. When the recording has ended, run the same command again, or use --include-active."""  # noqa: E501  one sentence

    path: str
    reason: str


class NotAFile(ClientError):
    """{path!r} was skipped: it is {kind}. Only files and folders are uploaded."""

    path: str
    kind: str


class FileUnreadable(ClientError):
    """{path!r} cannot be read: {reason}."""

    path: str
    reason: str


class NameUnusable(ClientError):
    """{path!r} cannot be the name of a file in a mission: it {reason}. Rename it, then run the same command again."""

    path: str
    reason: str


class PathsCollide(ClientError):
    """{first} and {second} would both become {path}: {remedy}."""

    path: str
    first: str
    second: str
    remedy: str = "upload them separately, or rename one"


class NothingToDo(ClientError):
    """{reason}."""

    reason: str


class UploadElsewhere(ClientError):
    """{path!r} is being uploaded by another klein process on this machine. Wait for it to end."""

    path: str


class NoChecks(ClientError):
    """There is no checks.yaml beside {path!r}. `klein checks init GOOD_MISSION -o checks.yaml` makes one from a mission that is known to be good; --checks names a file, and -p a project that has one."""  # noqa: E501  one sentence

    path: str


class ChecksInvalid(ClientError):
    """{source}, line {line}, column {column}: {reason}"""

    source: str
    line: int
    column: int
    reason: str


class MissionNotGood(ClientError):
    """Nothing was uploaded, because the verdict of the checks is {verdict} and --require-good was given."""

    verdict: str


class DestinationRefused(ClientError):
    """{path!r} was not written: {reason}."""

    path: str
    reason: str


class DestinationDiffers(ClientError):
    """{path!r} already exists with other content, and was not changed. Use --overwrite to replace it, or another --dest."""  # noqa: E501  one sentence

    path: str


class DiskFull(ClientError):
    """There is not enough disk space for {path!r}: {reason}. Free some space and run the same command again; it continues where this one stopped."""  # noqa: E501  one sentence

    path: str
    reason: str


class VerifyFailed(ClientError):
    """The downloaded bytes of {path!r} do not match the server's checksum: {reason}. Nothing was saved; run the command again."""  # noqa: E501  one sentence

    path: str
    reason: str


class InvalidInput(ClientError):
    """{what} is invalid: {reason}."""

    what: str
    reason: str


class ReadingMissing(ClientError):
    """{what} is not installed, but is required here: `pip install 'open-kleinkram[reading]'`."""

    what: str


class PreviewMissing(ClientError):
    """There is no preview of {path}: {reason}."""

    path: str
    reason: str


class TimedOut(ClientError):
    """{what} was not finished after {seconds:g} s. The server continues; check again later."""

    what: str
    seconds: float
