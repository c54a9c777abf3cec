"""Limits on the contents of untrusted files, and on the memory that reading them takes.

Lengths in a file are untrusted: no allocation, read or loop exceeds these bounds. A summary by index takes at most
about 64 MB plus 60 bytes for each chunk of the index; a scan also holds one chunk, stored and uncompressed.
"""

from __future__ import annotations

MAX_READ = 16 * 2**20  # bytes of one `Source.read`
WINDOW = 2**20  # bytes that a sequential reader reads at a time
READ_AHEAD = 2 * 2**20  # bytes that a scan reads at a time over a network

MAX_CHUNK_BYTES = 128 * 2**20
"""Bytes of a chunk, stored or uncompressed; a larger one is not read. Writers make chunks of about 1 MB."""

LOOK_AHEAD = 16 * 2**20
"""How far a scan searches for a record behind a chunk that claims to reach beyond the end of the file."""

TAIL = 64 * 2**10  # bytes read at the end of a file at once, which usually hold the whole summary

MAX_TAKE = 8 * 2**20
"""Bytes of one record that are held in memory (index records, connection headers, the head of any other record)."""

MAX_NAME = 4096  # bytes of a topic, type, encoding or library name
MAX_NAMES = 8 * 2**20  # bytes of all names of one file together
MAX_DEFINITIONS = 32 * 2**20  # bytes of all message definitions of one file; later ones are left out
MAX_TOPICS = 20_000  # topics of one file. MCAP can count to 65535 channels, a bag to 2^32 connections.
MAX_CHUNKS = 16_000_000  # chunks of one file: 16 TB in chunks of 1 MB
MAX_PENDING_STAMPS = 1_000_000  # log times that wait until no earlier one can follow (8 bytes each)
MAX_CHUNK_INDEX = 8 * 2**20  # bytes of the index of one chunk: half a million messages
MAX_SCAN_BYTES = 16 * 2**30  # bytes of a file without index that a summary reads; a larger one stays pending for a scan
MAX_DESCRIBED_BYTES = 64 * 2**20  # bytes of a file that holds no messages, up to which a summary reads it for its facts
MAX_ZSTD_WINDOW = 2**26  # memory that a zstd frame may demand of its reader
FREE_UNPACKED = 4 * 2**30  # bytes that the chunks of any file may unpack to
MAX_EXPANSION = 200  # and, in addition, for each byte of the file so far: ten times what real recordings have

MAX_PROBLEMS = 50  # problems that a summary lists; the last one is then the number of the others
MAX_HEADER = 2**20  # bytes of a bag record's header
PARALLEL_READS = 8  # ranges in flight over a network
MAX_DAMAGE = 10_000  # damaged locations of one file that a scan keeps
MAX_FACTS = 100  # names of attachments and metadata records that are listed
