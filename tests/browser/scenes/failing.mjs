/** What is missing: a key, a server, a graphics card. */

import { CHROMIUM, chromium } from "../../chromium.mjs";

import { complaints, counters, noticed, opened, revised, sentFor, settled, until } from "../page.mjs";

/** A browser that has no WebGL. */
export async function flat({ url }) {
  const browser = await chromium.launch({ ...CHROMIUM, args: [...CHROMIUM.args, "--disable-3d-apis"] });
  try {
    const page = await browser.newPage();
    page.on("pageerror", (error) => complaints.push(String(error.stack)));
    await page.goto(url);
    const notice = await noticed(page);
    return { notice, buttons: await page.locator("button:visible, input:visible").count() };
  } finally {
    await browser.close();
  }
}

/** A graphics card that lets go of the picture, and has it again. */
export async function context({ url }, context) {
  const page = await opened(context, url, "#recipe=plane&seed=1&look=0.6,-0.35,-0.7&view=levels");
  const picture = async () => (await page.screenshot()).toString("base64");
  const pictures = [await picture()];
  await page.evaluate(() => {
    globalThis.extension = document.querySelector("#view").getContext("webgl2").getExtension("WEBGL_lose_context");
    extension.loseContext();
  });
  const notice = await noticed(page);
  await page.evaluate(() => extension.restoreContext());
  await page.waitForSelector("#notice", { state: "hidden" });
  await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
  pictures.push(await picture());
  return { notice, pictures };
}

/** The page comes, and then the server is away; nobody reloads. */
export async function away({ url }, context) {
  const away = (route) => route.abort("connectionrefused");
  await context.route(/\/v1\/|\/readyz/, away);
  const page = await sentFor(context, url, "#recipe=plane&seed=1&view=normals");
  const notice = await noticed(page);
  const { isAway } = await counters(page);
  await page.evaluate(() => (globalThis.isSame = true));
  await context.unroute(/\/v1\/|\/readyz/, away);
  await settled(page);
  return {
    notice,
    isAway,
    isSame: await page.evaluate(() => globalThis.isSame === true),
    after: await counters(page),
    isHidden: await page.isHidden("#notice"),
  };
}

/** A server that wants keys. keys: wrong, of scope read, of scope admin */
export async function keys({ url, keys: [wrong, reads, makes] }, context) {
  const page = await sentFor(context, url);
  const said = async () => {
    await page.waitForSelector("#key", { state: "visible" });
    await until(page, () => document.querySelector("#key-error").textContent !== "");
    return page.textContent("#key-error");
  };
  const use = async (key) => {
    await page.fill("#key", key);
    await page.click("#unlock [type=submit]");
  };
  const isOpen = () => page.isVisible("#world");
  const dig = async () => {
    await page.focus("#view");
    await page.keyboard.press("KeyE");
  };
  const asked = await said();
  await use(wrong);
  const refused = await said();
  await use(reads);
  await settled(page);
  const shown = await counters(page);
  const open = [await isOpen()];
  await dig();
  const told = await said();
  const kept = await counters(page);
  await use(makes);
  await until(page, () => chunkserver.counters.isSettled && !chunkserver.counters.isOpening);
  open.push(await isOpen());
  await dig();
  await revised(page, 1);
  await settled(page);
  return { asked, refused, shown, told, kept, open, dug: await counters(page) };
}
