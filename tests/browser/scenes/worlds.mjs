/** Which world is shown: by a link, by a recipe's text. */

import { camera, counters, frames, noticed, opened, sentFor, settled, until } from "../page.mjs";

/** What the address says of a page is what another page makes of it. */
export async function link({ url }, context) {
  const hash = "#recipe=hills&seed=-7&at=1000000123.25,60.5,-2000000.75&look=0.6,-0.4,-0.6928&walk=1&view=normals";
  const first = await opened(context, url, hash);
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
}

/** A recipe that is wrong is refused at its line; a right one is shown. */
export async function recipe({ url }, context) {
  const page = await opened(context, url, "#recipe=plane&seed=1&view=normals");
  await page.click("#show-world");
  await page.click("#edit-recipe summary");
  await page.fill("#json", '{\n  "op": "add",\n  "a": {"op": "y"},\n  "b": {"op": "nothing"}\n}');
  await until(page, () => document.querySelector("#json-error").textContent !== "");
  const error = await page.textContent("#json-error");
  const isInvalid = await page.getAttribute("#json", "aria-invalid");
  await page.fill("#json", '{"op": "constant", "value": 1e999}');
  await until(page, () => !document.querySelector("#json-error").textContent.includes("known op"));
  const infinite = await page.textContent("#json-error");
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
    infinite,
    after: await page.textContent("#json-error"),
    hash: await page.evaluate(() => location.hash),
  };
}

/** A link to a world that is not there: what there is can be chosen. */
export async function absent({ url }, context) {
  const page = await sentFor(context, url, "#world=not-there&view=normals");
  const notice = await noticed(page);
  await page.waitForSelector("#recipe", { state: "visible" });
  const choices = await page.locator("#recipe option").allTextContents();
  await page.selectOption("#recipe", "plane");
  await settled(page);
  return { notice, choices, title: await page.title(), isHidden: await page.isHidden("#notice") };
}

/** Another world is chosen while a seed is entered; the browser's button leads back to the one before. */
export async function wayBack({ url }, context) {
  const page = await opened(context, url, "#recipe=plane&seed=1&at=0,40,7&look=0,-0.5,-0.9&view=normals");
  const shows = (title) => until(page, (start) => document.title.startsWith(start), title);
  await page.click("#show-world");
  await page.selectOption("#recipe", "sphere");
  await page.fill("#seed", "seven");
  await shows("Sphere, seed 1");
  const typed = await page.inputValue("#seed");
  await page.press("#seed", "Enter");
  const refused = await page.textContent("#seed-error");
  await page.fill("#seed", "7");
  const forgiven = await page.textContent("#seed-error");
  await page.press("#seed", "Enter");
  await shows("Sphere, seed 7");
  const hash = await page.evaluate(() => location.hash);
  await page.goBack();
  await shows("Sphere, seed 1");
  await page.goBack();
  await shows("Plane, seed 1");
  await settled(page);
  const seed = await page.inputValue("#seed");
  const there = await camera(page);
  await page.goForward();
  await shows("Sphere, seed 1");
  return { typed, refused, forgiven, hash, seed, camera: there };
}

/** A world that is rock where one begins: the viewer is put into its cave. A link that says where they are is right. */
export async function buried({ url }, context) {
  const sphere = { op: "sphere", center: [0, 90, 44], radius: 30 };
  const posted = await fetch(`${url}/v1/recipes`, {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify({ op: "multiply", a: sphere, b: -1 }),
  });
  const { digest } = await posted.json();
  const page = await opened(context, url, `#recipe=${digest}&seed=1&view=normals`);
  const begun = await camera(page);
  await page.goto("about:blank");
  await page.goto(`${url}/#recipe=${digest}&seed=1&at=0,80,0&view=normals`);
  await settled(page);
  await frames(page, 5);
  return { begun: begun.position, linked: (await camera(page)).position };
}
