/** What a game was told and has not taken yet: so much, and no more. */

import type { Chunks, Refresh } from "./chunks.js";
import type { Welcome } from "./messages.js";
import type { Ended, SessionEvent } from "./session.js";

const EVENTS_MAX = 1024;
/** Of the frames that the events came in. */
const BYTES_MAX = 1 << 20;

/**
 * Events up to a revision were dropped: they were not taken in time. What they have changed is in the refreshes. The
 * answers to own edits among them have reached those who wait for them.
 */
export interface Skipped {
  readonly kind: "skipped";
  readonly revision: bigint;
}

/** What a game is told. */
export type StreamEvent = Exclude<SessionEvent, Welcome | Ended> | Skipped | Refresh;

/** Events in their order; behind them what is to be fetched, which is asked for when all else is taken. */
export class Inbox {
  private events: { readonly event: StreamEvent; readonly size: number }[] = [];
  private bytes = 0;
  private refreshes: Refresh[] = [];

  /** Adds an event. size: of its frame. revision: known with it; if there is no room, all up to it goes. */
  put(event: StreamEvent, size: number, revision: bigint): void {
    if (event.kind === "start over") {
      this.refreshes = [];
    }
    this.events.push({ event, size });
    this.bytes += size;
    if (this.events.length > EVENTS_MAX || this.bytes > BYTES_MAX) {
      const over = this.events.findLast(({ event: each }) => each.kind === "start over");
      const skipped: Skipped = { kind: "skipped", revision };
      this.events = [...(over === undefined ? [] : [{ ...over, size: 0 }]), { event: skipped, size: 0 }];
      this.bytes = 0;
    }
  }

  /** What comes next; null if there is nothing. */
  take(chunks: Chunks): StreamEvent | null {
    const next = this.events.shift();
    if (next !== undefined) {
      this.bytes -= next.size;
      return next.event;
    }
    if (!this.refreshes.length) {
      this.refreshes = chunks.take();
    }
    return this.refreshes.shift() ?? null;
  }
}
