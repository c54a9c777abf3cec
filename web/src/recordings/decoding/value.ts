/** What a decoded message is made of. Times are seconds; 64-bit integers are rounded to what a double holds. */

export type Numbers =
  | Uint8Array
  | Int8Array
  | Uint16Array
  | Int16Array
  | Uint32Array
  | Int32Array
  | Float32Array
  | Float64Array;

export type Value = number | boolean | string | null | Numbers | Value[] | { [name: string]: Value };

/** Turns the bytes of a message into its value.
 *
 * @throws ReadFailure message_damaged where they do not fit the definition.
 */
export type Decode = (data: Uint8Array) => Value;

export function isNumbers(value: Value | undefined): value is Numbers {
  return ArrayBuffer.isView(value);
}

export function isFields(value: Value | undefined): value is { [name: string]: Value } {
  return typeof value === "object" && value !== null && !Array.isArray(value) && !isNumbers(value);
}
