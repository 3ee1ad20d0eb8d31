/** What scenes are made of: a page that shows a world, and conditions to wait for. Never a time. */

export const WAIT_MS = 100_000;
/** Half a pixel of the canvas for one of the page: there is no graphics card, and little time. */
export const VIEW = { viewport: { width: 480, height: 320 }, deviceScaleFactor: 0.5 };
export const MIDDLE = [240, 160];
/** On the ground of the planet of seed 42. Normals are the cheapest to draw. */
export const GROUND = "#recipe=planet&seed=42&at=0,226,30&look=0.6,-0.35,-0.7&view=normals";

/** What no page may say: exceptions that nobody has caught, and what its policy has refused. */
export const complaints = [];

/** A page that has been sent for, and may show nothing yet. */
export async function sentFor(context, url, hash = GROUND) {
  const page = await context.newPage();
  page.setDefaultTimeout(WAIT_MS);
  page.on("pageerror", (error) => complaints.push(String(error.stack)));
  page.on("console", (message) => /Content Security Policy/.test(message.text()) && complaints.push(message.text()));
  await page.goto(`${url}/${hash}`);
  return page;
}

/** A page that shows all that it wants to. */
export async function opened(context, url, hash = GROUND) {
  const page = await sentFor(context, url, hash);
  await settled(page);
  return page;
}

/** Polled with a timer: a page's frames are watched by others. */
export const until = (page, condition, argument) =>
  page.waitForFunction(condition, argument, { timeout: WAIT_MS, polling: 50 });
export const settled = (page) => until(page, () => globalThis.chunkserver?.counters.isSettled);
export const counters = (page) => page.evaluate(() => chunkserver.counters);
export const camera = (page) => page.evaluate(() => chunkserver.camera);
export const revised = (page, revision) =>
  until(page, (least) => BigInt(chunkserver.counters.revision) >= BigInt(least), String(revision));
export const revisionOf = async (page) => BigInt((await counters(page)).revision);

/** So many frames later. */
export async function frames(page, count) {
  const { frames: now } = await counters(page);
  await until(page, (least) => chunkserver.counters.frames >= least, now + count);
}

/** How far the ground is along the crosshair, in voxels. */
export const sight = (page) =>
  page.evaluate(() => {
    const [aim, { position }] = [chunkserver.aim(), chunkserver.camera];
    return aim === null ? Infinity : Math.hypot(...aim.map((place, axis) => place - position[axis]));
  });

/** What a notice says. */
export async function noticed(page) {
  await page.waitForSelector("#notice", { state: "visible" });
  return page.textContent("#notice");
}

export const minus = (one, other) => one.map((place, axis) => place - other[axis]);
export const dot = (one, other) => one.reduce((sum, part, axis) => sum + part * other[axis], 0);
export const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];
export const unit = (way) => way.map((part) => part / Math.hypot(...way));

/** Of a camera above the middle of a planet: how far another one is ahead of it, to its right and above it. */
export function seenFrom({ position, ahead }, other) {
  const up = unit(position);
  const right = unit(cross(ahead, up));
  const onwards = cross(up, right);
  const [moved, turned] = [minus(other.position, position), minus(other.ahead, ahead)];
  const parts = (way) => ({ onwards: dot(way, onwards), right: dot(way, right), up: dot(way, up) });
  return { moved: parts(moved), turned: parts(turned) };
}

/** Conditions: the viewer has moved, or turned, further than that from there. */
export const moved = ([from, least]) =>
  Math.hypot(...chunkserver.camera.position.map((at, axis) => at - from[axis])) > least;
export const turned = ([from, least]) =>
  Math.hypot(...chunkserver.camera.ahead.map((at, axis) => at - from[axis])) > least;

/** Holds a key down until something has come of it. */
export async function held(page, key, condition, argument) {
  await page.keyboard.down(key);
  await until(page, condition, argument);
  await page.keyboard.up(key);
}

/** Nobody moves any more: not for several frames. Whoever goes on never comes to this. */
export async function still(page) {
  await page.evaluate(() => (globalThis.lastMoved = { position: [Infinity, 0, 0], frames: 0 }));
  await until(page, () => {
    const { camera, counters } = chunkserver;
    const by = Math.hypot(...camera.position.map((at, axis) => at - lastMoved.position[axis]));
    if (!(by < 0.01)) {
      lastMoved = { position: camera.position, frames: counters.frames };
    }
    return counters.frames >= lastMoved.frames + 6;
  });
}
