// A scene of three.js, in a worker: draws placed items, only when something has changed, and frees what is no longer shown.
import {
  AmbientLight, Box3, Color, ColorManagement, DirectionalLight, GridHelper, LinearSRGBColorSpace, Matrix4, PerspectiveCamera, Quaternion, Scene, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { markerObject } from "./marker_objects";
import { gridObject, pointObject, poseObject, type PointStyle, type SceneObject } from "./objects";
import type { PlacedItem } from "./placement";
import type { PointerTarget } from "./pointer_events";
import { followedBy, IDENTITY, type Pose, type Vector } from "@/recordings/geometry/poses";

export interface SceneColours {
  readonly background: string;
  readonly grid: string;
  readonly plain: number;
}

export type Item = PlacedItem["item"];

/** Where an item is, and how it is coloured. */
export interface ItemPlace extends Omit<PlacedItem, "item"> {
  readonly id: number;
}

export type SceneStyle = Omit<PointStyle, "colourBy" | "plain">;

interface Drawn {
  readonly made: SceneObject;
  /** Position, orientation and colour, as they were drawn last. */
  placedAs: readonly number[];
  styledAs: string;
}

/** Colours are drawn as they are stored. */
ColorManagement.enabled = false;
const AXES_M = 0.5;
const NEAR_M = 0.05;
const FAR_M = 20_000;
/** Coordinates further away are drawn relative to what is shown first, since the GPU has 32 bits. */
const LARGE_M = 4_000;
const MAX_FIT_M = 80;
const FIRST_DIRECTION = new Vector3(-0.7, -0.7, 0.55);
const TOP_DIRECTION = new Vector3(-0.001, 0, 1);
const GRID_CELLS = 20;
const UNIT_SCALE = new Vector3(1, 1, 1);

export class SceneView {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(50, 1, NEAR_M, FAR_M);
  private readonly controls: OrbitControls;
  private readonly drawn = new Map<number, Drawn>();
  private readonly removed: (() => void)[] = [];
  private grid: GridHelper | null = null;
  private gridCellM = 0;
  private frames: Drawn | null = null;
  private origin: Vector | null = null;
  private followed: Vector3 | null = null;
  private colours: SceneColours;
  private pending = 0;
  private isFitted = false;
  private isReported = true;

  /**
   * `onUpdated` gets how many points are drawn, once an update is.
   * @throws Error where the browser has no WebGL 2.
   */
  constructor(canvas: OffscreenCanvas, pointer: PointerTarget, colours: SceneColours, private readonly onUpdated: (points: number) => void) {
    this.renderer = new WebGLRenderer({ canvas, antialias: !isDrawnInSoftware() });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.colours = colours;
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, pointer as unknown as HTMLElement);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => this.requestRender());
    const sun = new DirectionalLight(0xffffff, 1.6);
    sun.position.set(-3, -5, 10);
    this.scene.add(new AmbientLight(0xffffff, 1.6), sun);
    this.setColours(colours);
    this.aim(FIRST_DIRECTION, new Vector3(), 12);
  }

  setColours(colours: SceneColours): void {
    this.colours = colours;
    this.scene.background = new Color(colours.background);
    this.gridCellM = 0;
    this.requestRender();
  }

  resize(width: number, height: number, pixelRatio: number): void {
    this.renderer.setPixelRatio(pixelRatio);
    this.renderer.setSize(Math.max(1, width), Math.max(1, height), false);
    this.camera.aspect = Math.max(1, width) / Math.max(1, height);
    this.camera.updateProjectionMatrix();
    this.requestRender();
  }

  /** Shows these items and no others. `added` are those among them that the last update did not have. */
  update(places: readonly ItemPlace[], added: ReadonlyMap<number, Item>, style: SceneStyle): void {
    const visible = new Set(places.map(({ id }) => id));
    for (const [id, { made }] of this.drawn) {
      if (visible.has(id)) continue;
      this.remove(made);
      this.drawn.delete(id);
    }
    for (const [id, item] of added) this.add(id, item);
    for (const { id, pose, colourBy } of places) {
      const known = this.drawn.get(id);
      if (known === undefined) continue;
      this.origin ??= originFor(positionOf(known.made, pose).position);
      this.place(known, pose, `${colourBy} ${style.colourMap} ${style.sizePx}`);
      known.made.style({ ...style, colourBy, plain: this.colours.plain });
    }
    if (!this.isFitted && places.length > 0) this.fit();
    this.isReported = false;
    if (this.pending === 0) this.report();
  }

  /** Shows the axes of frames. */
  showFrames(poses: readonly Pose[]): void {
    if (this.frames !== null) this.remove(this.frames.made);
    this.frames = null;
    if (poses.length === 0) return;
    this.frames = { made: poseObject({ poses, isPath: false, invalidPoses: 0 }, AXES_M), placedAs: [], styledAs: "" };
    this.scene.add(this.frames.made.object);
    this.place(this.frames, IDENTITY, "");
  }

  /** Moves the camera with a point of the fixed frame; null ends it. */
  follow(position: Vector | null): void {
    const target = position === null ? null : new Vector3(...relative(position, this.origin));
    if (target !== null) {
      const step = target.clone().sub(this.followed ?? this.controls.target);
      if (step.lengthSq() > 0) {
        this.camera.position.add(step);
        this.controls.target.add(step);
        this.controls.update();
        this.requestRender();
      }
    }
    this.followed = target;
  }

  /** Forgets where the camera and the items are, for another fixed frame. */
  reset(): void {
    for (const { made } of this.drawn.values()) this.remove(made);
    this.drawn.clear();
    [this.origin, this.followed, this.isFitted] = [null, null, false];
  }

  fit(isFromTop = false): void {
    const bounds = new Box3();
    for (const { made } of this.drawn.values()) bounds.expandByObject(made.object);
    const centre = bounds.isEmpty() ? new Vector3() : bounds.getCenter(new Vector3());
    const radius = bounds.isEmpty() ? 5 : bounds.getSize(new Vector3()).length() / 2;
    this.isFitted = true;
    this.aim(isFromTop ? TOP_DIRECTION : FIRST_DIRECTION, centre, 1.7 * Math.min(MAX_FIT_M, Math.max(1, radius)));
  }

  zoom(factor: number): void {
    const { target } = this.controls;
    this.camera.position.sub(target).multiplyScalar(factor).add(target);
    this.controls.update();
    this.requestRender();
  }

  /** Turns the camera around its target, in radians. */
  turn(azimuth: number, elevation: number): void {
    const { target } = this.controls;
    const arm = this.camera.position.clone().sub(target);
    const sideways = new Vector3().crossVectors(this.camera.up, arm).normalize();
    const raised = arm.clone().applyAxisAngle(sideways, -elevation);
    const isSteep = raised.angleTo(this.camera.up) < 0.02 || raised.angleTo(this.camera.up) > Math.PI - 0.02;
    this.camera.position.copy(isSteep ? arm : raised).applyAxisAngle(this.camera.up, azimuth).add(target);
    this.controls.update();
    this.requestRender();
  }

  dispose(): void {
    this.reset();
    this.showFrames([]);
    cancelAnimationFrame(this.pending);
    this.freeRemoved();
    this.grid?.dispose();
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss(); // a page has a bounded number of contexts
  }

  private add(id: number, item: Item): void {
    const drawn = { made: objectOf(item), placedAs: [], styledAs: "" };
    drawn.made.object.matrixAutoUpdate = false;
    this.drawn.set(id, drawn);
    this.scene.add(drawn.made.object);
  }

  private report(): void {
    if (this.isReported) return;
    this.isReported = true;
    this.onUpdated([...this.drawn.values()].reduce((sum, { made }) => sum + made.points, 0));
  }

  /** Frees an object once what replaces it is drawn: shaders that nothing uses in between would be compiled again. */
  private remove({ object, dispose }: SceneObject): void {
    this.scene.remove(object);
    this.removed.push(dispose);
    this.requestRender();
  }

  private freeRemoved(): void {
    for (const dispose of this.removed.splice(0)) dispose();
  }

  private place(drawn: Drawn, pose: Pose, styledAs: string): void {
    const { object } = drawn.made;
    const { position, orientation } = positionOf(drawn.made, pose);
    const placedAs = [...position, ...orientation, this.colours.plain];
    if (drawn.styledAs === styledAs && placedAs.every((value, place) => value === drawn.placedAs[place])) return;
    [drawn.placedAs, drawn.styledAs] = [placedAs, styledAs];
    object.matrixAutoUpdate = false;
    object.matrix.copy(new Matrix4().compose(new Vector3(...relative(position, this.origin)), new Quaternion(...orientation), UNIT_SCALE));
    object.matrixWorldNeedsUpdate = true;
    this.requestRender();
  }

  private aim(direction: Vector3, target: Vector3, distanceM: number): void {
    this.controls.target.copy(target);
    this.camera.position.copy(direction).normalize().multiplyScalar(distanceM).add(target);
    this.controls.update();
    this.requestRender();
  }

  private requestRender(): void {
    if (this.pending !== 0) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.placeGrid();
      this.renderer.render(this.scene, this.camera);
      this.freeRemoved();
      this.report();
    });
  }

  /** Draws the ground around the target, in cells of 1, 10 or 100 m and so on by the distance of the camera. */
  private placeGrid(): void {
    const { target } = this.controls;
    const cellM = 10 ** Math.round(Math.log10(Math.max(0.01, this.camera.position.distanceTo(target)) / 8));
    if (cellM !== this.gridCellM) {
      if (this.grid !== null) this.scene.remove(this.grid);
      this.grid?.dispose();
      this.gridCellM = cellM;
      this.grid = new GridHelper(GRID_CELLS * cellM, GRID_CELLS, this.colours.grid, this.colours.grid);
      this.grid.rotation.x = Math.PI / 2;
      this.scene.add(this.grid);
    }
    const [x, y, z] = relative([0, 0, 0], this.origin);
    const height = Math.abs(z) < LARGE_M ? z : 0;
    this.grid?.position.set(x + Math.round((target.x - x) / cellM) * cellM, y + Math.round((target.y - y) / cellM) * cellM, height);
  }
}

/** Whether the processor draws, as in virtual machines: smooth edges take it several times as long. */
function isDrawnInSoftware(): boolean {
  const context = new OffscreenCanvas(1, 1).getContext("webgl2");
  const names = context?.getExtension("WEBGL_debug_renderer_info");
  const renderer = names ? String(context?.getParameter(names.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(renderer);
}

function objectOf(item: Item): SceneObject {
  if ("shape" in item) return markerObject(item);
  if (item.kind === "points") return pointObject(item.points);
  return item.kind === "poses" ? poseObject(item.sequence, AXES_M) : gridObject(item.grid);
}

function positionOf({ offset }: SceneObject, pose: Pose): Pose {
  return followedBy(pose, { position: offset, orientation: IDENTITY.orientation });
}

function originFor(position: Vector): Vector {
  return Math.max(...position.map(Math.abs)) > LARGE_M ? position : [0, 0, 0];
}

function relative([x, y, z]: Vector, origin: Vector | null): Vector {
  const [ox, oy, oz] = origin ?? [0, 0, 0];
  return [x - ox, y - oy, z - oz];
}
