/** Several pages in one world, and a server that goes away. */

import { counters, noticed, opened, revised, settled, sight, until } from "../page.mjs";

/** One page digs, another one sees it. */
export async function dig({ url }, context) {
  const [one, other] = [await opened(context, url), await opened(context, url)];
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
}

/** Two pages build each at a place of its own, and dig at the same one; a third one comes later. */
export async function both({ url }, context) {
  const pages = [await opened(context, url), await opened(context, url)];
  const edit = (page, by) =>
    page.evaluate(async (off) => {
      const [x, y, z] = chunkserver.aim();
      await chunkserver.build([40 * off, 157, 29], 12); // on either side of x = 0 no chunk is the same
      await chunkserver.dig([x + off, y, z], 5);
    }, by);
  await pages[0].evaluate(() => chunkserver.dig(chunkserver.aim(), 2)); // from then on there is a world, and its stream
  for (const page of pages) {
    await revised(page, 1);
    await until(page, () => chunkserver.counters.isLive && chunkserver.counters.isSettled);
  }
  await Promise.all([edit(pages[0], -3), edit(pages[1], 3)]);
  for (const page of pages) {
    await revised(page, 5);
    await settled(page);
  }
  pages.push(await opened(context, url));
  return { counters: await Promise.all(pages.map(counters)), sight: await Promise.all(pages.map(sight)) };
}

/** Until the server is away, and is said to be. From then on the page gets no answer, whoever is there. */
export async function lost(_, context) {
  const page = context.pages().at(-1);
  await until(page, () => chunkserver.counters.isAway);
  const notice = await noticed(page);
  await context.setOffline(true);
  return { notice, counters: await counters(page) };
}

/** The server is there again, with an edit of somebody else's; then the page digs again, and a new one sees the same. */
export async function back({ url }, context) {
  const page = context.pages().at(-1);
  const before = await counters(page);
  await context.setOffline(false);
  await until(page, () => !chunkserver.counters.isAway);
  await revised(page, BigInt(before.revision) + 1n);
  await settled(page);
  const heard = await counters(page);
  const isHidden = await page.isHidden("#notice");
  await page.evaluate(() => chunkserver.dig(chunkserver.aim(), 5));
  await revised(page, BigInt(heard.revision) + 1n);
  await settled(page);
  const after = await counters(page);
  const fresh = await opened(context, url, new URL(page.url()).hash);
  return { before, heard, after, fresh: await counters(fresh), isHidden };
}
