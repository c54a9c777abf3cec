// Puts beside each built file what is sent in its place to a browser that takes it compressed; then puts the whole where
// the server serves it from, at once, so that a build that failed or is under way leaves what was there.
import { readdir, readFile, rename, rm, writeFile } from "node:fs/promises";
import { extname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";
import { brotliCompress, constants, gzip } from "node:zlib";

const MADE = fileURLToPath(new URL("../dist", import.meta.url));
const SERVED = fileURLToPath(new URL("../../src/kleinkram/server/web/built", import.meta.url));
const TEXTS = new Set([".css", ".html", ".js", ".svg", ".wasm"]);
const LEAST_BYTES = 1024;

/** @param {string} path */
async function compress(path) {
  const bytes = await readFile(path);
  if (bytes.length < LEAST_BYTES) return;
  const best = { params: { [constants.BROTLI_PARAM_QUALITY]: 11, [constants.BROTLI_PARAM_SIZE_HINT]: bytes.length } };
  await writeFile(`${path}.br`, await promisify(brotliCompress)(bytes, best));
  await writeFile(`${path}.gz`, await promisify(gzip)(bytes, { level: 9 }));
}

const entries = await readdir(MADE, { recursive: true, withFileTypes: true });
const files = entries.filter((entry) => entry.isFile() && TEXTS.has(extname(entry.name)));
await Promise.all(files.map((entry) => compress(join(entry.parentPath, entry.name))));
const old = `${MADE}-old`;
await rm(old, { recursive: true, force: true });
await rename(SERVED, old).catch((/** @type {NodeJS.ErrnoException} */ error) => {
  if (error.code !== "ENOENT") throw error;
});
await rename(MADE, SERVED);
await rm(old, { recursive: true, force: true });
