/** What the worker makes of a message for the page. To add a product, write its module and add a line here twice. */

import type { Message } from "../formats/recording";
import type { Value } from "../decoding/decoder";
import { annotationsOf, type Annotations } from "../pictures/annotations";
import { drawnPicture, type DrawnPicture } from "./drawn_picture";
import { sceneBuffers, sceneMessage, type SceneMessage } from "../geometry/scene_message";
import { fieldTypes, type FieldTypes } from "./field_types";
import { locationOf, pointOf, type Location } from "./location";
import { transformsOf, type Transform } from "../geometry/transforms";
import { plainValue, type PlainValue } from "./plain_value";
import { statesOf, type States } from "./states";
import { messageTree, type MessageTree } from "./tree";

/** Products by name. `time` is for those who need to know only when a message comes. */
export interface Products {
  /** What is drawn over a picture. */
  annotations: Annotations;
  /** Of the definition: the same for all messages of a topic. */
  fieldTypes: FieldTypes | null;
  location: Location;
  /** A location without its shapes. */
  position: Location;
  picture: DrawnPicture;
  plain: PlainValue;
  /** What is shown in space. */
  scene: SceneMessage;
  states: States;
  time: null;
  transforms: readonly Transform[];
  tree: MessageTree;
}

export type ProductName = keyof Products;

/** Makes a product. @throws ReadFailure where the message is no such thing; what `decode` throws. */
export type Make<P extends ProductName> = (message: Message, decode: () => Value) => Products[P] | Promise<Products[P]>;

export const makers: { readonly [P in ProductName]: Make<P> } = {
  annotations: ({ channel }, decode) => annotationsOf(channel.schema.name, decode()),
  fieldTypes: ({ channel }) => fieldTypes(channel.schema),
  location: (_, decode) => locationOf(decode()),
  position: (_, decode) => ({ position: pointOf(decode()), shapes: [] }),
  picture: (_, decode) => drawnPicture(decode()),
  plain: (_, decode) => plainValue(decode()),
  scene: ({ channel }, decode) => sceneMessage(channel.schema.name, decode()),
  states: (_, decode) => statesOf(decode()),
  time: () => null,
  transforms: (_, decode) => transformsOf(decode()),
  tree: messageTree,
};

/** Which message of a topic; see `MessageSearch.find`. */
export type Which = "valid" | "next" | "previous" | "nearest";

export interface MessageRequest<P extends ProductName = ProductName> {
  topic: string;
  which: Which;
  atNs: bigint;
  product: P;
  /** The message that the page has already: its product is not made again. */
  shownNs: bigint | null;
  /** About as many bytes are read at most. */
  maxBytes: number;
}

export interface MessagesRequest<P extends ProductName = ProductName> {
  topic: string;
  product: P;
  /** Inclusive at both ends. */
  fromNs: bigint;
  toNs: bigint;
  maxMessages: number;
  maxBytes: number;
}

export interface ReadMessage<P extends ProductName = ProductName> {
  logTimeNs: bigint;
  publishTimeNs: bigint;
  sequence: number;
  sizeBytes: number;
  /** Null where the page has it already. */
  product: Products[P] | null;
}

/** Return what of a product is moved to the page instead of copied. */
export function transferables(product: Products[ProductName]): Transferable[] {
  if (product === null || typeof product !== "object") return [];
  if (isPicture(product)) return ["values" in product.image ? product.image.values.buffer : product.image];
  return isSceneMessage(product) ? sceneBuffers(product) : [];
}

/** A plain value can have a field of that name, but nothing like that in it. */
function isPicture(product: object): product is DrawnPicture {
  if (!("image" in product)) return false;
  const { image } = product;
  return typeof image === "object" && image !== null && (("values" in image && image.values instanceof Float32Array) || image instanceof ImageBitmap);
}

function isSceneMessage(product: object): product is SceneMessage {
  return "content" in product && "stampSeconds" in product;
}
