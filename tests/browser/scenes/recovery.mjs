/** What goes wrong between the page and the server, and how the page goes on without a reload. */

import { counters, noticed, opened, revised, sentFor, settled, until } from "../page.mjs";

const PLANE = "#recipe=plane&seed=1&at=0,20,0&look=0.6,-0.35,-0.7&view=levels";
const PROBLEM = { status: 422, contentType: "application/problem+json" };
const EDITS = /\/edits$/;

const hidden = (page) => page.waitForSelector("#notice", { state: "hidden" });
const digs = (page) => page.evaluate(() => void chunkserver.dig(chunkserver.aim(), 5));

/** A proxy that knows no WebSockets: one page digs all the same, another one sees it. */
export async function deaf({ url }, context) {
  let sockets = 0;
  const began = performance.now();
  await context.routeWebSocket(/\/stream/, (socket) => {
    sockets += 1;
    void socket.close();
  });
  const [one, other] = [await opened(context, url, PLANE), await opened(context, url, PLANE)];
  await other.evaluate(() => {
    globalThis.wasAway = false;
    setInterval(() => (wasAway ||= chunkserver.counters.isAway), 50);
  });
  const before = await counters(other);
  await digs(one);
  const notice = await noticed(other);
  await revised(other, 1);
  await until(
    other,
    (count) => chunkserver.counters.isSettled && chunkserver.counters.triangles !== count,
    before.triangles,
  );
  await settled(one);
  const after = [await counters(one), await counters(other)];
  const seconds = (performance.now() - began) / 1000;
  return { notice, before, after, sockets, seconds, wasAway: await other.evaluate(() => wasAway) };
}

/** The server writes what is dug, and the answer is lost on its way; so is the next one. */
export async function unanswered({ url }, context) {
  const keys = [];
  await context.route(EDITS, async (route) => {
    if (route.request().method() !== "POST") {
      return route.continue();
    }
    keys.push(route.request().headers()["idempotency-key"]);
    if (keys.length > 4) {
      return route.continue();
    }
    await route.fetch();
    return route.abort("connectionreset");
  });
  const page = await opened(context, url, PLANE);
  const before = await counters(page);
  await digs(page);
  const notice = await noticed(page);
  await until(page, () => chunkserver.counters.revision === "1");
  await hidden(page);
  await until(
    page,
    (count) => chunkserver.counters.isSettled && chunkserver.counters.triangles !== count,
    before.triangles,
  );
  const { edits } = await page.evaluate(async (id) => (await fetch(`v1/worlds/${id}/edits`)).json(), "viewer-plane-1");
  return { notice, keys, written: edits.length };
}

/** The server does not take what is dug. */
export async function refused({ url }, context) {
  const body = JSON.stringify({ title: "A stroke is bad", status: 422, detail: "the ball is too round" });
  await context.route(EDITS, (route) => route.fulfill({ ...PROBLEM, body }));
  const page = await opened(context, url, PLANE);
  await page.focus("#view");
  await page.keyboard.press("KeyE");
  const notice = await noticed(page);
  await hidden(page);
  return { notice, counters: await counters(page) };
}

/** Something in between answers with a page of its own where chunks should be, for a while. */
export async function garbled({ url }, context) {
  const garble = (route) => route.fulfill({ contentType: "text/html", body: "<p>Please log in" });
  await context.route(/\/chunks/, garble);
  const page = await sentFor(context, url, PLANE);
  const notice = await noticed(page);
  const { isAway } = await counters(page);
  await page.evaluate(() => (globalThis.isSame = true));
  await context.unroute(/\/chunks/, garble);
  await settled(page);
  await hidden(page);
  return { notice, isAway, isSame: await page.evaluate(() => globalThis.isSame === true), after: await counters(page) };
}

/** A worker that does not come. */
export async function workerless({ url }, context) {
  await context.route(/\/worker-/, (route) => route.abort());
  const page = await sentFor(context, url, PLANE);
  return { notice: await noticed(page) };
}

/** A browser that stores nothing, and a server that wants a key. */
export async function storeless({ url, key }, context) {
  await context.addInitScript(() => {
    const deny = () => {
      throw new DOMException("denied", "SecurityError");
    };
    Object.defineProperty(globalThis, "sessionStorage", { get: deny });
  });
  const page = await sentFor(context, url, PLANE);
  await page.fill("#key", key);
  await page.click("#unlock [type=submit]");
  await settled(page);
  return await counters(page);
}

/** Another world: the least that was drawn in any frame on the way to it. */
export async function swapped({ url }, context) {
  const page = await opened(context, url, PLANE);
  const before = await counters(page);
  await page.evaluate(() => {
    const frames = (globalThis.least = { triangles: Infinity, frames: 0 });
    const look = () => {
      frames.triangles = Math.min(frames.triangles, chunkserver.counters.triangles);
      frames.frames += 1;
      requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
    location.hash = "#recipe=hills&seed=5&at=0,60,0&look=0.6,-0.35,-0.7&view=levels";
  });
  await until(page, () => document.title.startsWith("Hills"));
  await settled(page);
  return { before, least: await page.evaluate(() => least), after: await counters(page) };
}
