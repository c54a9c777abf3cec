/** Compression of chunks with libzstd, compiled to WebAssembly: the same bytes as python-zstandard of the same version. */

import { Zstd } from "@hpcc-js/wasm-zstd";
import type { Compression } from "./mcap_writer";

/** The level of `McapOptions` in recordings/writing/mcap.py. */
const LEVEL = 3;

export async function zstdCompression(): Promise<Compression> {
  const zstd = await Zstd.load();
  return { name: "zstd", compress: (raw) => zstd.compress(raw, LEVEL) };
}
