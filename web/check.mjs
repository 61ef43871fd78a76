// node web/check.mjs MODULE.wasm FILE.json...: whether the recorded runs in the files come out with the same bits.
import { readFileSync } from "node:fs";
import { looped, replayed } from "./replay.js";
import { Module } from "./truestroke.js";

const [wasm, ...files] = process.argv.slice(2);
const module = await Module.load(readFileSync(wasm));
for (const file of files) {
  const content = JSON.parse(readFileSync(file, "utf8"));
  const { same, ticks } = content.recorded ? replayed(module, content) : looped(module, content);
  const good = ticks > 0 && same === ticks;
  console.log(`${good ? "passed" : "FAILED"}: ${same} of ${ticks} ticks have the same bits`);
  if (!good) process.exitCode = 1;
}
