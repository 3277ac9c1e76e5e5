// SPDX-License-Identifier: Apache-2.0
// cm.proto → src/proto/cm.js and cm.d.ts, and a copy of the former where tsc puts what it makes.
import { execFileSync } from "node:child_process";
import { copyFileSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const cli = dirname(createRequire(import.meta.url).resolve("protobufjs-cli/package.json"));
const made = join(here, "src", "proto");
const dist = join(here, "dist", "src", "proto");
const source = join(here, "..", "..", "cm", "wire", "cm.proto");
const run = (tool, ...words) => execFileSync(process.execPath, [join(cli, "bin", tool), ...words], { stdio: "inherit" });

mkdirSync(made, { recursive: true });
mkdirSync(dist, { recursive: true });
run("pbjs", "-t", "static-module", "-w", "es6", "--es6", "--no-verify", "--no-delimited", "--no-convert",
  "--force-long", "-o", join(made, "cm.js"), source);
// protobufjs is a CommonJS package: Node's modules import it whole, and by its file's name
const script = join(made, "cm.js");
writeFileSync(script, readFileSync(script, "utf8").replace(
  'import * as $protobuf from "protobufjs/minimal"', 'import $protobuf from "protobufjs/minimal.js"'));
run("pbts", "-o", join(made, "cm.d.ts"), join(made, "cm.js"));
for (const name of ["cm.js", "cm.d.ts"]) copyFileSync(join(made, name), join(dist, name));
