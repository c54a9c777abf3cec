// Texts of the 3D panel.
import { counted, formatCount } from "@/components/format";
import type { MissingTransform } from "@/recordings/geometry/transform_buffer";
import type { PointSet } from "@/recordings/geometry/points";

const missing: Readonly<Record<MissingTransform["reason"], (frame: string, fixed: string) => string>> = {
  frame_unknown: (frame) => `There is no transform of the frame ${frame} near this time.`,
  not_connected: (frame, fixed) => `No transforms connect the frame ${frame} with ${fixed}.`,
  loop: (frame) => `The transforms above the frame ${frame} form a loop.`,
};

export const texts = {
  noWebGl: "This browser does not support WebGL 2 in workers, which 3D panels need.",
  sceneEnded: "This 3D panel stopped. Reload the page to see it again.",
  keys: "Drag to turn, drag with the right button to move. Click, then use the wheel to zoom. Shift+arrow keys turn.",
  fit: "Show everything",
  fromTop: "View from above",
  closer: "Zoom in",
  further: "Zoom out",
  settings: "Topics and settings",
  label: (topics: string, items: string) => `3D view of ${topics}: ${items}`,
  drawnPoints: (count: number) => counted(count, "point"),
  drawnItems: (count: number) => counted(count, "object"),
  nothing: "nothing",
  roughCloud: (time: string) => `Thinned cloud of the preview, at ${time}`,
  inFrame: (frame: string) => (frame === "" ? "" : `Frame ${frame}`),

  colourOf: (topic: string) => `Colour of ${topic}`,
  firstField: "First field",
  oneColour: "One colour",
  range: (least: string, greatest: string) => `${least} to ${greatest}`,
  points: ({ positions, totalPoints, invalidPoints, missingPoints }: PointSet) => {
    const drawn = positions.length / 3;
    return drawn + invalidPoints + missingPoints < totalPoints ? `${formatCount(drawn)} of ${counted(totalPoints, "point")} drawn` : counted(drawn, "point");
  },
  invalid: (count: string) => `${count} without a finite position`,
  missingPoints: (count: string) => `The message is cut off: ${count} missing`,
  poses: (count: number, isPath: boolean, invalid: number) => `${isPath ? "Path of " : ""}${counted(count, "pose")}${invalid > 0 ? `, ${invalid} not usable` : ""}`,
  cells: (total: number, drawn: number) => (drawn < total ? `${formatCount(drawn)} of ${counted(total, "cell")} drawn` : counted(total, "cell")),
  markers: (count: number, meshes: number) => `${counted(count, "marker")}${meshes > 0 ? `, ${meshes === 1 ? "1 mesh shown as a box" : `${meshes} meshes shown as boxes`}` : ""}`,

  fixedFrame: "Fixed frame",
  automatic: (frame: string) => (frame === "" ? "Automatic" : `Automatic (${frame})`),
  follow: "Camera follows",
  followNone: "Nothing",
  pointSize: "Point size",
  pixels: (count: number) => `${count} px`,
  colourMap: "Colour map",
  colourMaps: { turbo: "Turbo", viridis: "Viridis", grey: "Grey" },
  decay: "Show messages of",
  decayOf: (seconds: number) => (seconds === 0 ? "The latest only" : `The last ${seconds} s`),
  showFrames: "Axes of frames",

  missing: ({ reason, frame }: MissingTransform, fixed: string) => missing[reason](frame, fixed),
  extrapolated: "Some transforms have no values on both sides of this time. The nearest ones are used.",
} as const;
