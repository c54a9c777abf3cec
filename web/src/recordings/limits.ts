/** Limits for reading untrusted files: memory, time, and data read without confirmation. Bytes unless named. */

const MIB = 2 ** 20;

/** What one block of the cache holds; reads are rounded to it. */
export const BLOCK = 128 * 1024;
/** What the cache keeps of one recording. */
export const MAX_CACHED = 48 * MIB;
/** What the decompressed chunks of one recording take up in memory, and those of all that are open at once. */
export const MAX_CHUNK_CACHE = 64 * MIB;
export const MAX_CHUNK_CACHES = 256 * MIB;
export const MAX_CHUNK_CACHES_ON_PHONES = 96 * MIB;
/** The longest piece that is read at once: an index, or a chunk with its index. */
export const MAX_READ_AT_ONCE = 96 * MIB;
/** The largest chunk once it is decompressed. */
export const MAX_UNPACKED = 128 * MIB;
/** Decompressed chunks that overlap in time and are in memory at once. */
export const MAX_OVERLAPPING = 384 * MIB;
/** A file that is compressed as a whole, as it is stored, and decompressed into memory. */
export const MAX_WHOLE_PACKED = 64 * MIB;
export const MAX_WHOLE_UNPACKED = 256 * MIB;
/** Damaged parts that are named. */
export const MAX_DAMAGED = 100;
/** Read ahead while a curve reads chunk after chunk. */
export const READ_AHEAD = 4 * MIB;
/** Data that a plot reads without confirmation. */
export const MAX_BYTES_UNCONFIRMED = 32 * MIB;
/** The largest picture, in pixels. */
export const MAX_PIXELS = 64 * 1_000_000;
/** The same for compressed pictures of 16 bits, which are decompressed here. */
export const MAX_GREY_PIXELS = 16 * 1_000_000;
/** How far before a frame of a video its key frame is searched: frames, bytes and time. */
export const MAX_VIDEO_FRAMES = 900;
export const MAX_VIDEO_BYTES = 32 * MIB;
export const MAX_VIDEO_NS = 30_000_000_000n;
/** Points of annotations that are drawn over a picture. */
export const MAX_ANNOTATION_POINTS = 10_000;
/** Points of one message that are drawn; of more, every n-th. */
export const MAX_POINTS = 300_000;
/** Cells of an occupancy grid that are drawn. */
export const MAX_GRID_CELLS = 2_000_000;
/** Markers of a topic, and points of all markers of a message. */
export const MAX_MARKERS = 5_000;
export const MAX_MARKER_POINTS = 100_000;
/** Transforms of one message, frames of a recording, and transforms of a frame at different times. */
export const MAX_TRANSFORMS = 2_000;
export const MAX_FRAMES = 5_000;
export const MAX_TRANSFORM_SAMPLES = 20_000;
/** Values inside one message that are decoded, such as elements of arrays of messages. */
export const MAX_VALUES = 200_000;
/** How deep messages may nest. */
export const MAX_DEPTH = 40;
/** A definition of a message, in characters or bytes. */
export const MAX_DEFINITION = 4 * MIB;
/** Elements of an array that are offered as fields of a plot. */
export const MAX_ELEMENTS = 16;
/** Fields that are offered for plotting. */
export const MAX_FIELDS = 600;
/** A slice that a browser keeps in memory, because it cannot write a file. */
export const MAX_SLICE_IN_MEMORY = 1_000_000_000;
/** Messages of one answer. */
export const MAX_MESSAGES_AT_ONCE = 20_000;
/** Curves in one plot. */
export const MAX_CURVES = 6;
/** The store must send something within this time. */
export const STORE_TIMEOUT_MS = 30_000;
/** The worker must send a message within this time. */
export const WORKER_TIMEOUT_MS = 45_000;
