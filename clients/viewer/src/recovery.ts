/**
 * What is done about failures, and how often: `failures.ts` says what they mean.
 *
 * Each part of the page fails and recovers by itself. What fails again soon after it was tried again waits longer each
 * time, so nothing is asked for in a hot loop, whatever the server says.
 */

import { Unavailable } from "chunkserver-client";

import { CLOCK, pauseOf, type Clock, type Pauses } from "./clock.js";
import { verdictOn, type Remedy } from "./failures.js";

/** What can fail, the worst first. */
export const PARTS = ["page", "world", "chunks", "edits"] as const;
export type Part = (typeof PARTS)[number];

/** Whoever has the parts. */
export interface Host {
  /** Rejects if the server cannot build chunks, with why not. */
  ready(): Promise<unknown>;
  /** Tries once more what has failed. */
  resume(part: Part): void;
  /** Shows the world as it is now. */
  reopen(): void;
  askForKey(why: string): void;
  /** Says it for as long as it is so; null is nothing. */
  tell(message: string | null): void;
}

interface Trouble {
  remedy: Remedy;
  message: string;
  readonly error: unknown;
  cancel: () => void;
}

const WAIT: Pauses = { first: 700, most: 5_000 };
const AGAIN: Pauses = { first: 1_000, most: 60_000 };
/** Of what the server asks for with `Retry-After`. */
const ASKED_MAX = 60_000;
/** What was well for so long fails for the first time again. */
const CALM_MS = 60_000;

export class Recovery {
  private readonly troubles = new Map<Part, Trouble>();
  private readonly failures = new Map<Part, { count: number; triedAt: number }>();
  private readonly notes = new Map<string, string>();
  private told: string | null = null;

  constructor(
    private readonly host: Host,
    private readonly clock: Clock = CLOCK,
    private readonly random: () => number = Math.random,
  ) {}

  /** Whether the server is waited for. */
  get isAway(): boolean {
    return [...this.troubles.values()].some(({ remedy }) => remedy === "wait");
  }

  /** Something has failed: it is stopped until it is resumed. Who says so twice does not make it last longer. */
  failed(part: Part, error: unknown): void {
    const trouble = { ...verdictOn(error, part === "world"), error, cancel: () => {} };
    const before = this.troubles.get(part);
    if (before?.remedy === trouble.remedy || before?.remedy === "stop") {
      return;
    }
    before?.cancel();
    this.troubles.set(part, trouble);
    this.plan(part, trouble);
    this.tell();
  }

  /** What else is to be said, behind what has failed; null is nothing any more. */
  note(about: string, message: string | null): void {
    if (message === null) {
      this.notes.delete(about);
    } else {
      this.notes.set(about, message);
    }
    this.tell();
  }

  /** What was wrong is of no interest any more: another world is shown, or is to be. How often it was so still is. */
  forget(...parts: Part[]): void {
    for (const part of parts.length ? parts : PARTS) {
      this.drop(part);
    }
    this.tell();
  }

  private plan(part: Part, trouble: Trouble): void {
    const before = this.failures.get(part);
    const isCalm = before === undefined || this.clock.now() - before.triedAt > CALM_MS;
    const count = isCalm ? 0 : before.count;
    this.failures.set(part, { count: count + 1, triedAt: Infinity });
    const again = (ms: number, act: () => void) => (trouble.cancel = this.clock.after(ms, act));
    switch (trouble.remedy) {
      case "wait":
        again(Math.max(this.pause(WAIT, count), askedFor(trouble.error)), () => void this.look(part, trouble));
        break;
      case "retry":
        again(this.pause(AGAIN, count), () => this.resume(part));
        break;
      case "reopen":
        again(count === 0 ? 0 : this.pause(AGAIN, count - 1), () => {
          this.drop(part);
          this.host.reopen();
        });
        break;
      case "key":
        this.host.askForKey(trouble.message);
        break;
      case "stop":
        console.error(trouble.error);
    }
  }

  /** Goes on if the server is ready, with all that waits for it. */
  private async look(part: Part, trouble: Trouble): Promise<void> {
    const isIt = () => this.troubles.get(part) === trouble;
    try {
      await this.host.ready();
    } catch (error) {
      if (isIt()) {
        this.drop(part);
        this.failed(part, error);
      }
      return;
    }
    if (isIt()) {
      const waiting = [...this.troubles].filter(([, { remedy }]) => remedy === "wait");
      waiting.forEach(([each]) => this.resume(each));
    }
  }

  private resume(part: Part): void {
    this.drop(part);
    this.tell();
    this.host.resume(part);
  }

  private drop(part: Part): void {
    const trouble = this.troubles.get(part);
    if (trouble !== undefined) {
      trouble.cancel();
      this.troubles.delete(part);
      this.failures.get(part)!.triedAt = this.clock.now();
    }
  }

  private pause(pauses: Pauses, n: number): number {
    return pauseOf(pauses, n, this.random);
  }

  private tell(): void {
    const worst = PARTS.map((part) => this.troubles.get(part)?.message).find((message) => message !== undefined);
    const said = [worst, ...this.notes.values()].filter((message) => message !== undefined).join(" ") || null;
    if (said !== this.told) {
      this.told = said;
      this.host.tell(said);
    }
  }
}

function askedFor(error: unknown): number {
  return error instanceof Unavailable ? Math.min(1000 * error.retryAfter, ASKED_MAX) : 0;
}
