/** What coded frames say about themselves: whether decoding can begin with them, and with which codec.
 *
 * Sources: ITU-T H.264 7.3.1 and Annex B, H.265 7.3.1 and 7.3.3; VP9 bitstream specification 6.2; AV1 specification 5.3
 * and 5.5; RFC 6381, ISO/IEC 14496-15 Annex E, and the ISO BMFF bindings of VP9 and AV1 for the names of codecs.
 */

export const VIDEO_FORMATS = ["h264", "h265", "vp9", "av1"] as const;
export type VideoFormat = (typeof VIDEO_FORMATS)[number];

const TYPE = /^foxglove(\.|_msgs\/(msg\/)?)CompressedVideo$/;

/** Whether messages of a type are the frames of a video. */
export function isVideoType(messageType: string): boolean {
  return TYPE.test(messageType);
}

/** Return the codec of a frame with which decoding can begin, as WebCodecs names it; null for other frames. */
export function keyFrameCodec(format: VideoFormat, data: Uint8Array): string | null {
  return READERS[format](data);
}

const READERS: Readonly<Record<VideoFormat, (data: Uint8Array) => string | null>> = { h264, h265, vp9, av1 };
const [H264_IDR, H264_SPS] = [5, 7];
const [H265_FIRST_KEY, H265_LAST_KEY, H265_SPS] = [16, 21, 33];
const H265_PROFILE_AT = 3;
const AV1_SEQUENCE_HEADER = 1;
const MAX_UNITS = 1_000;

function h264(data: Uint8Array): string | null {
  const units = nalUnits(data);
  const isKey = units.some((unit) => ((unit[0] ?? 0) & 31) === H264_IDR);
  const parameters = units.find((unit) => ((unit[0] ?? 0) & 31) === H264_SPS);
  if (!isKey || parameters === undefined || parameters.length < 4) return null;
  return `avc1.${Array.from(parameters.subarray(1, 4), hex).join("")}`;
}

function h265(data: Uint8Array): string | null {
  const typeOf = (unit: Uint8Array): number => ((unit[0] ?? 0) >> 1) & 63;
  const units = nalUnits(data);
  const isKey = units.some((unit) => typeOf(unit) >= H265_FIRST_KEY && typeOf(unit) <= H265_LAST_KEY);
  const parameters = units.find((unit) => typeOf(unit) === H265_SPS);
  if (!isKey || parameters === undefined) return null;
  const profile = withoutEmulationPrevention(parameters).subarray(H265_PROFILE_AT, H265_PROFILE_AT + 12);
  return profile.length < 12 ? null : h265Codec(profile);
}

/** The codec of a profile, tier and level: 1 byte, 4 of compatibility, 6 of constraints, 1 of the level. */
function h265Codec(bytes: Uint8Array): string {
  const [first = 0] = bytes;
  const space = ["", "A", "B", "C"][first >> 6] ?? "";
  let compatibility = 0;
  for (let bit = 0; bit < 32; bit += 1) compatibility += (((bytes[1 + (bit >> 3)] ?? 0) >> (7 - (bit & 7))) & 1) * 2 ** bit;
  const constraints = Array.from(bytes.subarray(5, 11));
  while (constraints.at(-1) === 0) constraints.pop();
  const tier = (first & 32) === 0 ? "L" : "H";
  return [`hev1.${space}${first & 31}`, compatibility.toString(16), `${tier}${bytes[11]}`, ...constraints.map((byte) => byte.toString(16))].join(".");
}

function vp9([first = 0]: Uint8Array): string | null {
  if (first >> 6 !== 2) return null;
  const profile = ((first >> 5) & 1) + 2 * ((first >> 4) & 1);
  const flags = profile === 3 ? first >> 1 : first >> 2; // a reserved bit more
  const [showsOther, isBetween] = [(flags >> 1) & 1, flags & 1];
  if (showsOther === 1 || isBetween === 1) return null;
  return `vp09.0${profile}.10.${profile < 2 ? "08" : "10"}`;
}

function av1(data: Uint8Array): string | null {
  for (let at = 0, units = 0; at < data.length && units < MAX_UNITS; units += 1) {
    const head = data[at] ?? 0;
    const hasSize = (head & 2) !== 0;
    const sizeAt = at + ((head & 4) === 0 ? 1 : 2);
    const { value: size, length } = hasSize ? leb128(data, sizeAt) : { value: data.length - sizeAt, length: 0 };
    const start = sizeAt + length;
    if (((head >> 3) & 15) === AV1_SEQUENCE_HEADER && start < data.length) return `av01.${(data[start] ?? 0) >> 5}.08M.08`;
    at = start + size;
  }
  return null;
}

function leb128(data: Uint8Array, at: number): { value: number; length: number } {
  let value = 0;
  for (let length = 0; length < 8; length += 1) {
    const byte = data[at + length] ?? 0;
    value += (byte & 127) * 2 ** (7 * length);
    if (byte < 128) return { value, length: length + 1 };
  }
  return { value, length: 8 };
}

/** Return the units between start codes. */
function nalUnits(data: Uint8Array): Uint8Array[] {
  const starts: number[] = [];
  for (let at = data.indexOf(1, 2); at >= 0 && starts.length < MAX_UNITS; at = data.indexOf(1, at + 1)) {
    if (data[at - 1] === 0 && data[at - 2] === 0) starts.push(at + 1);
  }
  return starts.map((start, place) => data.subarray(start, (starts[place + 1] ?? data.length + 3) - 3));
}

function withoutEmulationPrevention(unit: Uint8Array): Uint8Array {
  return unit.filter((byte, at) => !(byte === 3 && at >= 2 && unit[at - 1] === 0 && unit[at - 2] === 0));
}

function hex(byte: number): string {
  return byte.toString(16).padStart(2, "0");
}
