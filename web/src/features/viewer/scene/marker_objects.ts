// Objects of three.js for markers. Source: visualization_msgs/Marker.
import {
  BoxGeometry, BufferAttribute, BufferGeometry, CanvasTexture, Color, ConeGeometry, CylinderGeometry, DoubleSide, EdgesGeometry, Group, InstancedMesh, Line,
  LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshLambertMaterial, Points, PointsMaterial, Quaternion, SphereGeometry, Sprite, SpriteMaterial, Vector3,
  type Material, type Object3D, type Texture,
} from "three";
import type { SceneObject } from "./objects";
import type { Marker } from "@/recordings/geometry/markers";

/** What is freed with an object. */
type Owned = BufferGeometry | InstancedMesh | Material | Texture;

const MIN_SIZE_M = 1e-4;
const TEXT_PX = 48;
const MAX_TEXT_PX = 1_024;
/** Shares of an arrow without points. */
const HEAD_LENGTH = 0.23;
const HEAD_WIDTH = 2;
const X = new Vector3(1, 0, 0);
const Y = new Vector3(0, 1, 0);

export function markerObject(marker: Marker): SceneObject {
  const owned: Owned[] = [];
  const object = MAKERS[marker.shape](marker, (part) => {
    owned.push(part);
    return part;
  });
  const dispose = (): void => owned.forEach((part) => part.dispose());
  return { object, offset: marker.points.origin, points: 0, style: () => undefined, dispose };
}

type Own = <Part extends Owned>(part: Part) => Part;
type Make = (marker: Marker, own: Own) => Object3D;

const MAKERS: Readonly<Record<Marker["shape"], Make>> = {
  arrow,
  cube: (marker, own) => solid(marker, own(new BoxGeometry(1, 1, 1)), own),
  sphere: (marker, own) => solid(marker, own(new SphereGeometry(0.5, 20, 14)), own),
  cylinder: (marker, own) => solid(marker, own(new CylinderGeometry(0.5, 0.5, 1, 24).rotateX(Math.PI / 2)), own),
  line_strip: (marker, own) => new Line(pointGeometry(marker, own), lineMaterial(marker, own)),
  line_list: (marker, own) => new LineSegments(pointGeometry(marker, own), lineMaterial(marker, own)),
  cube_list: (marker, own) => copies(marker, own(new BoxGeometry(1, 1, 1)), own),
  sphere_list: (marker, own) => copies(marker, own(new SphereGeometry(0.5, 10, 7)), own),
  points: (marker, own) => new Points(pointGeometry(marker, own), own(new PointsMaterial({ size: Math.max(marker.scale[0], MIN_SIZE_M), ...colouring(marker) }))),
  text,
  mesh: (marker, own) => scaled(marker, new LineSegments(own(new EdgesGeometry(own(new BoxGeometry(1, 1, 1)))), lineMaterial(marker, own))),
  triangle_list: triangles,
};

function colouring({ colour: [red, green, blue, alpha], points: { colours } }: Marker): { color: Color; opacity: number; transparent: boolean; vertexColors: boolean } {
  const color = colours === null ? new Color(red, green, blue) : new Color(1, 1, 1);
  const opacity = colours === null ? alpha : 1;
  return { color, opacity, transparent: opacity < 1 || colours !== null, vertexColors: colours !== null };
}

function lineMaterial(marker: Marker, own: Own): LineBasicMaterial {
  return own(new LineBasicMaterial(colouring(marker)));
}

function pointGeometry({ points: { positions, colours } }: Marker, own: Own): BufferGeometry {
  const geometry = own(new BufferGeometry());
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  if (colours !== null) geometry.setAttribute("color", new BufferAttribute(colours, 4));
  return geometry;
}

function surface({ colour: [red, green, blue, alpha] }: Marker, own: Own): MeshLambertMaterial {
  return own(new MeshLambertMaterial({ color: new Color(red, green, blue), opacity: alpha, transparent: alpha < 1 }));
}

function scaled({ scale }: Marker, object: Object3D): Object3D {
  const [x, y, z] = scale.map((size) => Math.max(Math.abs(size), MIN_SIZE_M)) as [number, number, number];
  object.scale.set(x, y, z);
  return group(object);
}

/** The view sets the matrix of an object; what has one of its own is inside a group. */
function group(...objects: Object3D[]): Group {
  return new Group().add(...objects);
}

