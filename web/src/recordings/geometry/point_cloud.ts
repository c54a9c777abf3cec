/** Points of `sensor_msgs/PointCloud2` and `foxglove.PointCloud`, by their fields.
 *
 * Source: sensor_msgs/PointCloud2, sensor_msgs/PointField; foxglove.PackedElementField; pcl::PCLPointCloud2 for `rgb`.
 */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { IDENTITY, type Pose } from "./poses";
import { PointCollector, strideOf, type PointSet } from "./points";
import { bytesOf, countOf, listOf, numberOf, part, poseOf, textOf } from "./values";

interface NumberKind {
  readonly bytes: number;
  readonly get: (view: DataView, at: number, isLittle: boolean) => number;
}

const INT8: NumberKind = { bytes: 1, get: (view, at) => view.getInt8(at) };
const UINT8: NumberKind = { bytes: 1, get: (view, at) => view.getUint8(at) };
const INT16: NumberKind = { bytes: 2, get: (view, at, isLittle) => view.getInt16(at, isLittle) };
const UINT16: NumberKind = { bytes: 2, get: (view, at, isLittle) => view.getUint16(at, isLittle) };
const INT32: NumberKind = { bytes: 4, get: (view, at, isLittle) => view.getInt32(at, isLittle) };
const UINT32: NumberKind = { bytes: 4, get: (view, at, isLittle) => view.getUint32(at, isLittle) };
const FLOAT32: NumberKind = { bytes: 4, get: (view, at, isLittle) => view.getFloat32(at, isLittle) };
const FLOAT64: NumberKind = { bytes: 8, get: (view, at, isLittle) => view.getFloat64(at, isLittle) };

/** By `PointField.datatype`, which begins at 1. */
const ROS_KINDS: readonly NumberKind[] = [INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64];
/** By `PackedElementField.type`, which begins at 1. */
const FOXGLOVE_KINDS: readonly NumberKind[] = [UINT8, INT8, UINT16, INT16, UINT32, INT32, FLOAT32, FLOAT64];

interface PointField {
  readonly name: string;
  readonly offset: number;
  readonly kind: NumberKind;
}

/** How the points of a message are stored. */
interface Layout {
  readonly fields: readonly PointField[];
  readonly pointStep: number;
  readonly rowStep: number;
  readonly width: number;
  readonly height: number;
  readonly isLittle: boolean;
  readonly data: Uint8Array;
}

/** Fields that points are coloured by, the most useful first; others follow in their order. */
const PREFERRED = ["intensity", "reflectivity", "ring"];
const MAX_CHANNELS = 4;
const MAX_FIELDS = 256;
const PACKED_COLOURS = new Set(["rgb", "rgba"]);
const AXES = ["x", "y", "z"] as const;

/** Return the points of a `sensor_msgs/PointCloud2`. A missing z is 0.
 *
 * @throws ReadFailure cloud_unreadable.
 */
export function pointCloud2(message: Value): PointSet {
  const data = bytesOf(part(message, "data"));
  if (data === null) throw new ReadFailure("cloud_unreadable", "it has no data");
  const fields = listOf(part(message, "fields")).slice(0, MAX_FIELDS);
  const width = countOf(part(message, "width"));
  const pointStep = countOf(part(message, "point_step"));
  const rowStep = countOf(part(message, "row_step"));
  return pointsOf({
    fields: fields.flatMap((field) => fieldOf(field, ROS_KINDS[numberOf(part(field, "datatype")) - 1])),
    pointStep,
    rowStep: rowStep === 0 ? width * pointStep : rowStep,
    width,
    height: countOf(part(message, "height")),
    isLittle: numberOf(part(message, "is_bigendian")) !== 1,
    data,
  });
}

/** Return the points of a `foxglove.PointCloud`, and the pose of its origin.
 *
 * @throws ReadFailure cloud_unreadable.
 */
