/**
 * A Chromium that opens the viewer: takes the names of scenes as lines of JSON, answers each with one.
 *
 *     {"scene": "levels", "url": "http://127.0.0.1:8000"}  ->  {"found": {...}} or {"error": "..."}
 *
 * context: options of the browser's context, `{"hasTouch": true}`. keeps: the scene's pages stay open, for the next one
 * that continues. All else is for the scene.
 */

import { createInterface } from "node:readline";

import { CHROMIUM, chromium } from "../chromium.mjs";
import { VIEW, complaints } from "./page.mjs";
import { SCENES } from "./scenes/index.mjs";

let browser;
let context = null;

async function answer({ scene, context: options, keeps, continues, ...given }) {
  try {
    if (!continues) {
      await close();
    }
    browser ??= await chromium.launch(CHROMIUM);
    context ??= await browser.newContext({ ...VIEW, ...options });
    const found = await SCENES[scene](given, context);
    const wrong = complaints.splice(0);
    return wrong.length ? { error: wrong.join("\n") } : { found };
  } catch (error) {
    return { error: [error.stack, ...(await states()), ...complaints.splice(0)].join("\n") };
  } finally {
    if (!keeps) {
      await close();
    }
  }
}

async function close() {
  await context?.close();
  context = null;
}

/** What the pages say of themselves. */
async function states() {
  const state = () =>
    JSON.stringify([globalThis.chunkserver?.counters, location.href, document.querySelector("#notice")?.textContent]);
  return Promise.all((context?.pages() ?? []).map((page) => page.evaluate(state).catch(String)));
}

for await (const line of createInterface({ input: process.stdin })) {
  process.stdout.write(`${JSON.stringify(await answer(JSON.parse(line)))}\n`);
}
await browser?.close();
