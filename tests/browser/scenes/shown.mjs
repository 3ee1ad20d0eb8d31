/** What is shown. */

import { GROUND, camera, counters, frames, opened, settled } from "../page.mjs";
import { watch } from "../watch.mjs";

/** From the ground, in all views; and what is asked for when all is shown. */
export async function levels({ url }, context) {
  const page = await opened(context, url);
  let asked = 0;
  context.on("request", (request) => (asked += /chunks/.test(request.url())));
  await frames(page, 20);
  const views = {};
  for (const view of ["wireframe", "levels", "normals", "shaded"]) {
    await page.evaluate((name) => chunkserver.setView(name), view);
    views[view] = (await page.screenshot()).toString("base64");
  }
  return { ...(await counters(page)), asked, title: await page.title(), views };
}

/** Straight down on a planet that fills the picture, from several places: pictures without anything in front. */
export async function seams({ url }, context) {
  const page = await opened(context, url, GROUND.replace("normals", "levels"));
  await page.evaluate(() =>
    document.querySelectorAll("header, footer, #aim, #touch").forEach((each) => (each.hidden = true)),
  );
  const pictures = [];
  const levels = new Set();
  for (const [x, y, z] of [
    [0.2, 1, 0.1],
    [-0.5, 0.7, 0.4],
    [1, 0.1, 0.2],
    [-0.3, -0.8, 0.6],
    [0.6, 0.2, -0.9],
  ]) {
    const length = Math.hypot(x, y, z);
    const away = (distance) => [x, y, z].map((part) => (part / length) * distance);
    await page.evaluate(([at, ahead]) => chunkserver.setCamera(at, ahead), [away(238), away(-1)]);
    await settled(page);
    (await counters(page)).levels.forEach((count, lod) => count && levels.add(lod));
    pictures.push((await page.screenshot()).toString("base64"));
  }
  return { pictures, levels: [...levels] };
}

/** The panel of figures, what the page counts, what is in its scene, and what came over the network. */
export async function figures({ url }, context) {
  await context.addInitScript(watch);
  const [asked, finished] = [new Set(), []];
  context.on("request", (request) => /^http.*\/v1\//.test(request.url()) && asked.add(request));
  let broken = 0; // batches of which no more was wanted: nobody tells how much of them came
  context.on("requestfailed", (request) => (broken += asked.delete(request)));
  context.on("requestfinished", (request) => asked.has(request) && finished.push(request));
  const page = await opened(context, url);
  await page.keyboard.press("KeyP");
  const first = {
    rows: await rows(page),
    counters: await counters(page),
    scene: await page.evaluate("watched.totals()"),
  };
  while (asked.size > finished.length) {
    await frames(page, 1); // its last bytes have come, and nobody has told yet
  }
  const sizes = await Promise.all(finished.map((request) => request.sizes()));
  const brokenFirst = broken;
  const received = sizes.reduce((sum, { responseBodySize }) => sum + responseBodySize, 0);
  // elsewhere, and back to what has come before
  const { position, ahead } = await camera(page);
  await page.evaluate(([at, way]) => chunkserver.setCamera(at, way), [position.map((part) => -part), ahead]);
  await settled(page);
  const away = await rows(page);
  await page.evaluate(([at, way]) => chunkserver.setCamera(at, way), [position, ahead]);
  await settled(page);
  return { first, received, broken: brokenFirst, away, again: await rows(page) };
}

/** What the panel says when it has been told all, and goes on saying. */
async function rows(page) {
  const read = () =>
    page.evaluate(() =>
      Object.fromEntries(
        [...document.querySelectorAll("#figures dt")].map((term) => [term.textContent, term.nextSibling.textContent]),
      ),
    );
  for (let last = {}; ;) {
    await frames(page, 20);
    const now = await read();
    if (["Triangles", "Received", "Cache hits"].every((name) => now[name] !== undefined && now[name] === last[name])) {
      return now;
    }
    last = now;
  }
}
