/** How the page is laid out, what its controls are called, and who can use them. */

import { frames, noticed, opened, settled } from "../page.mjs";
import { watch } from "../watch.mjs";

const PLANE = "#recipe=plane&seed=1&view=normals";

/** In the page: the boxes of what is on the screen, by name. */
function boxes() {
  const found = {};
  const parts = "header > *, .tools > *, .brush > *, #hint, .stick, .pads > *, .panel, #notice, dialog";
  for (const part of document.querySelectorAll(parts)) {
    const { left, top, right, bottom, width, height } = part.getBoundingClientRect();
    if (width * height > 0 && !part.matches(".tools")) {
      const cut = [part, ...part.querySelectorAll("span, button, label, p")].some(
        (each) => getComputedStyle(each).overflowX === "hidden" && each.scrollWidth > each.clientWidth,
      );
      const name = part.id || part.dataset.hold || part.dataset.do || part.className || part.textContent.trim();
      found[name] = { left, top, right, bottom, cut };
    }
  }
  return found;
}

/** The page as it is first seen, with its panels open, with a notice, with its help. */
export async function layout({ url }, context) {
  const page = await opened(context, url, PLANE);
  const states = {};
  const look = async (name) => {
    states[name] = { boxes: await page.evaluate(boxes), picture: (await page.screenshot()).toString("base64") };
  };
  await look("first");
  await page.click("#show-figures");
  await page.waitForSelector("#figures dd");
  await look("figures");
  await page.click("#show-figures");
  await page.click("#show-world");
  await look("world");
  await page.click("#edit-recipe summary");
  await look("recipe");
  await page.click("#edit-recipe summary");
  await page.click("#show-world");
  await page.click("#show-help");
  await look("help");
  await page.keyboard.press("Escape");
  await page.click("#share");
  await noticed(page);
  await look("notice");
  return { states, size: await page.evaluate(() => [innerWidth, innerHeight, document.documentElement.scrollWidth]) };
}

/** What is read to somebody who does not see, where the keyboard is, and how well text is told from what is behind. */
export async function access({ url }, context) {
  const page = await opened(context, url, PLANE);
  await page.click("#show-world");
  await page.click("#edit-recipe summary");
  await page.click("#show-figures");
  await page.waitForSelector("#figures dd");
  const session = await context.newCDPSession(page);
  const { nodes } = await session.send("Accessibility.getFullAXTree");
  const focusable = nodes.filter(
    ({ ignored, properties }) => !ignored && properties?.some(({ name }) => name === "focusable"),
  );
  const controls = focusable.map(({ role, name }) => [role.value, name?.value ?? ""]);

  // all the way round by Tab
  const stops = new Map();
  await page.focus("#view");
  for (let steps = 0; steps < 40; steps++) {
    await page.keyboard.press("Tab");
    const [name, ...outline] = await page.evaluate(() => {
      const { activeElement: element } = document;
      const shown = element.matches(".segments input") ? element.nextElementSibling : element;
      const { outlineStyle, outlineWidth } = getComputedStyle(shown);
      if (element === document.body) {
        return ["body", "none", 0];
      }
      return [element.id || element.value || element.textContent.trim(), outlineStyle, parseFloat(outlineWidth)];
    });
    stops.set(name, outline);
    if (name === "view") {
      break;
    }
  }
  const contrasts = await page.evaluate(contrastsOf);
  await page.click("#show-help");
  const helps = [await page.isVisible("#help")];
  const inHelp = await page.evaluate(contrastsOf);
  await page.keyboard.press("Escape");
  helps.push(await page.isVisible("#help"));
  const focused = await page.evaluate(() => document.activeElement.id);
  return { controls, stops: [...stops], contrasts: { ...contrasts, ...inHelp }, helps, focused };
}

/** In the page: of all text in front of the world, the contrast to what is behind it where the world is white. */
function contrastsOf() {
  const parse = (colour) => {
    const [red, green, blue, alpha = 1] = colour.match(/[\d.]+/g).map(Number);
    return [red, green, blue, alpha];
  };
  const over = ([...top], below) => [0, 1, 2].map((at) => top[at] * top[3] + below[at] * (1 - top[3]));
  const light = (colour) => {
    const [red, green, blue] = colour.map((part) => {
      const share = part / 255;
      return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
  };
  const found = {};
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node !== null; node = walker.nextNode()) {
    const element = node.parentElement;
    if (node.data.trim() === "" || !element.checkVisibility() || element.closest("noscript, .unseen, script, select")) {
      continue;
    }
    const layers = [];
    for (let each = element; each !== document.body; each = each.parentElement) {
      layers.push(parse(getComputedStyle(each).backgroundColor));
    }
    const behind = layers.reduceRight((below, layer) => over(layer, below), [255, 255, 255]);
    const front = over(parse(getComputedStyle(element).color), behind);
    const [one, other] = [light(front), light(behind)].sort((a, b) => b - a);
    found[`${element.tagName}.${element.className} ${node.data.trim().slice(0, 24)}`] = (one + 0.05) / (other + 0.05);
  }
  return found;
}

/** Colours of what people look for who have asked for others: behind text, around it, and of it. */
export async function colours({ url }, context) {
  const page = await opened(context, url, "#recipe=plane&seed=1&view=normals");
  await page.click("#walk");
  return page.evaluate(() => {
    const of = (selector) => {
      const { backgroundColor, borderTopColor, color } = getComputedStyle(document.querySelector(selector));
      return { behind: backgroundColor, edge: borderTopColor, text: color };
    };
    const probe = document.body.appendChild(document.createElement("p"));
    probe.id = "probe";
    probe.style = "forced-color-adjust: none; background: Highlight";
    return {
      selected: of("#probe"),
      chosen: of("#views input:checked + span"),
      other: of("#views input:not(:checked) + span"),
      pressed: of("#walk"),
      plain: of("#chance"),
      panel: of("#share"),
    };
  });
}

/** On a machine that has a frame each 20 ms: how many of ten are drawn, until none is. motion: what is preferred */
export async function calm({ url, motion, tries }, context) {
  await context.addInitScript(watch);
  await context.addInitScript(() => {
    let now = 0;
    performance.now = () => now;
    const request = globalThis.requestAnimationFrame.bind(globalThis);
    globalThis.requestAnimationFrame = (call) =>
      request(() => {
        now += 20;
        call(now);
      });
  });
  const page = await context.newPage();
  await page.emulateMedia({ reducedMotion: motion });
  await page.goto(`${url}/${PLANE}`);
  await settled(page);
  const drawn = [];
  while (drawn.at(-1) !== 0 && drawn.length < tries) {
    await page.evaluate(() => watched.begin());
    await frames(page, 10);
    drawn.push((await page.evaluate(() => watched.end())).frames);
  }
  return { drawn };
}
