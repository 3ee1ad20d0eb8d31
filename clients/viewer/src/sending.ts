/** One's own edits: each is sent until it is known what became of it. */

import { NotAllowed, Problem } from "chunkserver-client";

import { pauseOf, type Clock, type Pauses } from "./clock.js";
import { isOpen } from "./failures.js";

const PAUSES: Pauses = { first: 500, most: 5_000 };
/** After that nobody waits for it any more. */
const SENDING_MS_MAX = 600_000;

/** An edit did not get through, or nobody knows. The message is for people. */
export class EditFailed extends Error {}

export interface Sending {
  readonly clock: Clock;
  /** Whoever sends has left. */
  readonly left: AbortSignal;
  /** Called with whether it is to be sent once more, and why. */
  delayed(error: unknown): void;
}

/**
 * Calls `send` until the server has answered. It has to send the same edit under the same key each time: then it is
 * written once, whatever was lost.
 *
 * @throws {EditFailed} for a refusal, and if nobody knows when time is up; what went wrong is its cause
 */
export async function untilKnown<Value>(send: () => Promise<Value>, { clock, left, delayed }: Sending): Promise<Value> {
  const began = clock.now();
  for (let sent = 1; ; sent++) {
    try {
      left.throwIfAborted();
      return await send();
    } catch (error) {
      if (left.aborted || !isOpen(error) || clock.now() - began > SENDING_MS_MAX) {
        const isAnswer = error instanceof Problem && !isOpen(error);
        const isRefused = isAnswer && (sent === 1 || !(error instanceof NotAllowed)); // one that was written was allowed
        throw new EditFailed(isRefused ? refused(error) : lost(left.aborted ? null : error), { cause: error });
      }
      delayed(error);
    }
    await pause(pauseOf(PAUSES, sent - 1), clock, left);
  }
}

/** Ends early when `left` is aborted. */
function pause(ms: number, clock: Clock, left: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const over = () => {
      cancel();
      left.removeEventListener("abort", over);
      resolve();
    };
    const cancel = clock.after(ms, over);
    left.addEventListener("abort", over);
  });
}

function refused({ detail, title }: Problem): string {
  return `Your last change is lost. The server does not take it: ${detail || title}.`;
}

function lost(error: unknown): string {
  const why = error instanceof Error ? `: ${error.message}` : "";
  return `Nobody knows whether your last change has reached the server${why}.`;
}
