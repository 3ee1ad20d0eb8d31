/** What is between two pictures: each frame is looked at. */

import { camera, dot, held, opened, revised, revisionOf, settled, turned, unit, until } from "../page.mjs";
import { watch } from "../watch.mjs";

/** Straight down on a planet that fills the picture. */
const ABOVE = "#recipe=planet&seed=42&at=0,222,0.1&look=0.001,-1,-0.02&view=levels";
/** Radians around the planet. */
const WAY = 0.5;

/** Flies around a planet, turns, and digs on the way: chunks come, change their level and change with edits. */
export async function flight({ url }, context) {
  await context.addInitScript(watch);
  const page = await opened(context, url, ABOVE);
  const start = await camera(page);
  const revision = await revisionOf(page);
  await page.focus("#view");
  await page.evaluate(() => watched.begin());
  await page.keyboard.down("KeyD");
  for (const part of [0.3, 0.6]) {
    await until(page, far, [start.position, WAY * part]);
    await page.evaluate(() => void chunkserver.dig(chunkserver.aim(), 12));
    await held(page, "ArrowLeft", turned, [(await camera(page)).ahead, 0.002]);
  }
  await until(page, far, [start.position, WAY]);
  await page.keyboard.up("KeyD");
  await revised(page, revision + 2n);
  await settled(page);
  const { frames, holes, swaps } = await page.evaluate(() => watched.end());
  const end = await camera(page);
  return { frames, holes, swaps: swaps.length, angle: Math.acos(dot(unit(start.position), unit(end.position))) };
}

/** Condition: around the middle of the planet, from there. */
const far = ([from, least]) => {
  const { position } = chunkserver.camera;
  const along = position.reduce((sum, at, axis) => sum + at * from[axis], 0);
  return Math.acos(along / Math.hypot(...position) / Math.hypot(...from)) > least;
};

/** From a standstill, one dig where chunks of several levels meet. */
export async function swap({ url }, context) {
  await context.addInitScript(watch);
  const page = await opened(context, url, ABOVE);
  const revision = await revisionOf(page);
  const places = await page.evaluate(() => {
    watched.begin();
    return chunkserver.camera.position;
  });
  await page.evaluate(([x, y, z]) => chunkserver.dig([x + 60, y - 40, z], 22), places);
  await revised(page, revision + 1n);
  await settled(page);
  const { frames, holes, swaps } = await page.evaluate(() => watched.end());
  const { world } = await page.evaluate(() => chunkserver.counters);
  const log = await (await context.request.get(`${url}/v1/worlds/${world}/edits?after=${revision}`)).json();
  return { frames, holes, swaps, stale: log.edits[0].stale };
}
