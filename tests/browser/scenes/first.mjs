/** What comes over the network until all is shown that the page shows without a link. */

import { counters, sentFor, settled } from "../page.mjs";

export async function firstView({ url }, context) {
  const answered = [];
  context.on("requestfinished", (request) => answered.push(request));
  const page = await sentFor(context, url, "");
  await settled(page);
  const answers = answered.map(async (request) => [
    new URL(request.url()).pathname,
    (await request.sizes()).responseBodySize,
  ]);
  return { answers: await Promise.all(answers), ...(await counters(page)) };
}
