/**
 * A Chromium that opens the viewer and flies: node flight.mjs URL FOLDER SECONDS
 *
 * Prints one line of JSON: what was seen on the way. Traces, as the browser writes them, lie in FOLDER: `start.json` is
 * of the page from its first byte to its full first view, `flight.json` of SECONDS of flight. In both, whatever
 * three.js draws is between the marks `render` and `rendered`.
 */

import { writeFile } from "node:fs/promises";
import { join } from "node:path";

import { CHROMIUM, chromium } from "../tests/chromium.mjs";

const WAIT_MS = 120_000;
const VIEW = { width: 1280, height: 720 };
/** Of the canvas for one of the page: levels are chosen for the whole height, and there may be no graphics card. */
const PIXELS = 0.25;
const CATEGORIES = [
  "-*",
  "devtools.timeline",
  "disabled-by-default-devtools.timeline",
  "toplevel",
  "blink.user_timing",
];
/** Level, over hills and caves, in the view that is the cheapest to draw. */
const FLIGHT = "#recipe=terrain&seed=42&at=240,60,-100&look=-0.6,0,-0.8&view=normals";
/** Straight on. */
const KEYS = ["KeyW"];

/** In the page: nothing is drawn any more, as if a graphics card did it. Frames come as often as the screen wants them. */
function drawNothing() {
  for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
    WebGL2RenderingContext.prototype[name] = () => {};
  }
}

/** In the page, before all else: marks what is drawn, and keeps when there is a picture, and when all of it. */
function watch() {
  const seen = { first: null, full: null };
  let scripting;
  Object.defineProperty(window, "chunkserver", {
    get: () => scripting,
    set(given) {
      scripting = given;
      const { renderer } = given;
      const render = renderer.render;
      renderer.render = (...scene) => {
        performance.mark("render");
        render.apply(renderer, scene);
        performance.mark("rendered");
        performance.clearMarks();
      };
      const watching = setInterval(() => {
        const { triangles, isSettled } = given.counters;
        seen.first ??= triangles > 0 ? performance.now() : null;
        if (isSettled) {
          seen.full = performance.now();
          clearInterval(watching);
        }
      }, 10);
    },
  });
  window.seen = seen;
}

const [url, folder, seconds] = process.argv.slice(2);
const browser = await chromium.launch(CHROMIUM);

async function opened() {
  const context = await browser.newContext({ viewport: VIEW, deviceScaleFactor: PIXELS });
  const page = await context.newPage();
  page.setDefaultTimeout(WAIT_MS);
  await page.addInitScript(watch);
  return page;
}

const counters = (page) => page.evaluate(() => chunkserver.counters);
const full = (page) => page.waitForFunction(() => seen.full !== null, undefined, { polling: 100 });

async function traced(page, name, action) {
  await browser.startTracing(page, { categories: CATEGORIES });
  try {
    await action();
  } finally {
    await writeFile(join(folder, name), await browser.stopTracing());
  }
}

/** The page as it is opened without a link. */
async function firstView() {
  const page = await opened();
  await traced(page, "start.json", async () => {
    await page.goto(url);
    await full(page);
  });
  const seen = await page.evaluate(() => window.seen);
  const { frames } = await counters(page);
  await page.waitForFunction((since) => chunkserver.counters.frames > since + 5, frames); // figures are asked for now and then
  const { chunks, bytes, requests } = await counters(page);
  await page.context().close();
  return { first: seen.first / 1e3, full: seen.full / 1e3, chunks, bytes, requests };
}

async function flight() {
  const page = await opened();
  await page.goto(`${url}/${FLIGHT}`);
  await full(page);
  await page.evaluate(drawNothing);
  await page.focus("#view");
  const [before, from] = [await counters(page), await page.evaluate(() => chunkserver.camera.position)];
  await traced(page, "flight.json", async () => {
    for (const key of KEYS) {
      await page.keyboard.down(key);
    }
    await new Promise((resolve) => setTimeout(resolve, seconds * 1e3));
  });
  const [after, to] = [await counters(page), await page.evaluate(() => chunkserver.camera.position)];
  await page.context().close();
  return {
    chunks: after.received - before.received,
    voxels: Math.hypot(...to.map((place, axis) => place - from[axis])),
  };
}

try {
  process.stdout.write(`${JSON.stringify({ start: await firstView(), flight: await flight() })}\n`);
} finally {
  await browser.close();
}
