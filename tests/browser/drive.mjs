/**
 * A Chromium that opens the viewer: takes the names of scenes as lines of JSON, answers each with one.
 *
 *     {"scene": "levels", "url": "http://127.0.0.1:8000", "folder": "/tmp/x"}  ->  {"found": {...}} or {"error": "..."}
 *
 * Waits are for counters of `window.chunkserver`, never for a time.
 */

import { createInterface } from "node:readline";
import { chromium } from "playwright-core";

const WAIT_MS = 60_000;
const VIEW = { width: 480, height: 320 };
/** Of the canvas for one of the page: there is no graphics card, and little time. */
const PIXELS = 0.5;
const ARGS = [
  "--no-sandbox",
  "--use-angle=swiftshader",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];
/** On the ground of the planet of seed 42. Normals are the cheapest to draw. */
const GROUND = "#recipe=planet&seed=42&at=0,226,30&look=0.6,-0.35,-0.7&view=normals";

const complaints = [];
let context;
let blank;

async function opened(url, hash = GROUND) {
  const page = await context.newPage();
  page.setDefaultTimeout(WAIT_MS);
  page.on("pageerror", (error) => complaints.push(String(error.stack)));
  page.on("console", (message) => /Content Security Policy/.test(message.text()) && complaints.push(message.text()));
  await page.goto(`${url}/${hash}`);
  await settled(page);
  return page;
}

const until = (page, condition, argument) =>
  page.waitForFunction(condition, argument, { timeout: WAIT_MS, polling: 50 });
const settled = (page) => until(page, () => globalThis.chunkserver?.counters.isSettled);
const counters = (page) => page.evaluate(() => chunkserver.counters);
const camera = (page) => page.evaluate(() => chunkserver.camera);
const revised = (page, revision) =>
  until(page, (least) => BigInt(chunkserver.counters.revision) >= BigInt(least), revision);

/** How far the ground is along the crosshair, in voxels. */
const sight = (page) =>
  page.evaluate(() => {
    const [aim, { position }] = [chunkserver.aim(), chunkserver.camera];
    return aim === null ? Infinity : Math.hypot(...aim.map((place, axis) => place - position[axis]));
  });

const apart = (one, other) => Math.hypot(...one.map((place, axis) => place - other[axis]));

/** Holds a key down until something has come of it. */
async function held(page, key, condition, argument) {
  await page.keyboard.down(key);
  await until(page, condition, argument);
  await page.keyboard.up(key);
}

const moved = ([from, least]) => Math.hypot(...chunkserver.camera.position.map((at, axis) => at - from[axis])) > least;
const turned = ([from, least]) => Math.hypot(...chunkserver.camera.ahead.map((at, axis) => at - from[axis])) > least;

