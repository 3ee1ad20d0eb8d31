/** Builds the page into the Python package. The web client is bundled from its sources: it needs no build of its own. */

import { defineConfig } from "vite";

const here = (path: string) => decodeURIComponent(new URL(path, import.meta.url).pathname);

export default defineConfig({
  base: "./",
  resolve: {
    alias: [
      { find: /^chunkserver-client$/, replacement: here("../web/src/index.ts") },
      { find: /^chunkserver-client\/(three|worker)$/, replacement: here("../web/src/$1.ts") },
    ],
    dedupe: ["three", "fzstd"],
  },
  worker: { format: "es" },
  build: {
    target: "es2022",
    outDir: here("../../chunkserver/viewer"),
    emptyOutDir: true,
    assetsDir: "assets",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1024,
    reportCompressedSize: false,
  },
  server: { proxy: { "/v1": { target: "http://127.0.0.1:8000", ws: true }, "/readyz": "http://127.0.0.1:8000" } },
});
