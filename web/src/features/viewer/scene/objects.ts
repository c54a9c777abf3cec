// Objects of three.js for what is placed in a scene. Each frees its memory on the GPU by `dispose`.
import {
  BufferAttribute, BufferGeometry, DataTexture, DoubleSide, LineBasicMaterial, LineSegments, Line, Mesh, MeshBasicMaterial, NearestFilter,
  NormalBlending, PlaneGeometry, Points, ShaderMaterial, type Object3D,
} from "three";
import { colourFieldOf, NO_VALUE, sharesOf } from "./colour_fields";
import { colourTable, MAP_SIZE, type ColourMap } from "./colour_maps";
import type { GridImage } from "@/recordings/geometry/occupancy_grid";
import type { PointSet } from "@/recordings/geometry/points";
import type { PoseSequence } from "@/recordings/geometry/pose_list";
import { rotated, type Vector } from "@/recordings/geometry/poses";

export interface SceneObject {
  readonly object: Object3D;
  /** Where the object is in the pose of its item. */
  readonly offset: Vector;
  readonly points: number;
  /** Changes how points are drawn; other objects ignore it. */
  readonly style: (style: PointStyle) => void;
  readonly dispose: () => void;
}

export interface PointStyle {
  readonly colourBy: string | null;
  readonly colourMap: ColourMap;
  readonly sizePx: number;
  /** The colour of points that have no value. */
  readonly plain: number;
}

const MODE = { plain: 0, value: 1, rgb: 2 } as const;
const RED = [0.9, 0.25, 0.2] as const;
const GREEN = [0.3, 0.7, 0.25] as const;
const BLUE = [0.25, 0.45, 0.95] as const;
const MAX_AXES = 5_000;

const VERTEX = `
attribute float value;
attribute vec3 rgb;
uniform float size;
varying float share;
varying vec3 own;
void main() {
  share = value;
  own = rgb;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  gl_PointSize = size;
}`;

const FRAGMENT = `
uniform int mode;
uniform vec3 plain;
uniform sampler2D map;
varying float share;
varying vec3 own;
void main() {
  vec3 colour = plain;
  if (mode == 1 && share >= 0.0) colour = texture2D(map, vec2(share, 0.5)).rgb;
  if (mode == 2) colour = own;
  gl_FragColor = vec4(colour, 1.0);
}`;

export function pointObject(points: PointSet): SceneObject {
  const count = points.positions.length / 3;
  const geometry = new BufferGeometry();
  const values = new BufferAttribute(new Float32Array(count).fill(NO_VALUE), 1);
  geometry.setAttribute("position", new BufferAttribute(points.positions, 3));
  geometry.setAttribute("value", values);
  geometry.setAttribute("rgb", new BufferAttribute(points.colours?.rgb ?? new Uint8Array(3 * count), 3, true));
  const map = new DataTexture(colourTable("turbo"), MAP_SIZE, 1);
  const uniforms = { size: { value: 1 }, mode: { value: 0 }, plain: { value: [1, 1, 1] }, map: { value: map } };
  const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms });
  let styledBy = "";
  const style = ({ colourBy, colourMap, sizePx, plain }: PointStyle): void => {
    uniforms.size.value = sizePx;
    uniforms.plain.value = channelsOf(plain);
    const field = colourFieldOf(points, colourBy);
    if (styledBy === `${colourMap} ${field}`) return;
    styledBy = `${colourMap} ${field}`;
    const shares = sharesOf(points, field);
    uniforms.mode.value = shares !== null ? MODE.value : points.colours?.name === field ? MODE.rgb : MODE.plain;
    if (shares !== null) values.array.set(shares);
    values.needsUpdate = true;
    map.image.data?.set(colourTable(colourMap));
    map.needsUpdate = true;
  };
  const dispose = (): void => [geometry, material, map].forEach((part) => part.dispose());
  return { object: new Points(geometry, material), offset: points.origin, points: count, style, dispose };
}

function channelsOf(colour: number): [number, number, number] {
  return [(colour >> 16) & 0xff, (colour >> 8) & 0xff, colour & 0xff].map((channel) => channel / 255) as [number, number, number];
}

/** Returns a line through poses, or the three axes of each. */
export function poseObject({ poses, isPath }: PoseSequence, lengthM: number): SceneObject {
  const origin = poses[0]?.position ?? [0, 0, 0];
  const relative = (point: Vector): number[] => point.map((coordinate, axis) => coordinate - (origin[axis] ?? 0));
  const geometry = new BufferGeometry();
  const isLine = isPath && poses.length > 1;
  if (isLine) {
    geometry.setAttribute("position", new BufferAttribute(Float32Array.from(poses.flatMap(({ position }) => relative(position))), 3));
  } else {
    const drawn = poses.slice(0, MAX_AXES);
    const ends = drawn.flatMap(({ position: [x, y, z], orientation }) =>
      ([[lengthM, 0, 0], [0, lengthM, 0], [0, 0, lengthM]] as const).flatMap((axis) => {
        const [ax, ay, az] = rotated(orientation, axis);
        return [...relative([x, y, z]), ...relative([x + ax, y + ay, z + az])];
      }),
    );
    geometry.setAttribute("position", new BufferAttribute(Float32Array.from(ends), 3));
    geometry.setAttribute("color", new BufferAttribute(Float32Array.from(drawn.flatMap(() => [RED, RED, GREEN, GREEN, BLUE, BLUE].flat())), 3));
  }
  const material = new LineBasicMaterial(isLine ? { color: 0x2fa36b } : { vertexColors: true });
  const object = isLine ? new Line(geometry, material) : new LineSegments(geometry, material);
  return { object, offset: origin, points: 0, style: () => undefined, dispose: () => [geometry, material].forEach((part) => part.dispose()) };
}

/** Returns a grid as an image: free cells light, occupied ones dark, unknown ones transparent. */
export function gridObject({ width, height, cells, cellM }: GridImage): SceneObject {
  const rgba = new Uint8Array(4 * cells.length);
  cells.forEach((occupancy, place) => {
    const grey = occupancy > 100 ? 128 : Math.round(250 - 2.3 * occupancy);
    rgba.set([grey, grey, grey, occupancy > 100 ? 40 : 220], 4 * place);
  });
  const texture = new DataTexture(rgba, width, height);
  [texture.magFilter, texture.minFilter] = [NearestFilter, NearestFilter];
  texture.needsUpdate = true;
  const geometry = new PlaneGeometry(width * cellM, height * cellM);
  geometry.translate((width * cellM) / 2, (height * cellM) / 2, 0);
  const material = new MeshBasicMaterial({ map: texture, transparent: true, blending: NormalBlending, side: DoubleSide, depthWrite: false });
  const dispose = (): void => [texture, geometry, material].forEach((part) => part.dispose());
  return { object: new Mesh(geometry, material), offset: [0, 0, 0], points: 0, style: () => undefined, dispose };
}
