"""Decodes messages: bytes to values, topics to tables, images and point clouds to arrays.

Pure functions over untrusted bytes: schemas and messages are bounded (see `types`), and whatever cannot be decoded has
a reason. The libraries of the extra `reading` (numpy, pyarrow, pandas, pillow, protobuf) are imported only where they
are needed; without numpy, arrays of numbers are `array.array`.
"""

from kleinkram.recordings.decoding.decoder import Decoder, decoder_for
from kleinkram.recordings.decoding.sensor_data import image, points
from kleinkram.recordings.decoding.tables import NoSuchField, arrow_batches, to_arrow, to_pandas
from kleinkram.recordings.decoding.types import DecodeError, ReadingExtraMissing, Undecodable
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
