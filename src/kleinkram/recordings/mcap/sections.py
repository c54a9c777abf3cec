"""What an MCAP holds under checksums of its own besides chunks: attachments, the data section, the summary section."""

from __future__ import annotations

import struct

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.losses import Losses
from kleinkram.recordings.mcap import records
from kleinkram.recordings.mcap.records import RECORD_HEAD, McapFacts
from kleinkram.recordings.stream import Lookahead

_U32 = struct.Struct("<I")


class Sections:
    """Passes over what ends a section, and compares its checksum; what is wrong is noted as a loss."""

    def __init__(self, stream: Lookahead, facts: McapFacts, losses: Losses) -> None:
        self._stream = stream
        self._facts = facts
        self._losses = losses
        self._data_end: int | None = None

    def pass_attachment(self, length: int, where: str) -> None:
        """Pass over an attachment without holding it."""
        stream = self._stream
        body_at = stream.at + RECORD_HEAD.size
        head = bytes(stream.window[body_at : body_at + min(length, WINDOW)])
        records.read_attachment(self._facts, head, where)
        stream.advance(RECORD_HEAD.size)
        crc = stream.digest(length - _U32.size)
        (claimed,) = _U32.unpack(stream.read_up_to(_U32.size))
        if claimed and claimed != crc:
            self._losses.note(Malformed(f"attachment at {where}", "its checksum is wrong"))

    def pass_data_end(self, total: int, where: str) -> None:
        """Pass over the record that ends the data section."""
        stream = self._stream
        (claimed,) = _U32.unpack_from(stream.window, stream.at + RECORD_HEAD.size)
        if self._data_end is None and claimed and claimed != stream.crc() and not self._losses.damage:
            place = f"data section (to {where})"
            self._losses.note(Malformed(place, "its checksum is wrong: some of its bytes are not as they were written"))
            # Whole records may be gone without a trace.
            self._losses.messages_are_known = False
        stream.advance(total)
        stream.restart_crc()
        self._data_end = stream.position

    def pass_footer(self, where: str) -> None:
        """Pass over the footer and the magic behind it."""
        stream = self._stream
        body_at = stream.at + RECORD_HEAD.size
        summary_start, _offsets_start, claimed = records.FOOTER_BODY.unpack_from(stream.window, body_at)
        stream.advance(RECORD_HEAD.size + records.FOOTER_BODY.size - _U32.size)
        if claimed and summary_start == self._data_end and claimed != stream.crc() and not self._losses.damage:
            self._losses.note_index(Malformed(where, "the checksum of the summary section is wrong"))
        stream.advance(_U32.size + len(records.MAGIC))
        if stream.left:
            # It may be that of a file inside of this one, whose place the search came upon: the scan goes on.
            self._losses.note(Malformed(f"byte {stream.position}", f"{stream.left} bytes follow its end"))
