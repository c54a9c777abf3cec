"""What the pods of Kleinkram tell the runner: by the termination message of a container, and by its output."""

import base64
import binascii
import hashlib
import zlib
from collections.abc import Iterator

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.contract.reports import MAX_REPORT_BODY_BYTES
from kleinkram.contract.runners import RunFinish
from kleinkram.runner.executors.base import Ending

# Of a termination message, Kubernetes keeps this much.
MAX_MESSAGE_BYTES = 4096
_BEGIN, _END = b"--- results", b"--- end "
# Container runtimes split lines that are longer than 16 KiB.
_LINE_BYTES = 8192
_MAX_MESSAGE_CHARACTERS = 1000


class FetchOutcome(BaseModel):
    """How a fetch went: well, or why the run cannot start. `is_gone`: the run is another runner's by now."""

    model_config = ConfigDict(frozen=True)

    ending: Ending | None = None
    is_gone: bool = False

    def text(self) -> str:
        """Return it as a termination message."""
        if self.ending is None:
            return self.model_dump_json()
        ending = Ending(self.ending.reason, self.ending.message[:_MAX_MESSAGE_CHARACTERS], self.ending.exit_code)
        return self.model_copy(update={"ending": ending}).model_dump_json()

    @classmethod
    def parse(cls, text: str) -> "FetchOutcome | None":
        """Return the outcome of a termination message; None where it is none."""
        try:
            return cls.model_validate_json(text)
        except ValidationError:
            return None


def finish_lines(finish: RunFinish) -> Iterator[bytes]:
    """Yield the lines by which a report is told: it may have many megabytes, and lines have a limit."""
    text = base64.b64encode(zlib.compress(finish.model_dump_json().encode()))
    yield _BEGIN
    for start in range(0, len(text), _LINE_BYTES):
        yield text[start : start + _LINE_BYTES]
    yield _END + hashlib.sha256(text).hexdigest().encode()


def read_finish(output: bytes) -> RunFinish:
    """Return the report in the output of a pod.

    Raises:
        ValueError: there is none, or not all of it.
    """
    lines = output.split(b"\n")
    try:
        begin = lines.index(_BEGIN)
        end = next(number for number in range(begin, len(lines)) if lines[number].startswith(_END))
    except (ValueError, StopIteration):
        raise ValueError("its output has no report") from None
    text = b"".join(lines[begin + 1 : end])
    if lines[end] != _END + hashlib.sha256(text).hexdigest().encode():
        raise ValueError("its output lacks part of the report")
    try:
        data = zlib.decompressobj().decompress(base64.b64decode(text), MAX_REPORT_BODY_BYTES)
    except (binascii.Error, zlib.error) as error:
        raise ValueError(f"its report cannot be read: {error}") from error
    return RunFinish.model_validate_json(data)