export function foxglovePointCloud(message: Value): { points: PointSet; pose: Pose } {
  const data = bytesOf(part(message, "data"));
  const pointStep = countOf(part(message, "point_stride"));
  if (data === null) throw new ReadFailure("cloud_unreadable", "it has no data");
  const fields = listOf(part(message, "fields")).slice(0, MAX_FIELDS);
  const width = pointStep === 0 ? 0 : Math.floor(data.length / pointStep);
  const points = pointsOf({
    fields: fields.flatMap((field) => fieldOf(field, FOXGLOVE_KINDS[numberOf(part(field, "type")) - 1])),
    pointStep,
    rowStep: width * pointStep,
    width,
    height: 1,
    isLittle: true,
    data,
  });
  return { points, pose: poseOf(part(message, "pose")) ?? IDENTITY };
}

function fieldOf(field: Value, kind: NumberKind | undefined): readonly PointField[] {
  const offset = numberOf(part(field, "offset"));
  if (kind === undefined || !Number.isSafeInteger(offset) || offset < 0) return [];
  return [{ name: textOf(part(field, "name")), offset, kind }];
}

function pointsOf(layout: Layout): PointSet {
  const { fields, pointStep, width, height } = layout;
  const total = width * height;
  if (total === 0) return new PointCollector(0, []).points(0);
  if (!Number.isSafeInteger(total)) throw new ReadFailure("cloud_unreadable", `${width} × ${height} points`);
  const inside = fields.filter(({ offset, kind }) => offset + kind.bytes <= pointStep);
  const [x, y, z] = AXES.map((axis) => inside.find(({ name }) => name === axis));
  if (x === undefined || y === undefined) throw new ReadFailure("cloud_unreadable", "it has no fields x and y");
  if (layout.rowStep < width * pointStep) throw new ReadFailure("cloud_unreadable", `rows of ${layout.rowStep} bytes for ${width} points of ${pointStep} bytes`);
  const available = availablePoints(layout);
  if (available === 0) throw new ReadFailure("cloud_unreadable", `${layout.data.length} bytes for ${total} points of ${pointStep} bytes`);
  const colour = inside.find(({ name, kind }) => PACKED_COLOURS.has(name) && kind.bytes === 4);
  const channels = channelsOf(inside.filter((field) => field !== colour));
  return read(layout, available, { x, y, z, channels, colour });
}

/** Return how many points are whole in the data, in the order of the message. */
function availablePoints({ data, rowStep, pointStep, width, height }: Layout): number {
  const rows = Math.min(height, Math.floor(data.length / rowStep));
  const rest = rows === height ? 0 : Math.min(width, Math.floor((data.length - rows * rowStep) / pointStep));
  return rows * width + rest;
}

function channelsOf(fields: readonly PointField[]): readonly PointField[] {
  const values = fields.filter(({ name }) => name !== "" && !AXES.some((axis) => axis === name));
  const rank = ({ name }: PointField): number => (PREFERRED.includes(name) ? PREFERRED.indexOf(name) : PREFERRED.length);
  return values.toSorted((a, b) => rank(a) - rank(b)).slice(0, MAX_CHANNELS);
}

interface ReadFields {
  readonly x: PointField;
  readonly y: PointField;
  readonly z: PointField | undefined;
  readonly channels: readonly PointField[];
  readonly colour: PointField | undefined;
}

function read(layout: Layout, available: number, { x, y, z, channels, colour }: ReadFields): PointSet {
  const { data, isLittle, width, height, rowStep, pointStep } = layout;
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const stride = strideOf(available);
  const collector = new PointCollector(Math.ceil(available / stride), channels.map(({ name }) => name), colour?.name ?? null);
  const value = (field: PointField, at: number): number => field.kind.get(view, at + field.offset, isLittle);
  for (let number = 0; number < available; number += stride) {
    const at = Math.floor(number / width) * rowStep + (number % width) * pointStep;
    const place = collector.add(value(x, at), value(y, at), z === undefined ? 0 : value(z, at));
    if (place === null) continue;
    channels.forEach((field, channel) => collector.setValue(place, channel, value(field, at)));
    if (colour === undefined) continue;
    const packed = view.getUint32(at + colour.offset, isLittle);
    collector.setColour(place, (packed >> 16) & 0xff, (packed >> 8) & 0xff, packed & 0xff);
  }
  const total = width * height;
  return collector.points(total, total - available);
}
