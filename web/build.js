// Makes src/three.js, the one generated file: what the page uses of three.js, in one module. All else in src/ is served as
// it is. `--check` makes it anew and fails where the committed file is another.
import { readFile, writeFile } from "node:fs/promises";
import { build } from "esbuild";

const TARGET = new URL("src/three.js", import.meta.url);

async function bundled() {
  const { outputFiles } = await build({
    entryPoints: [new URL("three-entry.js", import.meta.url).pathname],
    bundle: true,
    format: "esm",
    legalComments: "inline",
    minify: true,
    target: "es2022",
    write: false,
  });
  return Buffer.from(outputFiles[0].contents);
}

const made = await bundled();
if (!process.argv.includes("--check")) {
  await writeFile(TARGET, made);
} else if (!made.equals(await readFile(TARGET))) {
  console.error("web/src/three.js is not what build.js makes of the lock file: run `npm run build` in web/");
  process.exit(1);
}
