/** Mouse, keys and fingers. */

import {
  MIDDLE,
  camera,
  counters,
  frames,
  held,
  moved,
  opened,
  revised,
  revisionOf,
  seenFrom,
  settled,
  sight,
  still,
  turned,
  until,
} from "../page.mjs";

const isLocked = () => document.pointerLockElement?.id === "view";
const radius = (page) => page.evaluate(() => Number(document.querySelector("#radius").value));
const hint = (page) => page.textContent("#hint");

/** The mouse is taken, looks around, digs, builds, and is free again: as by Esc, which a headless browser has not. */
export async function mouse({ url }, context) {
  const page = await opened(context, url);
  const [x, y] = MIDDLE;
  const hints = [await hint(page)];
  const start = await camera(page);
  await page.mouse.move(x, y);
  await page.mouse.move(x + 40, y);
  await frames(page, 3);
  const free = seenFrom(start, await camera(page));
  const menu = await page.evaluate(() =>
    document.querySelector("#view").dispatchEvent(new MouseEvent("contextmenu", { bubbles: true, cancelable: true })),
  );
  await page.mouse.move(x, y);
  await page.mouse.down();
  await until(page, isLocked);
  await page.mouse.up();
  await until(page, (old) => document.querySelector("#hint").textContent !== old, hints[0]);
  hints.push(await hint(page));
  const untouched = await revisionOf(page);

  await page.mouse.move(x + 60, y, { steps: 3 });
  await until(page, turned, [start.ahead, 0.05]);
  await frames(page, 3);
  const sideways = seenFrom(start, await camera(page));
  const level = await camera(page);
  await page.mouse.move(x + 60, y + 40, { steps: 2 });
  await until(page, turned, [level.ahead, 0.05]);
  await frames(page, 3);
  const down = seenFrom(level, await camera(page));

  const sights = [await sight(page)];
  const radii = [await radius(page)];
  const revisions = [await revisionOf(page)];
  for (const button of ["left", "right"]) {
    await page.mouse.down({ button });
    await page.mouse.up({ button });
    await revised(page, revisions.at(-1) + 1n);
    await settled(page);
    sights.push(await sight(page));
    revisions.push(await revisionOf(page));
  }
  for (const notch of [-100, -100, 100]) {
    await page.mouse.wheel(0, notch);
    await until(page, (old) => Number(document.querySelector("#radius").value) !== old, radii.at(-1));
    radii.push(await radius(page));
  }
  // digs for as long as the button is down
  await page.mouse.down();
  await revised(page, revisions.at(-1) + 2n);
  await page.evaluate(() => document.exitPointerLock());
  await until(page, () => document.pointerLockElement === null);
  await settled(page);
  const ended = [await revisionOf(page)];
  await frames(page, 20);
  ended.push(await revisionOf(page));
  await page.mouse.up();
  await until(page, (old) => document.querySelector("#hint").textContent !== old, hints[1]);
  hints.push(await hint(page));
  const last = await camera(page);
  await page.mouse.move(x, y);
  await frames(page, 3);
  return {
    hints,
    free: free.turned,
    menu,
    untouched: Number(untouched - revisions[0]),
    sideways: sideways.turned,
    down: down.turned,
    sights,
    radii,
    revisions: revisions.map(Number),
    ended: ended.map(Number),
    freed: seenFrom(last, await camera(page)).turned,
  };
}

/** No mouse: from the first key to another world. */
export async function keyboard({ url }, context) {
  const page = await opened(context, url);
  const ways = {};
  for (const [key, condition, least] of [
    ["KeyS", moved, 2],
    ["KeyD", moved, 2],
    ["Space", moved, 2],
    ["ArrowLeft", turned, 0.1],
    ["ArrowRight", turned, 0.1],
    ["ArrowUp", turned, 0.1],
  ]) {
    const from = await camera(page);
    await held(page, key, condition, [condition === moved ? from.position : from.ahead, least]);
    await still(page);
    ways[key] = seenFrom(from, await camera(page))[condition === moved ? "moved" : "turned"];
  }
  await page.keyboard.press("KeyF");
  await until(page, () => chunkserver.counters.isWalking);
  await until(page, () => chunkserver.counters.isStanding && chunkserver.counters.altitude < 2);
  const { altitude } = await counters(page);
  await page.keyboard.press("Digit3");
  const view = await page.evaluate(() => document.querySelector("#views input:checked").value);
  await held(page, "ArrowDown", () => chunkserver.camera.ahead[1] < -0.6);
  const revision = await revisionOf(page);
  await page.keyboard.press("KeyE");
  await revised(page, revision + 1n);
  await page.focus("#show-world");
  await page.keyboard.press("Enter");
  await page.keyboard.press("Tab");
  await page.keyboard.press("Control+A");
  await page.keyboard.type("7");
  await page.keyboard.press("Enter");
  await until(page, () => location.hash.includes("seed=7&"));
  await settled(page);
  return { ways, altitude, view, title: await page.title() };
}

