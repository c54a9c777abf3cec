"""Schema and bytes of a message -> a value; many messages -> a table; pictures and point clouds -> arrays.

Pure functions over untrusted bytes: schemas and messages are bounded (`limits`), and what cannot be decoded has a
named reason. Nothing is imported from the extra `reading` (numpy, pyarrow, pandas, pillow, protobuf) before it is
needed; without numpy, arrays of numbers are `array.array`.
"""

from kleinkram.recordings.decoding.columns import NoSuchField
from kleinkram.recordings.decoding.decoder import Decoder, decoder_for
from kleinkram.recordings.decoding.errors import DecodeError, ReadingExtraMissing, Undecodable
from kleinkram.recordings.decoding.images import image
from kleinkram.recordings.decoding.points import points
from kleinkram.recordings.decoding.tables import arrow_batches, to_arrow, to_pandas
from kleinkram.recordings.decoding.values import Value, stamp_ns, to_plain

__all__ = [
    "DecodeError",
    "Decoder",
    "NoSuchField",
    "ReadingExtraMissing",
    "Undecodable",
    "Value",
    "arrow_batches",
    "decoder_for",
    "image",
    "points",
    "stamp_ns",
    "to_arrow",
    "to_pandas",
    "to_plain",
]
