// Writes src/api/schema.d.ts from docs/openapi.json; with --check, says whether it is as it would be written.
import { readFile, writeFile } from "node:fs/promises";
import { argv, exit, stderr } from "node:process";
import { fileURLToPath } from "node:url";
import openapiTS, { astToString } from "openapi-typescript";

const DESCRIPTION = new URL("../../docs/openapi.json", import.meta.url);
const TYPES = fileURLToPath(new URL("../src/api/schema.d.ts", import.meta.url));
const HEAD = "// Written by `npm run generate` from docs/openapi.json. Do not edit.\n\n";

const wanted = HEAD + astToString(await openapiTS(DESCRIPTION, { alphabetize: true }));
if (!argv.includes("--check")) {
  await writeFile(TYPES, wanted);
} else if ((await readFile(TYPES, "utf8").catch(() => "")) !== wanted) {
  stderr.write("src/api/schema.d.ts is not what docs/openapi.json says: run `npm run generate` and commit it.\n");
  exit(1);
}