const scenes = {
  /** What is shown from the ground, and that nothing is asked for any more then. */
  async levels({ url }) {
    const page = await opened(url);
    const views = {};
    for (const view of ["wireframe", "levels", "normals", "shaded"]) {
      await page.evaluate((name) => chunkserver.setView(name), view);
      views[view] = (await page.screenshot()).toString("base64");
    }
    return { ...(await counters(page)), title: await page.title(), views };
  },

  /** Straight down on a planet that fills the picture, from several places: pictures without anything in front. */
  async seams({ url }) {
    const page = await opened(url, GROUND.replace("normals", "levels"));
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
  },

  /** One page digs, another one sees it. */
  async dig({ url }) {
    const [one, other] = [await opened(url), await opened(url)];
    const before = { sight: await sight(other), counters: await counters(other) };
    await one.focus("#view");
    await one.keyboard.press("KeyE");
    await revised(one, 1);
    await settled(one);
    await revised(other, 1);
    await settled(other);
    await until(
      other,
      (least) => chunkserver.aim() !== null && chunkserver.counters.triangles !== least,
      before.counters.triangles,
    );
    return {
      before,
      sight: [await sight(one), await sight(other)],
      counters: [await counters(one), await counters(other)],
    };
  },

  /** Until the server is away, and is said to be. */
  async lost() {
    const page = context.pages().at(-1);
    await until(page, () => chunkserver.counters.isAway);
    await page.waitForSelector("#notice", { state: "visible" });
    return { notice: await page.textContent("#notice"), counters: await counters(page) };
  },

  /** It is there again, and is dug in again. */
  async back() {
    const page = context.pages().at(-1);
    await until(page, () => !chunkserver.counters.isAway);
    const before = await counters(page);
    await page.evaluate(() => chunkserver.dig(chunkserver.aim(), 5));
    await revised(page, String(BigInt(before.revision) + 1n));
    await settled(page);
    const isHidden = await page.isHidden("#notice");
    return { before, after: await counters(page), isHidden };
  },

  /** What the address says of a page is what another page makes of it. */
  async link({ url }) {
    const hash = "#recipe=hills&seed=-7&at=1000000123.25,60.5,-2000000.75&look=0.6,-0.4,-0.6928&walk=1&view=normals";
    const first = await opened(url, hash);
    await first.evaluate(() => chunkserver.setCamera([1000000123.25, 90.5, -2000000.75], [0.6, -0.4, -0.6928]));
    await first.keyboard.press("KeyF");
    await until(
      first,
      () =>
        !chunkserver.counters.isWalking &&
        !location.hash.includes("walk") &&
        /at=1000000123.25,90.5,/.test(location.hash),
    );
    const address = first.url();
    const second = await context.newPage();
    await second.goto(address);
    await settled(second);
    return {
      address,
      cameras: [await camera(first), await camera(second)],
      counters: await counters(second),
      title: await second.title(),
    };
  },

  /** No mouse: from the first key to another world. */
  async keyboard({ url }) {
    const page = await opened(url);
    const start = await camera(page);
    await held(page, "KeyS", moved, [start.position, 2]);
    await held(page, "ArrowLeft", turned, [start.ahead, 0.1]);
    await held(page, "ArrowRight", turned, [(await camera(page)).ahead, 0.1]);
    await page.keyboard.press("KeyF");
    await until(page, () => chunkserver.counters.isWalking);
    await until(page, () => chunkserver.counters.isStanding && chunkserver.counters.altitude < 2);
    const { altitude } = await counters(page);
    await page.keyboard.press("Digit3");
    const view = await page.evaluate(() => document.querySelector("#views input:checked").value);
    await held(page, "ArrowDown", () => chunkserver.camera.ahead[1] < -0.6);
    const { revision } = await counters(page);
    await page.keyboard.press("KeyE");
    await revised(page, String(BigInt(revision) + 1n));
    await page.keyboard.press("KeyH");
    const helps = await page.isVisible("#help");
    await page.keyboard.press("Escape");
    await page.focus("#show-world");
    await page.keyboard.press("Enter");
    await page.keyboard.press("Tab");
    await page.keyboard.type("7");
    await page.keyboard.press("Enter");
    await until(page, () => /seed=427|seed=742|seed=7&/.test(location.hash));
    await settled(page);
    return {
      altitude,
      view,
      helps,
      closed: await page.isHidden("#help"),
      hash: await page.evaluate(() => location.hash),
    };
  },

  /** Fingers on both halves of the screen, and on a button. */
  async touch({ url }) {
    const page = await opened(url);
    const session = await context.newCDPSession(page);
    const touch = (type, ...points) =>
      session.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y, id]) => ({ x, y, id })) });
    const start = await camera(page);
    await touch("touchStart", [100, 200, 0]);
    await touch("touchMove", [100, 240, 0]);
    await until(page, moved, [start.position, 2]);
    await touch("touchStart", [100, 240, 0], [350, 160, 1]);
    await touch("touchMove", [100, 240, 0], [400, 160, 1]);
    await until(page, turned, [start.ahead, 0.1]);
    await touch("touchEnd");
    const end = await camera(page);
    await page.evaluate(() => chunkserver.setCamera([0, 230, 0], [0, -1, -0.1]));
    await settled(page);
    const { revision } = await counters(page);
    await page.tap("[data-do=dig]");
    await revised(page, String(BigInt(revision) + 1n));
    return { moved: apart(start.position, end.position), turned: apart(start.ahead, end.ahead) };
  },

  /** A recipe that is wrong is refused at its line; a right one is shown. */
  async recipe({ url }) {
    const page = await opened(url, "#recipe=plane&seed=1&view=normals");
    await page.click("#show-world");
    await page.click("#edit-recipe summary");
    await page.fill("#json", '{\n  "op": "add",\n  "a": {"op": "y"},\n  "b": {"op": "nothing"}\n}');
    await until(page, () => document.querySelector("#json-error").textContent !== "");
    const error = await page.textContent("#json-error");
    const isInvalid = await page.getAttribute("#json", "aria-invalid");
    const before = await counters(page);
    await page.fill("#json", '{"op": "min", "a": {"op": "y"}, "b": {"op": "sphere", "radius": 9}}');
    await until(
      page,
      (old) => chunkserver.counters.isSettled && chunkserver.counters.triangles !== old,
      before.triangles,
    );
    return {
      error,
      isInvalid,
      after: await page.textContent("#json-error"),
      hash: await page.evaluate(() => location.hash),
    };
  },
};

async function answer({ scene, keeps, ...given }) {
  try {
    const found = await scenes[scene](given);
    const wrong = complaints.splice(0);
    return wrong.length ? { error: wrong.join("\n") } : { found };
  } catch (error) {
    const page = context.pages().at(-1);
    const state = await page
      .evaluate(() => JSON.stringify([globalThis.chunkserver?.counters, location.href]))
      .catch(String);
    return { error: [error.stack, state, ...complaints.splice(0)].join("\n") };
  } finally {
    if (!keeps) {
      await Promise.all(context.pages().map((page) => page === blank || page.close()));
    }
  }
}

for await (const line of createInterface({ input: process.stdin })) {
  const given = JSON.parse(line);
  if (context === undefined) {
    context = await chromium.launchPersistentContext(given.folder, {
      executablePath: "/usr/bin/chromium",
      headless: true,
      viewport: VIEW,
      deviceScaleFactor: PIXELS,
      hasTouch: true,
      args: ARGS,
    });
    [blank] = context.pages();
  }
  process.stdout.write(`${JSON.stringify(await answer(given))}\n`);
}
await context?.close();
