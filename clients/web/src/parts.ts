/** Work in parts of a fraction of a millisecond each, for a thread that has other things to do in between. */

/** Yields between two parts, and returns what comes of all. */
export type Parts<Result> = Generator<undefined, Result, undefined>;

/** Does all parts, one after the other. */
export function inOne<Result>(parts: Parts<Result>): Result {
  for (;;) {
    const part = parts.next();
    if (part.done === true) {
      return part.value;
    }
  }
}
