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
    """No server is known: {reason}. Start one with `klein up`, or sign in to one with `klein login URL`, or name one by KLEINKRAM_URL and KLEINKRAM_TOKEN."""  # noqa: E501  one sentence

    reason: str


class ConfigurationBroken(ClientError):
    """{file} cannot be used: {reason}. Repair or remove it."""

    file: str
    reason: str


class NoSuchEndpoint(ClientError):
    """There is no endpoint {name!r}; known are: {known}. `klein login` makes one."""

    name: str
    known: str


class EndpointTaken(ClientError):
    """The endpoint {name!r} is {url}. Give another --name, or remove it first with `klein logout {name}`."""

    name: str
    url: str


class CredentialsExposed(ClientError):
    """{file} holds tokens, and others on this machine may read or change it (its mode is {mode}). Change it with `chmod 600`; if others may have read it, `klein logout --all` revokes the tokens, and `klein login` signs in again."""  # noqa: E501  one sentence

    file: str
    mode: str


class NoBrowser(ClientError):
    """There is no browser here that could be opened. `klein login {url} --device` shows a code to type on another machine."""  # noqa: E501  one sentence

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
    """The object store at {store} is away or full ({reason}). The server hands out this address; `klein doctor` says whether it can be reached from here."""  # noqa: E501  one sentence

    store: str
    reason: str


class TransferFailed(ClientError):
    """{path!r} could not be transferred: {reason}. Run the same command again; what has arrived stays."""

    path: str
    reason: str


class StoreTroubled(TransferFailed):
    """{path!r} could not be transferred: for minutes, {reason}. Run the same command again when the store is well; what has arrived stays."""  # noqa: E501  one sentence


class FileChanged(ClientError):
    """{path!r} changed while it was read ({reason}), so it was not uploaded. Wait until nothing writes to it, then run the same command again."""  # noqa: E501  one sentence

    path: str
    reason: str


class StillRecording(ClientError):
    """{path!r} was left out: {reason}. When the recording has ended run the same command again, or give --include-active."""  # noqa: E501  one sentence

    path: str
    reason: str


class NotAFile(ClientError):
    """{path!r} was left out: it is {kind}, not a file or folder."""

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
    remedy: str = "give them apart, or rename one"


class NothingToDo(ClientError):
    """{reason}."""

    reason: str


class UploadElsewhere(ClientError):
    """{path!r} is being uploaded by another klein process on this machine. Wait for it to end."""

    path: str


class DestinationRefused(ClientError):
    """{path!r} was not written: {reason}."""

    path: str
    reason: str


class DestinationDiffers(ClientError):
    """{path!r} is here already with other content, and was left as it is. Give --overwrite to replace it, or another --dest."""  # noqa: E501  one sentence

    path: str


class DiskFull(ClientError):
    """There is no room for {path!r}: {reason}. What has arrived was kept; make room and run the same command again."""

    path: str
    reason: str


class VerifyFailed(ClientError):
    """The bytes of {path!r} are not what the server promised: {reason}. Nothing was kept; run the command again."""

    path: str
    reason: str


class InvalidInput(ClientError):
    """{what} is not usable: {reason}."""

    what: str
    reason: str


class ReadingMissing(ClientError):
    """{what} is not installed, and this needs it: `pip install 'open-kleinkram[reading]'`."""

    what: str


class TimedOut(ClientError):
    """{what} was not finished after {seconds:g} s. It goes on in the server; look again later."""

    what: str
    seconds: float
