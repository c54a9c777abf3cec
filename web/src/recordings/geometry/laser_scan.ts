/** Points of `sensor_msgs/LaserScan`, in the plane z = 0 of its frame. Source: sensor_msgs/LaserScan. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { pointSetOf, strideOf, type PointSet } from "./points";
import { numberOf, numbersOf, part } from "./values";

/** Return the points of a scan; ranges outside of its limits are not measured.
 *
 * @throws ReadFailure cloud_unreadable.
 */
export function laserScan(message: Value): PointSet {
  const ranges = numbersOf(part(message, "ranges"));
  const intensities = numbersOf(part(message, "intensities"));
  const start = numberOf(part(message, "angle_min"));
  const step = numberOf(part(message, "angle_increment"));
  if (!Number.isFinite(start) || !Number.isFinite(step)) throw new ReadFailure("cloud_unreadable", "its angles are no numbers");
  const [least, greatest] = [numberOf(part(message, "range_min")), numberOf(part(message, "range_max"))];
  const hasIntensities = intensities.length > 0 && intensities.length === ranges.length;
  const stride = strideOf(ranges.length);
  const count = Math.ceil(ranges.length / stride);
  const [x, y, z] = [new Float64Array(count), new Float64Array(count), new Float64Array(count)];
  const [range, intensity] = [new Float32Array(count), new Float32Array(count)];
  for (let place = 0; place < count; place += 1) {
    const number = place * stride;
    const measured = ranges[number] ?? Number.NaN;
    const distance = measured < least || measured > greatest ? Number.NaN : measured;
    x[place] = distance * Math.cos(start + number * step);
    y[place] = distance * Math.sin(start + number * step);
    range[place] = distance;
    intensity[place] = hasIntensities ? (intensities[number] ?? Number.NaN) : Number.NaN;
  }
  const channels = [{ name: "range", values: range }, ...(hasIntensities ? [{ name: "intensity", values: intensity }] : [])];
  return pointSetOf({ x, y, z, channels, colours: null }, ranges.length);
}
