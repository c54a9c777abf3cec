/** Where on the earth a message says that something is: a position of GNSS (WGS 84), or the shapes of GeoJSON.
 *
 * Sources: sensor_msgs/NavSatFix, gps_msgs/GPSFix, foxglove.LocationFix, geographic_msgs, RFC 7946 (GeoJSON).
 */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { listOf, numberOf, part, textOf } from "../geometry/values";
import { MAX_DEPTH } from "../limits";

export interface Position {
  /** Degrees. */
  latitude: number;
  longitude: number;
  /** Metres; null where it is not known. */
  altitude: number | null;
}

export interface Shape {
  kind: "point" | "line" | "area";
  positions: Position[];
}

export interface Location {
  /** Null where the receiver had no fix, or the message has no usable position. */
  position: Position | null;
  shapes: Shape[];
}

const FIX = /^(gps_(common|msgs)\/(msg\/)?GPSFix|sensor_msgs\/(msg\/)?NavSatFix|foxglove(\.|_msgs\/(msg\/)?)LocationFix|geographic_msgs\/(msg\/)?Geo(Point|PointStamped|Pose|PoseStamped))$/;
const SHAPES = /^foxglove(\.|_msgs\/(msg\/)?)GeoJSON$/;
/** Where messages have the position, the outermost first. */
const PLACES: readonly (readonly string[])[] = [[], ["position"], ["pose", "position"]];
const MAX_SHAPES = 1_000;
const MAX_POSITIONS = 20_000;
const MAX_TEXT = 8 * 2 ** 20;

/** Whether messages of a type have one position, of which many make a track. */
export function isPositionType(messageType: string | null): boolean {
  return messageType !== null && FIX.test(messageType);
}

/** Whether messages of a type have shapes instead of a position. */
export function isShapesType(messageType: string | null): boolean {
  return messageType !== null && SHAPES.test(messageType);
}

/** Whether messages of a type can be shown on a map. */
export function isLocationType(messageType: string | null): boolean {
  return isPositionType(messageType) || isShapesType(messageType);
}

/** Return where something is. @throws ReadFailure message_damaged, where the text is no GeoJSON; too_large. */
export function locationOf(message: Value): Location {
  const text = part(message, "geojson");
  if (typeof text === "string") return { position: null, shapes: shapesOf(text) };
  return { position: pointOf(message), shapes: [] };
}

/** Return the position of a message; null for one without a fix, and for GeoJSON. */
export function pointOf(message: Value): Position | null {
  return hasFix(message) ? positionIn(message) : null;
}

/** A receiver that has no fix says so by a negative status. */
function hasFix(message: Value): boolean {
  return !(numberOf(part(message, "status", "status")) < 0);
}

function positionIn(message: Value): Position | null {
  const place = PLACES.map((names) => part(message, ...names)).find((inner) => part(inner, "latitude") !== null) ?? null;
  return positionOf(numberOf(part(place, "latitude")), numberOf(part(place, "longitude")), numberOf(part(place, "altitude")));
}

/** Return a position; null for numbers that are none. */
export function positionOf(latitude: number, longitude: number, altitude: number): Position | null {
  const isUsable = Math.abs(latitude) <= 90 && Math.abs(longitude) <= 180; // false for NaN
  return isUsable ? { latitude, longitude, altitude: Number.isFinite(altitude) ? altitude : null } : null;
}

function shapesOf(text: string): Shape[] {
  if (text.length > MAX_TEXT) throw new ReadFailure("too_large", String(text.length));
  let value: Value;
  try {
    value = JSON.parse(text) as Value;
  } catch {
    throw new ReadFailure("message_damaged", "no GeoJSON");
  }
  const collector = new ShapeCollector();
  collector.addObject(value, MAX_DEPTH);
  return collector.shapes;
}

class ShapeCollector {
  readonly shapes: Shape[] = [];
  private positionsLeft = MAX_POSITIONS;

  /** Add a geometry, a feature, or a collection of them. */
  addObject(value: Value, depth: number): void {
    if (depth === 0 || this.shapes.length >= MAX_SHAPES) return;
    for (const inner of [...listOf(part(value, "features")), ...listOf(part(value, "geometries"))]) this.addObject(inner, depth - 1);
    const geometry = part(value, "geometry");
    if (geometry !== null) this.addObject(geometry, depth - 1);
    const coordinates = part(value, "coordinates");
    if (coordinates !== null) this.addCoordinates(textOf(part(value, "type")), coordinates);
  }

  private addCoordinates(type: string, coordinates: Value): void {
    const many = listOf(coordinates);
    if (type === "Point") this.add("point", [coordinates]);
    else if (type === "MultiPoint") for (const one of many) this.add("point", [one]);
    else if (type === "LineString") this.add("line", many);
    else if (type === "MultiLineString") for (const one of many) this.add("line", listOf(one));
    else if (type === "Polygon") for (const ring of many) this.add("area", listOf(ring));
    else if (type === "MultiPolygon") for (const ring of many.flatMap(listOf)) this.add("area", listOf(ring));
  }

  private add(kind: Shape["kind"], coordinates: readonly Value[]): void {
    if (this.shapes.length >= MAX_SHAPES) return;
    const positions = coordinates.slice(0, this.positionsLeft).flatMap((pair) => {
      const [longitude, latitude, altitude] = listOf(pair).map(numberOf);
      return positionOf(latitude ?? Number.NaN, longitude ?? Number.NaN, altitude ?? Number.NaN) ?? [];
    });
    this.positionsLeft -= positions.length;
    if (positions.length > 0) this.shapes.push({ kind, positions });
  }
}
