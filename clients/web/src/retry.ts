/** Whether to ask again, and when: exponential backoff with full jitter, bounded in count and in time. */

import { ClientError, Unavailable, Unreachable } from "./errors.js";

/** Of the backoff's doubling: far beyond any `backoffSecondsMax`. */
export const EXPONENT_MAX = 30;

/**
 * How patient a client is. `Retry-After` is honoured: the pause is at least that long. If that is longer than the time
 * that is left, the client gives up at once.
 */
export interface Retry {
  /** How often something is asked for, the first time included; 1 is never again. */
  readonly attemptsMax: number;
  /** For all of them together, and for the pauses. A batch has that long for each chunk that it gains. */
  readonly secondsMax: number;
  /** The n-th pause is random, up to `backoffSeconds * 2**n`. */
  readonly backoffSeconds: number;
  /** And up to this. */
  readonly backoffSecondsMax: number;
}

export const RETRY: Retry = { attemptsMax: 8, secondsMax: 60, backoffSeconds: 0.1, backoffSecondsMax: 5 };

/** @throws {RangeError} for what makes no patience */
export function retryOf(given: Partial<Retry> = {}): Retry {
  const retry = { ...RETRY, ...given };
  const seconds = [retry.secondsMax, retry.backoffSeconds, retry.backoffSecondsMax];
  if (!(retry.attemptsMax >= 1) || !seconds.every((value) => Number.isFinite(value) && value >= 0)) {
    throw new RangeError(`${JSON.stringify(retry)}: at least one attempt, and finite seconds, none below 0`);
  }
  return retry;
}

/** The attempts at one thing: how many there were, and how much time is left. */
export class Trial {
  private failures = 0;
  private deadline = 0;

  /**
   * @param clock seconds
   * @param random from 0 up to 1
   */
  constructor(
    private readonly retry: Retry,
    private readonly clock: () => number = () => performance.now() / 1000,
    private readonly random: () => number = Math.random,
  ) {
    this.renew();
  }

  /** Begins anew: something was gained. */
  renew(): void {
    this.failures = 0;
    this.deadline = this.clock() + this.retry.secondsMax;
  }

  /** Seconds until the deadline; below 0 when it has passed. */
  get secondsLeft(): number {
    return this.deadline - this.clock();
  }

  /**
   * How long to wait after `error`, in seconds.
   *
   * @throws `error` when that was the last attempt: one of the connection as `Unreachable`, with itself as the cause
   */
  pauseAfter(error: unknown): number {
    this.failures += 1;
    const asked = error instanceof Unavailable ? error.retryAfter : 0;
    const pause = asked + backoff(this.retry, this.failures - 1, this.random);
    if (this.failures >= this.retry.attemptsMax || pause >= this.secondsLeft) {
      giveUp(error, this.failures);
    }
    return pause;
  }
}

/** The n-th pause, n from 0, in seconds. */
export function backoff(retry: Retry, n: number, random: () => number): number {
  return random() * Math.min(retry.backoffSecondsMax, retry.backoffSeconds * 2 ** Math.min(n, EXPONENT_MAX));
}

/** Throws what the caller of a call gets for `error`. */
export function giveUp(error: unknown, attempts = 1): never {
  if (error instanceof ClientError) {
    throw error;
  }
  throw new Unreachable(`no whole answer in ${attempts} attempts: ${String(error)}`, { cause: error });
}

/** The seconds of `Retry-After`, a number or a date; 0 if it is missing or neither. now: milliseconds since 1970. */
export function retryAfter(headers: Headers, now: number = Date.now()): number {
  const text = (headers.get("retry-after") ?? "").trim();
  if (/^\d{1,9}$/.test(text)) {
    return Number(text);
  }
  const at = Date.parse(text);
  return Number.isNaN(at) ? 0 : Math.max(0, (at - now) / 1000);
}

/** Resolves after some seconds; rejects with the signal's reason when it is aborted. */
export async function pause(seconds: number, signal: AbortSignal | undefined): Promise<void> {
  signal?.throwIfAborted();
  await new Promise<void>((resolve, reject) => {
    const stop = () => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, 1000 * seconds);
    signal?.addEventListener("abort", stop, { once: true });
  });
}
