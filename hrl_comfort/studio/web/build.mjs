// Bundle the page's program: dist/page.js, and beside it MuJoCo's WebAssembly and the licences of both.

import { copyFileSync, readFileSync, writeFileSync } from "node:fs";
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
// MuJoCo's package brings none; these are of its Python package and of Emscripten.
const licenses = ["licenses/mujoco.txt", "node_modules/three/LICENSE"].map((file) => readFileSync(file, "utf8").trim());
writeFileSync("dist/licenses.txt", `${licenses.join(`\n\n${"-".repeat(80)}\n\nthree.js\n\n`)}\n`);
