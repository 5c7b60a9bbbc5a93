// Bundle the page's program: dist/page.js, and MuJoCo's WebAssembly beside it.

import { copyFileSync } from "node:fs";
import { build } from "esbuild";

await build({
  entryPoints: ["src/main.js"],
  outfile: "dist/page.js",
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  external: ["module"], // MuJoCo's loader asks for it under Node alone
  legalComments: "inline",
  charset: "utf8",
});
copyFileSync("node_modules/@mujoco/mujoco/mujoco.wasm", "dist/mujoco.wasm");
