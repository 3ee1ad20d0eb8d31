/**
 * Answers that were given before: kept as long as there is room, and used only if they are still right.
 *
 * An entry is found by its URL and its `Accept`. It is used without asking while its `Cache-Control` allows that; after
 * that its tag goes into `If-None-Match`, and a 304 has to name the same tag. What is kept are the bytes as they came,
 * with their coding: what is made of them belongs to the caller, who may transfer it.
 */

import type { Answer } from "./exchange.js";
import type { Request } from "./questions.js";

/** Counted for the head of each entry, so that a cache of empty chunks is bounded as well. */
const ENTRY_BYTES = 1 << 10;
const MAX_AGE = /\bmax-age=(\d{1,10})(?:\s*,|\s*$)/;

/** A kept answer. */
export interface Entry {
  readonly answer: Answer;
  /** The entity tag as the header has it, with its quotes. */
  readonly tag: string;
  /** Milliseconds of the cache's clock; until then it is used without asking. */
  readonly freshUntil: number;
}

/** At most `bytesMax` bytes of answers; the least recently used goes first. */
export class AnswerCache {
  /** How much it holds by now. */
  bytes = 0;
  /** A map keeps the order of insertion: the first is the least recently used. */
  private readonly entries = new Map<string, Entry & { readonly url: string }>();

  /** @param clock milliseconds */
  constructor(
    readonly bytesMax: number,
    private readonly clock: () => number = () => performance.now(),
  ) {}

  /** What was answered to `request`; it may be out of date. */
  find(request: Request): Entry | null {
    const name = nameOf(request);
    const entry = this.entries.get(name);
    if (entry === undefined) {
      return null;
    }
    this.entries.delete(name);
    this.entries.set(name, entry);
    return entry;
  }

  /** Whether `entry` may be used without asking. */
  isFresh(entry: Entry): boolean {
    return this.clock() < entry.freshUntil;
  }

  /** Keeps an answer, if it has a strong tag and does not forbid it; what is there already is replaced. */
  keep(request: Request, answer: Answer): void {
    this.drop(request);
    const control = answer.headers.get("cache-control") ?? "";
    const tag = answer.headers.get("etag") ?? "";
    if (control.includes("no-store") || !tag.startsWith('"') || bytesOf(answer) > this.bytesMax) {
      return;
    }
    this.entries.set(nameOf(request), {
      answer,
      tag,
      freshUntil: this.clock() + 1000 * freshSeconds(control),
      url: request.url,
    });
    this.bytes += bytesOf(answer);
    for (const name of this.entries.keys()) {
      if (this.bytes <= this.bytesMax) {
        return;
      }
      this.remove(name);
    }
  }

  /** Forgets what was answered to `request`. */
  drop(request: Request): void {
    this.remove(nameOf(request));
  }

  /** Forgets the answers for which `isOld`, given their URL and themselves, is true. */
  dropWhere(isOld: (url: string, answer: Answer) => boolean): void {
    for (const [name, { url, answer }] of this.entries) {
      if (isOld(url, answer)) {
        this.remove(name);
      }
    }
  }

  private remove(name: string): void {
    const removed = this.entries.get(name);
    if (removed !== undefined) {
      this.entries.delete(name);
      this.bytes -= bytesOf(removed.answer);
    }
  }
}

function nameOf({ url, headers }: Request): string {
  return `${headers["accept"] ?? ""} ${url}`;
}

function bytesOf(answer: Answer): number {
  return ENTRY_BYTES + answer.content.length;
}

/** The seconds of `max-age`; 0 with `no-cache`, or without any. */
function freshSeconds(control: string): number {
  const found = MAX_AGE.exec(control);
  return found === null || control.includes("no-cache") ? 0 : Number(found[1]);
}
