/** What comes over the network until all is shown that the page shows without a link. */

import { counters, sentFor, settled, until } from "../page.mjs";

/** More than pass between two counts, a quarter of a second. */
const FRAMES = 30;

/**
 * Answers are [path, bytes]. Chunks of a batch that is ended early are in no answer, but in `bytes`, which the page counts
 * now and then.
 */
export async function firstView({ url }, context) {
  const answered = [];
  context.on("requestfinished", (request) => answered.push(request));
  const page = await sentFor(context, url, "");
  await settled(page);
  const answers = await Promise.all(
    answered.map(async (request) => [new URL(request.url()).pathname, (await request.sizes()).responseBodySize]),
  );
  const ofChunks = answers.reduce((sum, [path, size]) => sum + (path.endsWith("/chunks") ? size : 0), 0);
  await until(page, ([chunks, frames]) => chunkserver.counters.bytes > chunks && chunkserver.counters.frames > frames, [
    ofChunks,
    (await counters(page)).frames + FRAMES,
  ]);
  return { answers, ...(await counters(page)) };
}
