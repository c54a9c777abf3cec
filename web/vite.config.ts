import { fileURLToPath, URL } from "node:url";
import { quasar, transformAssetUrls } from "@quasar/vite-plugin";
import vue from "@vitejs/plugin-vue";
import { defineConfig } from "vitest/config";
import { fonts } from "./scripts/fonts.ts";

// Where `klein up` listens while one develops; see docs/developing-the-web.md.
const api = process.env.KLEINKRAM_API ?? "http://127.0.0.1:8000";
const OF_THE_SERVER = ["/api", "/sign-in", "/s/static", "/static", "/health", "/openapi.json"];
/** The page of share links, but not its viewer, which is part of the app. */
const SHARE_PAGE = "^/s($|[?])";

/** The name of a file that several pages share, which else consists of the names of all of them. */
const shortName = (name: string): string => name.replace(/~.*/, "");

export default defineConfig({
  plugins: [vue({ template: { transformAssetUrls } }), quasar({ sassVariables: false }), fonts()],
  resolve: { alias: { "@": fileURLToPath(new URL("./src", import.meta.url)) } },
  build: {
    target: "es2022",
    rolldownOptions: {
      checks: { bundlerTimings: false }, // how long a busy machine took is no warning
      // What pages share is in files of some size: a page that loads 30 small ones waits for the requests.
      output: {
        codeSplitting: { groups: [{ name: "shared", minShareCount: 2, entriesAware: true, entriesAwareMergeThreshold: 30_000 }] },
        chunkFileNames: ({ name }) => `assets/${shortName(name)}-[hash].js`,
        assetFileNames: ({ names: [name = "asset"] }) => `assets/${shortName(name.replace(/\.[^.]+$/, ""))}-[hash][extname]`,
      },
    },
    assetsInlineLimit: 0, // what is inlined as data: the content security policy refuses
    modulePreload: { polyfill: false },
    license: { fileName: "licences.md" },
    reportCompressedSize: false,
    chunkSizeWarningLimit: 800,
  },
  worker: { format: "es" },
  server: {
    host: "127.0.0.1", // where the cookie of the server beside it is good too
    port: 5173,
    strictPort: true,
    fs: { allow: [".."] },
    proxy: Object.fromEntries(
      [SHARE_PAGE, ...OF_THE_SERVER.map((path) => `^${path}($|[/?])`)].map((path) => [path, { target: api, changeOrigin: true, headers: { origin: api } }]),
    ),
  },
  // Files share the modules they import: a third of the CPU time. None may leave state in a module.
  test: { environment: "happy-dom", include: ["src/**/*.test.ts"], restoreMocks: true, isolate: false, testTimeout: 30_000 },
});
