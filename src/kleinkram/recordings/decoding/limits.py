"""Every bound on what a schema or a message may claim. Both are a file's own words, so neither is believed."""

from __future__ import annotations

MAX_SCHEMA_BYTES = 2 * 2**20
"""Bytes of one schema's text. The largest ROS types have about 100 KB with all that they need."""

MAX_TYPES = 2000
"""Types that one schema may define."""

MAX_FIELDS = 6000
"""Fields of a type after all nested types are written out: this bounds the size of generated code."""

MAX_DEPTH = 24
"""How deep types may nest."""

MAX_LOOPS = 12
"""How deep arrays of types may nest: Python allows 20 blocks in one function."""

MAX_ARRAY = 2**31
"""Elements of an array of fixed length."""

MAX_OBJECTS = 1_000_000
"""Objects (nested values and arrays) that one message may turn into: at most about 200 MB."""

MAX_JSON_VALUES = 2_000_000
"""Values in one JSON message, by the commas and brackets in it."""

MAX_JSON_DEPTH = 100
"""How deep JSON may nest."""

MAX_IMAGE_PIXELS = 64_000_000
"""Pixels of one picture: above any camera on a robot, far below what a compressed bomb unpacks to."""

MAX_POINT_FIELDS = 1000
"""Fields of a point in a cloud."""

BATCH_MESSAGES = 65_536
"""Messages of one batch of a table."""

BATCH_BYTES = 16 * 2**20
"""Bytes of messages that are collected for one batch of a table."""
