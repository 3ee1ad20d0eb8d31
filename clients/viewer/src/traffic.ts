/** The client in its worker, and what that worker counts. */

import { WorkerClient } from "chunkserver-client";

import type { Traffic } from "./counting.js";

/** How patient the client is: the page says what is wrong, and tries again by itself. */
const RETRY = { attemptsMax: 3, secondsMax: 20, backoffSecondsMax: 1 };

export interface Counted {
  readonly client: WorkerClient;
  /** Since the page was opened: bytes of answers as they came, and chunks that were asked for over the network. */
  readonly traffic: { bytes: number; chunks: number };
}

export function countedClient(url: string): Counted {
  const worker = new Worker(new URL("../../web/src/worker.ts", import.meta.url), { type: "module" });
  const traffic = { bytes: 0, chunks: 0 };
  worker.addEventListener("message", ({ data }) => {
    const counted = (data as Partial<Traffic>).traffic;
    if (counted !== undefined) {
      traffic.bytes += counted.bytes;
      traffic.chunks += counted.chunks;
    }
  });
  return { client: new WorkerClient(url, { retry: RETRY }, worker), traffic };
}