/** Keys whose coming up nobody tells of: with Cmd, in another window, in another tab. Nobody may go on for ever. */
export async function stuck({ url }, context) {
  const page = await opened(context, url);
  const found = {};
  for (const [why, happens] of Object.entries({
    meta: () => page.keyboard.press("Meta"),
    blur: () => page.evaluate(() => void dispatchEvent(new Event("blur"))),
    hidden: () =>
      page.evaluate(() => {
        Object.defineProperty(document, "visibilityState", { value: "hidden", configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
        delete document.visibilityState;
      }),
  })) {
    const { position } = await camera(page);
    await page.evaluate(() =>
      document.body.dispatchEvent(new KeyboardEvent("keydown", { code: "KeyS", key: "s", bubbles: true })),
    );
    await until(page, moved, [position, 1]);
    await happens();
    await still(page);
    found[why] = (await camera(page)).position.every(Number.isFinite);
  }
  return found;
}

/** Fingers on both halves of the screen, and on buttons. */
export async function touch({ url }, context) {
  const page = await opened(context, url);
  const session = await context.newCDPSession(page);
  const fingers = (type, ...points) =>
    session.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y, id]) => ({ x, y, id })) });
  const start = await camera(page);
  await fingers("touchStart", [100, 200, 0]);
  await fingers("touchMove", [100, 240, 0]);
  await until(page, moved, [start.position, 2]);
  await fingers("touchEnd");
  await still(page);
  const left = seenFrom(start, await camera(page));
  const before = await camera(page);
  await fingers("touchStart", [280, 110, 1]);
  await fingers("touchMove", [320, 110, 1]);
  await until(page, turned, [before.ahead, 0.1]);
  await fingers("touchEnd");
  await still(page);
  const right = seenFrom(before, await camera(page));
  // both at once
  const both = await camera(page);
  await fingers("touchStart", [100, 200, 0]);
  await fingers("touchStart", [100, 200, 0], [280, 110, 1]);
  await fingers("touchMove", [140, 200, 0], [240, 110, 1]);
  await until(page, moved, [both.position, 2]);
  await until(page, turned, [both.ahead, 0.1]);
  await fingers("touchEnd");
  await still(page);
  const together = seenFrom(both, await camera(page));

  await page.evaluate(() => chunkserver.setCamera([0, 230, 0], [0, -1, -0.1]));
  await settled(page);
  const sights = [await sight(page)];
  for (const what of ["dig", "build"]) {
    const revision = await revisionOf(page);
    await page.tap(`[data-do=${what}]`);
    await revised(page, revision + 1n);
    await settled(page);
    sights.push(await sight(page));
  }
  return { left, right, both: together, sights };
}

/** The buttons of a touch screen, by their keys. */
export async function pads({ url }, context) {
  const page = await opened(context, url);
  const rises = {};
  for (const [what, key] of [
    ["up", "Enter"],
    ["down", "Space"],
  ]) {
    const from = await camera(page);
    await page.focus(`[data-hold=${what}]`);
    await held(page, key, moved, [from.position, 2]);
    await still(page);
    rises[what] = seenFrom(from, await camera(page)).moved.up;
  }
  const from = await camera(page);
  await page.focus("[data-hold=up]");
  await page.keyboard.down("Enter");
  await until(page, moved, [from.position, 1]);
  await page.focus("#share"); // the key comes up elsewhere
  await still(page);
  await page.evaluate(() => chunkserver.setCamera([0, 230, 0], [0, -1, -0.1]));
  await settled(page);
  const revision = await revisionOf(page);
  await page.focus("[data-do=dig]");
  await page.keyboard.press("Enter");
  await revised(page, revision + 1n);
  return rises;
}
