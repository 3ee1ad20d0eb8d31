import { problem as problemOf } from "../../web/src/errors.ts";

/** A problem of the server's own, unless its type says otherwise. */
export function problem(status, members, retryAfter) {
  return problemOf(status, { type: "urn:chunkserver:problem:some", ...members }, retryAfter);
}

/** A clock that stands still until it is moved on, and what waits for it. */
export class FakeClock {
  time = 0;
  timers = [];

  now() {
    return this.time;
  }

  after(ms, act) {
    const timer = { at: this.time + ms, act };
    this.timers.push(timer);
    return () => (this.timers = this.timers.filter((each) => each !== timer));
  }

  /** Lets time pass. whenever: called after each thing that has happened */
  async pass(ms, whenever = () => {}) {
    const end = this.time + ms;
    await quiet();
    for (;;) {
      const next = this.timers.filter(({ at }) => at <= end).sort((one, other) => one.at - other.at)[0];
      if (next === undefined) {
        break;
      }
      this.timers = this.timers.filter((each) => each !== next);
      this.time = Math.max(next.at, this.time);
      next.act();
      await quiet();
      whenever();
    }
    this.time = end;
    await quiet();
  }
}

/** All that is under way has come as far as it can without time. */
export async function quiet() {
  for (let turn = 0; turn < 4; turn++) {
    await new Promise((resolve) => setImmediate(resolve));
  }
}
