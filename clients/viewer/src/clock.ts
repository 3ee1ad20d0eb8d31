/** Time, as those see it who wait: tests have a clock of their own. Milliseconds. */

export interface Clock {
  now(): number;
  /** Calls `act` after some time, unless what it returns is called before. */
  after(ms: number, act: () => void): () => void;
}

export const CLOCK: Clock = {
  now: () => performance.now(),
  after(ms, act) {
    const timer = setTimeout(act, ms);
    return () => clearTimeout(timer);
  },
};

/** Pauses that double, each up to a quarter shorter than that: whoever lost the same server comes back one by one. */
export interface Pauses {
  /** The first one; the most that one can be. */
  readonly first: number;
  readonly most: number;
}

/** The n-th pause, n from 0. random: from 0 to 1 */
export function pauseOf({ first, most }: Pauses, n: number, random: () => number = Math.random): number {
  return Math.min(first * 2 ** Math.min(n, 30), most) * (1 - random() / 4);
}
