/** Points of `sensor_msgs/LaserScan`, in the plane z = 0 of its frame. Source: sensor_msgs/LaserScan. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { PointCollector, strideOf, type PointSet } from "./points";
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
  const names = hasIntensities ? ["range", "intensity"] : ["range"];
  const collector = new PointCollector(Math.ceil(ranges.length / stride), names);
  for (let number = 0; number < ranges.length; number += stride) {
    const measured = ranges[number] ?? Number.NaN;
    const range = measured < least || measured > greatest ? Number.NaN : measured;
    const angle = start + number * step;
    const place = collector.add(range * Math.cos(angle), range * Math.sin(angle), 0);
    if (place === null) continue;
    collector.setValue(place, 0, range);
    if (hasIntensities) collector.setValue(place, 1, intensities[number] ?? Number.NaN);
  }
  return collector.points(ranges.length);
}
