import assert from "node:assert/strict";
import { test } from "node:test";

import {
  BadAnswer,
  BadChunk,
  ClientError,
  Conflict,
  EditLost,
  StreamEnded,
  Unreachable,
  WorkerFailed,
} from "chunkserver-client";

import { isOpen, verdictOn } from "../src/failures.ts";
import { PARTS, Recovery } from "../src/recovery.ts";
import { FakeClock, problem } from "./fakes.mjs";

const PREFIX = "urn:chunkserver:problem:";
const busy = (name, detail = "", retryAfter = 0) =>
  problem(503, { type: `${PREFIX}${name}`, title: "busy", detail }, retryAfter);
const refusal = (status) => problem(status, { title: "no", detail: `because of ${status}` });

/** A page whose parts fail, as often as they are tried, as `wrong` says. */
class Page {
  clock = new FakeClock();
  said = null;
  told = [];
  tried = [];
  keys = 0;
  notReady = null;
  wrong = () => null;
  recovery = new Recovery(
    {
      ready: async () => {
        if (this.notReady !== null) {
          throw this.notReady;
        }
      },
      resume: (part) => this.try(part),
      reopen: () => this.try("reopen"),
      askForKey: () => (this.keys += 1),
      tell: (message) => {
        this.said = message;
        this.told.push(message);
      },
    },
    this.clock,
    () => 0,
  );

  try(part) {
    this.tried.push([part, this.clock.time]);
    const error = this.wrong();
    if (error !== null) {
      this.recovery.failed(part === "reopen" ? "chunks" : part, error);
    }
  }

  get pauses() {
    return this.tried.map(([, at], number) => at - (number ? this.tried[number - 1][1] : 0));
  }
}

test("every error has its row, and what is no error of the client's is no server that is away", () => {
  const rows = [
    [new WorkerFailed("x"), "stop", "stop"],
    [new Unreachable("x"), "wait", "wait"],
    [busy("overloaded"), "wait", "wait"],
    [refusal(429), "wait", "wait"],
    [refusal(502), "wait", "wait"],
    [refusal(401), "key", "key"],
    [refusal(403), "key", "key"],
    [new StreamEnded(4401), "key", "key"],
    [new StreamEnded(4403), "key", "key"],
    [refusal(410), "reopen", "retry"],
    [refusal(404), "reopen", "stop"],
    [problem(404, { type: "", title: "no problem+json", detail: "default backend" }), "retry", "retry"],
    [new StreamEnded(4404), "reopen", "reopen"],
    [new StreamEnded(4404, { cause: refusal(404) }), "reopen", "stop"],
    [new StreamEnded(4409, { cause: refusal(409) }), "retry", "stop"],
    [new Conflict(409, {}), "retry", "stop"],
    [refusal(422), "retry", "stop"],
    [refusal(400), "retry", "stop"],
    [new BadAnswer("x"), "retry", "retry"],
    [new BadChunk("x"), "retry", "retry"],
    [refusal(500), "retry", "retry"],
    [refusal(507), "retry", "retry"],
    [refusal(408), "retry", "retry"],
    [new EditLost(1, "x"), "retry", "retry"],
    [new ClientError("x"), "retry", "retry"],
    ...[1009, 1011, 4400, 4409, 4412, 4422].map((code) => [new StreamEnded(code), "retry", "retry"]),
    [new TypeError("x is undefined"), "stop", "stop"],
    [new RangeError("x"), "stop", "stop"],
    ["not even an error", "stop", "stop"],
  ];
  for (const [error, remedy, opening] of rows) {
    assert.equal(verdictOn(error).remedy, remedy, String(error));
    assert.equal(verdictOn(error, true).remedy, opening, String(error));
    assert.ok(verdictOn(error).message.length > 3);
  }
});

test("what may have been written, and may be sent again", () => {
  assert.ok([new Unreachable("x"), new BadAnswer("x"), busy("overloaded"), refusal(500), refusal(504)].every(isOpen));
  assert.ok(![400, 401, 404, 409, 410, 422, 507].map(refusal).some(isOpen));
  assert.ok(![new TypeError("x"), new WorkerFailed("x")].some(isOpen));
});

test("a 503 says why", () => {
  const said = (...args) => verdictOn(busy(...args)).message;
  assert.match(said("unavailable", "the workers are not ready: kernels are being compiled or loaded"), /is starting/);
  assert.match(said("unavailable", "the server is stopping"), /is stopping/);
  assert.match(said("overloaded"), /too much to do/);
  assert.match(said("too-many-connections"), /too much to do/);
  assert.match(said("deadline-passed"), /too long/);
  assert.match(said("worker-lost"), /failed to build/);
  assert.match(verdictOn(refusal(502)).message, /cannot be reached/);
});

