/** `nav_msgs/OccupancyGrid` as an image on the ground. Source: nav_msgs/OccupancyGrid, nav_msgs/MapMetaData. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { IDENTITY, type Pose } from "./poses";
import { bytesOf, countOf, numberOf, part, poseOf } from "./values";
import { MAX_GRID_CELLS } from "../limits";

export interface GridImage {
  readonly width: number;
  readonly height: number;
  /** One byte for each cell, the first row at the origin: occupancy in percent, from 0 to 100, or 255 for unknown. */
  readonly cells: Uint8Array<ArrayBuffer>;
  /** The length of a drawn cell, in metres. */
  readonly cellM: number;
  /** The pose of the corner of cell (0, 0). */
  readonly origin: Pose;
  /** Cells of the message. */
  readonly totalCells: number;
}

const UNKNOWN = 255;
const OCCUPIED = 100;

/** Return the grid; of a large one, every n-th cell in both directions.
 *
 * @throws ReadFailure grid_unreadable.
 */
export function occupancyGrid(message: Value): GridImage {
  const data = bytesOf(part(message, "data"));
  const [fullWidth, fullHeight] = [countOf(part(message, "info", "width")), countOf(part(message, "info", "height"))];
  const resolutionM = numberOf(part(message, "info", "resolution"));
  const totalCells = fullWidth * fullHeight;
  if (totalCells === 0) throw new ReadFailure("grid_unreadable", `${fullWidth} × ${fullHeight} cells`);
  if (data === null || data.length < totalCells) throw new ReadFailure("grid_unreadable", `${data?.length ?? 0} bytes for ${fullWidth} × ${fullHeight} cells`);
  if (!(resolutionM > 0 && Number.isFinite(resolutionM))) throw new ReadFailure("grid_unreadable", `cells of ${resolutionM} m`);
  const stride = Math.max(1, Math.ceil(Math.sqrt(totalCells / MAX_GRID_CELLS)), Math.ceil(Math.max(fullWidth, fullHeight) / MAX_SIDE));
  const [width, height] = [Math.ceil(fullWidth / stride), Math.ceil(fullHeight / stride)];
  const cells = new Uint8Array(width * height);
  for (let row = 0; row < height; row += 1) {
    for (let column = 0; column < width; column += 1) {
      const occupancy = data[row * stride * fullWidth + column * stride] ?? UNKNOWN;
      cells[row * width + column] = occupancy > OCCUPIED ? UNKNOWN : occupancy;
    }
  }
  const origin = poseOf(part(message, "info", "origin")) ?? IDENTITY;
  return { width, height, cells, cellM: resolutionM * stride, origin, totalCells };
}

/** The longest side of a texture that every browser with WebGL 2 has. */
const MAX_SIDE = 2_048;
