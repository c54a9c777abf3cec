"""A small video in H.264 (Annex B, baseline profile), written from the specification, without a library.

Source: ITU-T H.264 7.3 (syntax), 7.4.1.1 (emulation prevention), 9.1 (Exp-Golomb codes).
"""

from collections.abc import Iterable

# 64 x 48 pixels in macroblocks of 16 x 16.
_COLUMNS, _ROWS = 4, 3
_KEY_EVERY = 20
_SPS, _PPS, _IDR, _NOT_IDR = 0x67, 0x68, 0x65, 0x41
_I_SLICE, _P_SLICE = 7, 5
_I_PCM, _I_PCM_IN_P = 25, 30
_BLACK, _WHITE = 16, 235
# Y, Cb, Cr of (220, 30, 30) and (30, 30, 220) in BT.601.
_RED, _BLUE = (91, 100, 212), (60, 216, 111)


class _Bits:
    """The bits of a unit."""

    def __init__(self) -> None:
        self._bits: list[str] = []

    def fixed(self, value: int, width: int) -> None:
        self._bits.append(f"{value:0{width}b}")

    def codes(self, *values: int) -> None:
        """Exp-Golomb codes, which are also those of the signed number 0."""
        for value in values:
            code = f"{value + 1:b}"
            self._bits.append("0" * (len(code) - 1) + code)

    def align(self) -> None:
        self._bits.append("0" * (-sum(map(len, self._bits)) % 8))

    def unit(self, head: int) -> bytes:
        """The unit behind a start code, with the bit that ends it, and with emulation prevention."""
        text = "".join(self._bits) + "1"
        text += "0" * (-len(text) % 8)
        payload = int(text, 2).to_bytes(len(text) // 8, "big")
        unit = bytearray()
        for byte in payload:
            if byte <= 3 and unit[-2:] == b"\0\0":
                unit.append(3)
            unit.append(byte)
        return b"\0\0\0\1" + bytes([head]) + bytes(unit)


def h264_frames(count: int) -> list[bytes]:
    """Frames that show their number as eight bars above a red and a blue half.

    Every 20th is a key frame. The others have the bars only; the rest of the picture is that of the frame before.
    """
    return [_frame(number) for number in range(count)]


def _frame(number: int) -> bytes:
    since_key = number % _KEY_EVERY
    bits = _Bits()
    bars = [_bars(number, column) for column in range(_COLUMNS)]
    if since_key == 0:
        bits.codes(0, _I_SLICE, 0)
        bits.fixed(0, 8)  # frame_num
        bits.codes(number // _KEY_EVERY % 2)  # idr_pic_id
        bits.fixed(0, 2)  # dec_ref_pic_marking
        bits.codes(0, 1)  # slice_qp_delta, no deblocking
        halves = [_plain(_RED if column < _COLUMNS // 2 else _BLUE) for column in range(_COLUMNS)]
        for macroblock in bars + halves * (_ROWS - 1):
            _add_pcm(bits, _I_PCM, macroblock)
        return _parameters() + bits.unit(_IDR)
    bits.codes(0, _P_SLICE, 0)
    bits.fixed(since_key, 8)
    bits.fixed(0, 3)  # no other number of references, no other order, no marking
    bits.codes(0, 1)
    for macroblock in bars:
        bits.codes(0)  # mb_skip_run
        _add_pcm(bits, _I_PCM_IN_P, macroblock)
    bits.codes(_COLUMNS * (_ROWS - 1))  # mb_skip_run: the halves
    return bits.unit(_NOT_IDR)


def _add_pcm(bits: _Bits, macroblock_type: int, samples: Iterable[int]) -> None:
    bits.codes(macroblock_type)
    bits.align()
    for sample in samples:
        bits.fixed(sample, 8)


def _bars(number: int, column: int) -> list[int]:
    """The samples of the macroblock with two of the eight bars, the highest bit first."""
    left, right = ((number >> (7 - 2 * column - bar)) & 1 for bar in (0, 1))
    row = [_WHITE if left else _BLACK] * 8 + [_WHITE if right else _BLACK] * 8
    return row * 16 + [128] * 128


def _plain(colour: tuple[int, int, int]) -> list[int]:
    return [colour[0]] * 256 + [colour[1]] * 64 + [colour[2]] * 64


def _parameters() -> bytes:
    sequence = _Bits()
    sequence.fixed(66, 8)  # profile_idc
    sequence.fixed(0xC0, 8)
    sequence.fixed(30, 8)  # level_idc
    sequence.codes(0, 4, 2, 1)  # id, frame_num has 8 bits, order of output is that of decoding, references
    sequence.fixed(0, 1)
    sequence.codes(_COLUMNS - 1, _ROWS - 1)
    sequence.fixed(0b1100, 4)  # frames only, direct_8x8_inference; no cropping, no VUI
    picture = _Bits()
    picture.codes(0, 0)
    picture.fixed(0, 2)  # CAVLC
    picture.codes(0, 0, 0)
    picture.fixed(0, 3)
    picture.codes(0, 0, 0)
    picture.fixed(0b100, 3)  # deblocking_filter_control_present_flag
    return sequence.unit(_SPS) + picture.unit(_PPS)