for (const [what, error] of [
  ["a batch that cannot be read", new BadAnswer("the batch came too slowly")],
  ["a fault of the server", refusal(500)],
]) {
  test(`${what} is asked for again, after pauses that grow to a minute`, async () => {
    const page = new Page();
    page.wrong = () => error;
    page.recovery.failed("chunks", error);
    assert.match(page.said, /tried again/);
    await page.clock.pass(600_000);
    assert.deepEqual(
      page.pauses.slice(0, 8),
      [1, 2, 4, 8, 16, 32, 60, 60].map((seconds) => 1000 * seconds),
    );
    assert.ok(page.tried.length < 20);
    page.wrong = () => null;
    await page.clock.pass(60_000);
    assert.equal(page.said, null);
    assert.ok(!page.recovery.isAway);
    assert.deepEqual(page.clock.timers, []);
  });
}

for (const [what, error] of [
  ["gone", refusal(410)],
  ["not there", refusal(404)],
  ["ended", new StreamEnded(4404)],
]) {
  test(`a world that is always ${what} is opened anew at once, and then ever more rarely`, async () => {
    const page = new Page();
    page.wrong = () => error;
    page.recovery.failed("chunks", error);
    await page.clock.pass(600_000);
    assert.deepEqual(
      page.pauses.slice(0, 8),
      [0, 1, 2, 4, 8, 16, 32, 60].map((seconds) => 1000 * seconds),
    );
    assert.ok(page.tried.every(([part]) => part === "reopen"));
    assert.ok(page.tried.length < 20);
  });
}

test("a server that is away is waited for, and everything that waits goes on at once", async () => {
  const page = new Page();
  page.notReady = new Unreachable("no answer");
  page.recovery.failed("chunks", page.notReady);
  await page.clock.pass(300);
  page.recovery.failed("edits", page.notReady);
  assert.ok(page.recovery.isAway);
  assert.match(page.said, /is away/);
  await page.clock.pass(30_000);
  assert.deepEqual(page.tried, []);
  page.notReady = busy("unavailable", "kernels are being compiled");
  await page.clock.pass(5_000);
  assert.match(page.said, /is starting/);
  page.notReady = null;
  await page.clock.pass(5_000);
  assert.deepEqual(page.tried.map(([part]) => part).sort(), ["chunks", "edits"]);
  assert.equal(page.tried[0][1], page.tried[1][1]);
  assert.ok(!page.recovery.isAway);
  assert.equal(page.said, null);
});

test("a server that is ready and has too much to do is not asked in a hot loop, nor before it wants to be", async () => {
  const page = new Page();
  page.wrong = () => busy("overloaded");
  page.recovery.failed("chunks", busy("overloaded"));
  await page.clock.pass(60_000);
  assert.ok(page.tried.length > 5 && page.tried.length < 20, `${page.tried.length}`);
  assert.match(page.said, /too much to do/);
  const patient = new Page();
  patient.recovery.failed("chunks", busy("overloaded", "", 20));
  await patient.clock.pass(19_000);
  assert.deepEqual(patient.tried, []);
  await patient.clock.pass(2_000);
  assert.deepEqual(patient.tried, [["chunks", 20_000]]);
});

test("what was well for a minute begins with a short pause again", async () => {
  const page = new Page();
  for (const pause of [1000, 2000, 4000]) {
    page.recovery.failed("chunks", new BadAnswer("x"));
    await page.clock.pass(pause - 1);
    assert.notEqual(page.said, null);
    await page.clock.pass(1);
    assert.equal(page.said, null);
  }
  await page.clock.pass(61_000);
  page.recovery.failed("chunks", new BadAnswer("x"));
  await page.clock.pass(1000);
  assert.equal(page.said, null);
});

test("a fault of the page is said, and stops", async (t) => {
  const noted = t.mock.method(console, "error", () => {});
  const page = new Page();
  page.recovery.failed("chunks", new TypeError("x is not a function"));
  assert.match(page.said, /fault.*x is not a function/);
  assert.ok(!page.recovery.isAway);
  await page.clock.pass(600_000);
  assert.deepEqual(page.tried, []);
  assert.equal(noted.mock.callCount(), 1);
  page.recovery.failed("edits", new WorkerFailed("the worker has failed"));
  page.recovery.forget("chunks");
  assert.match(page.said, /Reload the page: the worker has failed/);
});

test("a key is asked for, and nothing is tried without it", async () => {
  const page = new Page();
  page.recovery.failed("edits", refusal(401));
  await page.clock.pass(600_000);
  assert.equal(page.keys, 1);
  assert.deepEqual(page.tried, []);
  assert.equal(page.said, "because of 401");
  page.recovery.forget();
  assert.equal(page.said, null);
});

test("the worst is said first, a note behind it, and nothing twice", () => {
  const page = new Page();
  page.recovery.failed("edits", refusal(401));
  page.recovery.failed("world", refusal(500));
  page.recovery.note("own", "And that.");
  page.recovery.note("own", "And that.");
  assert.equal(page.said, "500 no: because of 500. It is tried again by itself. And that.");
  assert.equal(page.told.length, 3);
  page.recovery.forget();
  assert.equal(page.said, "And that.");
  page.recovery.note("own", null);
  assert.equal(page.said, null);
  assert.deepEqual(page.clock.timers, []);
  assert.deepEqual(PARTS[0], "page");
});
