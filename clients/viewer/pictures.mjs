/**
 * Takes the pictures of docs/pictures/viewer with the page itself, in Chromium, against a server that runs:
 *
 *     node pictures.mjs http://127.0.0.1:8000 [name ...]
 *
 * The camera is that of a shared link. Without a graphics card a picture takes a minute or two.
 */

import { mkdtemp, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

import { CHROMIUM, chromium } from "../../tests/chromium.mjs";

const FOLDER = fileURLToPath(new URL("../../docs/pictures/viewer/", import.meta.url));
const [WIDTH, HEIGHT] = [1280, 720];
const QUALITY = 0.86;
const WAIT_MS = 280_000;
/** Frames after the last chunk: each draws one of the maps of light, and the haze settles. */
const FRAMES = 5;

/** What is shown: the page's link, and the view if it is not daylight. */
const PICTURES = {
  orbit: { link: "recipe=continents&seed=42&at=-16150,6360,12720&look=16.15,-6.36,-12.72" },
  coast: { link: "recipe=continents&seed=42&at=2449,-4253,9009&look=0.148,-0.781,-0.606" },
  islands: { link: "recipe=islands&seed=42&at=0,60,-260&look=0.4,-0.12,0.9" },
  cave: { link: "recipe=terrain&seed=42&at=144.3,6.5,-248.4&look=-0.741,-0.334,-0.59" },
  city: { link: "recipe=city&seed=42&at=100,95,260&look=-0.35,-0.22,-0.9" },
  levels: { link: "recipe=terrain&seed=42&at=144.3,30,-248.4&look=-0.741,-0.334,-0.59", view: "levels" },
};

async function take(server, name, { link, view }) {
  const profile = await mkdtemp(join(tmpdir(), "pictures-"));
  const context = await chromium.launchPersistentContext(profile, {
    ...CHROMIUM,
    viewport: { width: WIDTH, height: HEIGHT },
    bypassCSP: true,
  });
  try {
    const page = await context.newPage();
    page.setDefaultTimeout(WAIT_MS);
    await page.goto(`${server}/?quality=high#${link}`);
    await page.addStyleTag({ content: "body > :not(#view) { display: none !important }" });
    // while chunks come in, plain frames are enough
    await page.waitForFunction(() => window.chunkserver?.counters.chunks + window.chunkserver?.counters.pending > 0);
    await page.evaluate(() => window.chunkserver.setView("levels"));
    await page.waitForFunction(() => window.chunkserver.counters.isSettled);
    await page.evaluate((wanted) => window.chunkserver.setView(wanted), view ?? "shaded");
    await frames(page, FRAMES);
    // a page at rest draws nothing
    await page.evaluate(() => window.dispatchEvent(new Event("resize")));
    const picture = await page.evaluate(drawn, QUALITY);
    await writeFile(join(FOLDER, `${name}.jpg`), Buffer.from(picture.split(",")[1], "base64"));
    const { chunks, triangles, levels } = await page.evaluate(() => window.chunkserver.counters);
    console.log(`${name}: ${chunks} chunks, ${triangles} triangles, levels ${levels.join(" ")}`);
  } finally {
    await context.close();
    await rm(profile, { recursive: true, force: true });
  }
}

async function frames(page, count) {
  const until = (await page.evaluate(() => window.chunkserver.counters.frames)) + count;
  await page.waitForFunction((least) => window.chunkserver.counters.frames >= least, until);
}

/** In the page: what the next frame draws, read before it is shown and gone. */
function drawn(quality) {
  return new Promise((resolve) => {
    requestAnimationFrame(() => resolve(document.getElementById("view").toDataURL("image/jpeg", quality)));
  });
}

const [server, ...names] = process.argv.slice(2);
if (server === undefined || names.some((name) => !(name in PICTURES))) {
  console.error(`node pictures.mjs SERVER [${Object.keys(PICTURES).join(" | ")}] ...`);
  process.exit(2);
}
for (const name of names.length > 0 ? names : Object.keys(PICTURES)) {
  await take(server, name, PICTURES[name]);
}