function solid(marker: Marker, geometry: BufferGeometry, own: Own): Object3D {
  return scaled(marker, new Mesh(geometry, surface(marker, own)));
}

function copies(marker: Marker, geometry: BufferGeometry, own: Own): Object3D {
  const { positions, colours } = marker.points;
  const { colour: [red, green, blue, alpha] } = marker;
  const count = positions.length / 3;
  const mesh = own(new InstancedMesh(geometry, own(new MeshLambertMaterial({ opacity: alpha, transparent: alpha < 1 })), count));
  const scale = new Vector3(...marker.scale.map((size) => Math.max(Math.abs(size), MIN_SIZE_M)));
  for (let place = 0; place < count; place += 1) {
    mesh.setMatrixAt(place, new Matrix4().compose(new Vector3().fromArray(positions, 3 * place), new Quaternion(), scale));
    mesh.setColorAt(place, colours === null ? new Color(red, green, blue) : new Color().fromArray(colours, 4 * place));
  }
  return mesh;
}

function triangles(marker: Marker, own: Own): Object3D {
  const geometry = pointGeometry(marker, own);
  geometry.computeVertexNormals();
  const { scale } = marker;
  const mesh = new Mesh(geometry, own(new MeshLambertMaterial({ ...colouring(marker), side: DoubleSide })));
  mesh.scale.set(scale[0] || 1, scale[1] || 1, scale[2] || 1);
  return group(mesh);
}

function arrow(marker: Marker, own: Own): Object3D {
  const { positions } = marker.points;
  const [width, height, length] = marker.scale;
  if (positions.length < 6) return arrowAlong(marker, X, { lengthM: width, shaftM: height, headM: HEAD_WIDTH * height, headLengthM: HEAD_LENGTH * width }, own);
  const [start, end] = [new Vector3().fromArray(positions), new Vector3().fromArray(positions, 3)];
  const lengthM = start.distanceTo(end);
  const headLengthM = length > 0 ? Math.min(length, lengthM) : HEAD_LENGTH * lengthM;
  const direction = end.sub(start).normalize();
  const arrowGroup = arrowAlong(marker, direction, { lengthM, shaftM: width, headM: height, headLengthM }, own);
  arrowGroup.children.forEach((part) => part.position.add(start));
  return arrowGroup;
}

interface ArrowSize {
  readonly lengthM: number;
  readonly shaftM: number;
  readonly headM: number;
  readonly headLengthM: number;
}

function arrowAlong(marker: Marker, direction: Vector3, { lengthM, shaftM, headM, headLengthM }: ArrowSize, own: Own): Group {
  const material = surface(marker, own);
  const size = (metres: number): number => Math.max(Math.abs(metres), MIN_SIZE_M);
  const shaft = new Mesh(own(new CylinderGeometry(size(shaftM) / 2, size(shaftM) / 2, size(lengthM - headLengthM), 12)), material);
  const head = new Mesh(own(new ConeGeometry(size(headM) / 2, size(headLengthM), 16)), material);
  const turn = new Quaternion().setFromUnitVectors(Y, direction);
  for (const [part, centreM] of [[shaft, (lengthM - headLengthM) / 2], [head, lengthM - headLengthM / 2]] as const) {
    part.quaternion.copy(turn);
    part.position.copy(direction).multiplyScalar(centreM);
  }
  return group(shaft, head);
}

function text(marker: Marker, own: Own): Object3D {
  const canvas = new OffscreenCanvas(1, 1);
  const context = canvas.getContext("2d");
  const font = `${TEXT_PX}px Inter, sans-serif`;
  if (context !== null) {
    context.font = font;
    canvas.width = Math.max(1, Math.min(MAX_TEXT_PX, Math.ceil(context.measureText(marker.text).width)));
    canvas.height = Math.ceil(TEXT_PX * 1.25);
    const [red, green, blue] = marker.colour.map((share) => Math.round(255 * share));
    context.font = font;
    context.textBaseline = "middle";
    context.fillStyle = `rgb(${red} ${green} ${blue})`;
    context.fillText(marker.text, 0, canvas.height / 2, canvas.width);
  }
  const material = own(new SpriteMaterial({ map: own(new CanvasTexture(canvas)), opacity: marker.colour[3], transparent: true }));
  const sprite = new Sprite(material);
  const heightM = Math.max(Math.abs(marker.scale[2]), MIN_SIZE_M);
  sprite.scale.set((heightM * canvas.width) / canvas.height, heightM, 1);
  return group(sprite);
}
