// The fonts and their licences, at addresses without a hash: the app and the server's own pages share them.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import type { Plugin } from "vite";

const require = createRequire(import.meta.url);
const FAMILIES = ["inter", "jetbrains-mono"] as const;

function read(family: string, file: string): Buffer {
  const folder = dirname(require.resolve(`@fontsource-variable/${family}/package.json`));
  return readFileSync(join(folder, file));
}

function sources(): Map<string, () => Buffer> {
  const files = new Map<string, () => Buffer>();
  for (const family of FAMILIES) {
    files.set(`fonts/${family}.woff2`, () => read(family, `files/${family}-latin-wght-normal.woff2`));
    files.set(`fonts/${family}-licence.txt`, () => read(family, "LICENSE"));
  }
  return files;
}

/** Serves the fonts while developing, and puts them into what is built. */
export function fonts(): Plugin {
  const files = sources();
  return {
    name: "kleinkram-fonts",
    configureServer(server) {
      server.middlewares.use((request, response, next) => {
        const source = files.get((request.url ?? "").slice(1));
        if (source === undefined) next();
        else response.end(source());
      });
    },
    generateBundle() {
      for (const [fileName, source] of files) this.emitFile({ type: "asset", fileName, source: source() });
    },
  };
}
