import assert from "node:assert/strict";
import { test } from "node:test";

import { BadRequest, StreamEnded, Unreachable } from "chunkserver-client";

import { Following } from "../src/following.ts";
import { EditFailed } from "../src/sending.ts";
import { FakeClock, problem, quiet } from "./fakes.mjs";

const SEED = {
  kind: "seed",
  seed: 42n,
  lods: 4,
  voxelSize: 1,
  chunkCells: 32,
  recipe: { name: "planet", digest: "d" },
};
const ID = "viewer-planet-42";
const STROKES = [{ op: "carve" }];
const refusal = (status) => problem(status, { title: "no", detail: `because of ${status}` });

/** A server with one world, its log, and streams that tell of it, as far as they are let through. */
class Server {
  log = [];
  keys = new Map();
  epoch = "one";
  isThere = true;
  wrong = () => null;
  asked = [];
  streams = [];
  opens = 0;
  streamError = null;

  get revision() {
    return BigInt(this.log.length);
  }

  check(call) {
    this.asked.push(call);
    const error = this.wrong(call);
    if (error !== null) {
      throw error;
    }
  }

  async world() {
    this.check("world");
    if (!this.isThere) {
      throw refusal(404);
    }
    return { ...SEED, kind: "world", id: ID, epoch: this.epoch, revision: this.revision };
  }

  async worlds() {
    this.check("worlds");
    return this.isThere ? [{ id: ID }] : [];
  }

  async createWorld() {
    this.check("createWorld");
    this.isThere = true;
    return this.world();
  }

  async edit(_world, _strokes, key) {
    this.check("edit");
    const revision = this.keys.get(key);
    return { ...(revision ?? this.write(key)), duplicate: revision !== undefined };
  }

  async *edits(_world, after) {
    this.check("edits");
    yield* this.log.slice(Number(after));
  }

  /** Somebody writes an edit, of which all streams tell at once. */
  write(key = null) {
    const edit = { revision: this.revision + 1n, stale: [{ lod: 0, low: [0, 0, 0], high: [0, 0, 0] }] };
    this.log.push(edit);
    this.keys.set(key, edit);
    this.streams.forEach((stream) => stream.tell({ kind: "edits", edits: [edit], ...edit }));
    return edit;
  }

  open = async () => {
    this.opens += 1;
    if (this.streamError !== null) {
      throw this.streamError;
    }
    const stream = new Stream(this);
    this.streams.push(stream);
    return stream;
  };
}

class Stream {
  isLive = true;
  isClosed = false;
  ended = null;
  events = [];

  constructor(server) {
    this.server = server;
    this.revision = server.revision;
  }

  tell(event) {
    if (this.isLive && !this.isClosed) {
      this.events.push(event);
    }
  }

  poll() {
    if (this.ended !== null) {
      throw this.ended;
    }
    const events = this.events.splice(0);
    this.revision = events.at(-1)?.revision ?? this.revision;
    return events;
  }

  close() {
    this.isClosed = true;
  }
}

/** A page that follows a world, a frame each 100 ms. */
class Page {
  clock = new FakeClock();
  server = new Server();
  outdated = [];
  worlds = [];
  failures = [];
  late = [];
  delayed = [];
  isHidden = false;
  isStarved = false;

  begin(world) {
    const page = this;
    const terrain = {
      get isStarved() {
        return page.isStarved;
      },
      outdate: (stale, revision) => this.outdated.push(stale === null ? null : Number(revision)),
      setWorld: (made) => this.worlds.push(made.id),
    };
    const reports = {
      failed: (error) => this.failures.push(error),
      late: (error) => this.late.push(error),
      delayed: (error) => this.delayed.push(error),
    };
    const around = { clock: this.clock, isHidden: () => this.isHidden, open: this.server.open };
    this.following = new Following(this.server, world, terrain, reports, around);
    return this.following;
  }

  async pass(ms) {
    for (let frame = 0; frame < ms / 100; frame++) {
      this.following.update();
      await this.clock.pass(100);
    }
  }

  get stream() {
    return this.server.streams.at(-1);
  }
}

async function following(change = () => {}) {
  const page = new Page();
  change(page);
  page.begin(await page.server.world());
  page.server.asked.length = 0;
  await page.pass(200);
  return page;
}

test("what others do is heard by the stream alone, as long as there is one", async () => {
  const page = await following();
  page.server.write();
  await page.pass(10_000);
  assert.deepEqual(page.outdated, [1]);
  assert.equal(page.following.revision, 1n);
  assert.equal(page.server.opens, 1);
  assert.ok(!page.server.asked.includes("world"));
  assert.ok(page.following.isLive);
});

for (const code of [1009, 4400, 4409, 4412, 4422]) {
  test(`streams that always end with ${code} are opened ever more rarely, and edits come all the same`, async () => {
    const page = await following(({ server }) => (server.streamError = new StreamEnded(code)));
    page.server.write();
    await page.pass(3_000);
    assert.deepEqual(page.outdated, [1]);
    assert.equal(page.late.length, 1, "people are told once");
    assert.match(page.late[0].message, new RegExp(`${code}`));
    await page.pass(600_000);
    assert.ok(page.server.opens > 8 && page.server.opens < 24, `${page.server.opens} streams`);
    assert.deepEqual(page.failures, [], "the world is not opened anew");
    page.server.streamError = null;
    await page.pass(62_000);
    assert.ok(page.following.isLive);
    assert.deepEqual(page.late.slice(1), [null]);
  });
}

test("a stream that ends as soon as it is open is opened ever more rarely, too", async () => {
  const page = await following();
  for (let frame = 0; frame < 3_000; frame++) {
    page.stream.ended = new StreamEnded(4400);
    await page.pass(100);
  }
  assert.ok(page.server.opens > 5 && page.server.opens < 20, `${page.server.opens} streams`);
});

test("a stream that lasted is opened anew at once", async () => {
  const page = await following();
  for (let time = 0; time < 5; time++) {
    await page.pass(70_000);
    page.stream.ended = new StreamEnded(1011);
    await page.pass(3_000);
    assert.ok(page.following.isLive);
  }
  assert.deepEqual(page.late, []);
});

test("without WebSockets the server is not away: edits of others are asked for", async () => {
  const page = await following(({ server }) => (server.streamError = new Unreachable("no welcome")));
  await page.pass(20_000);
  assert.deepEqual(page.failures, []);
  assert.match(page.late[0].message, /no welcome/);
  page.server.write();
  page.server.write();
  await page.pass(2_000);
  assert.deepEqual(page.outdated, [1, 2]);
  assert.equal(page.following.revision, 2n);
  const before = page.server.asked.length;
  await page.pass(60_000);
  assert.ok(page.server.asked.length - before < 60, "and not all the time");
  page.isHidden = true;
  await page.pass(2_000);
  const hidden = page.server.asked.length;
  await page.pass(60_000);
  assert.equal(page.server.asked.length, hidden, "nobody looks");
});

test("a stream that falls silent is left: either the server is away, or what it does not tell is asked for", async () => {
  const page = await following();
  page.stream.isLive = false;
  page.server.write();
  page.server.streamError = new Unreachable("no welcome");
  await page.pass(4_000);
  assert.deepEqual(page.failures, []);
  assert.deepEqual(page.outdated, [1]);
  assert.ok(page.server.streams[0].isClosed);
  const gone = await following();
  gone.stream.isLive = false;
  gone.server.streamError = new Unreachable("no welcome");
  gone.server.wrong = () => new Unreachable("no answer");
  await gone.pass(4_000);
  assert.equal(gone.failures.length, 1);
  assert.ok(gone.failures[0] instanceof Unreachable);
  const asked = gone.server.asked.length;
  await gone.pass(60_000);
  assert.equal(gone.server.asked.length, asked, "until it is resumed");
  gone.server.streamError = null;
  gone.server.wrong = () => null;
  gone.server.write();
  gone.following.resume();
  await gone.pass(2_000);
  assert.ok(gone.following.isLive);
  assert.deepEqual(gone.outdated, [1]);
  assert.deepEqual(gone.late, []);
});

test("a world that is another one by now is one that has failed", async () => {
  const restored = await following(({ server }) => (server.streamError = new StreamEnded(4400)));
  restored.server.epoch = "two";
  await restored.pass(3_000);
  assert.equal(restored.failures[0].code, 4404);
  const begun = await following();
  begun.stream.tell({ kind: "start over" });
  await begun.pass(200);
  assert.equal(begun.failures[0].code, 4404);
  const kept = await following(({ server }) => (server.streamError = new StreamEnded(4403)));
  await kept.pass(60_000);
  assert.equal(kept.failures.length, 1);
  assert.equal(kept.server.opens, 1);
});

test("own edits are drawn once, though the stream tells of them, before or after their answer", async () => {
  const page = await following();
  await page.following.edit(STROKES);
  assert.deepEqual(page.outdated, [1]);
  assert.equal(page.following.revision, 1n);
  await page.pass(1_000);
  assert.deepEqual(page.outdated, [1]);
  const { edit } = page.server;
  page.server.edit = async (...args) => {
    const written = await edit.apply(page.server, args);
    page.following.update();
    return written;
  };
  await page.following.edit(STROKES);
  await page.pass(1_000);
  assert.deepEqual(page.outdated, [1, 2]);
  page.server.write();
  await page.pass(1_000);
  assert.deepEqual(page.outdated, [1, 2, 3]);
});

test("own edits are drawn once, though the log that is read has them", async () => {
  const page = await following(({ server }) => (server.streamError = new StreamEnded(4400)));
  await page.following.edit(STROKES);
  page.server.write();
  await page.pass(4_000);
  assert.deepEqual(page.outdated, [1, 2]);
});

test("a stream that cannot be opened while nothing is heard at all counts for nothing", async () => {
  const page = await following();
  let refuse;
  page.server.open = page.following.around.open = () => new Promise((_, reject) => (refuse = reject));
  page.stream.ended = new StreamEnded(1011);
  await page.pass(1_000);
  page.server.wrong = () => new Unreachable("no answer");
  await page.pass(4_000);
  assert.equal(page.failures.length, 1);
  const asked = page.server.asked.length;
  refuse(new Unreachable("no welcome"));
  await page.pass(10_000);
  assert.equal(page.server.asked.length, asked);
  assert.deepEqual(page.clock.timers, []);
});

test("own edits and those of others in one message are drawn anew", async () => {
  const page = await following();
  page.stream.tell = () => {};
  await page.following.edit(STROKES);
  const [own, other] = [page.server.log[0], page.server.write()];
  delete page.stream.tell;
  page.stream.tell({ ...other, kind: "edits", edits: [own, other] });
  await page.pass(200);
  assert.deepEqual(page.outdated, [1, 2]);
});

test("an edit whose answer is lost is sent again under its key, and written once", async () => {
  const page = await following();
  const { edit } = page.server;
  const keys = [];
  page.server.edit = async (...args) => {
    const written = await edit.apply(page.server, args);
    keys.push(args[2]);
    if (keys.length < 4) {
      throw [new Unreachable("lost"), refusal(504), refusal(503)][keys.length - 1];
    }
    return written;
  };
  let isThrough = false;
  void page.following.edit(STROKES).then(() => (isThrough = true));
  await quiet();
  assert.equal(page.delayed.length, 1, "people are told");
  await page.pass(10_000);
  assert.ok(isThrough);
  assert.equal(keys.length, 4);
  assert.equal(new Set(keys).size, 1);
  assert.equal(page.server.log.length, 1);
  assert.deepEqual(page.outdated, [1]);
  assert.equal(page.delayed.at(-1), null);
});

for (const status of [400, 409, 422, 507]) {
  test(`an edit that is refused with ${status} is said to be lost, and sent once`, async () => {
    const page = await following();
    page.server.wrong = (call) => (call === "edit" ? refusal(status) : null);
    const isLost = (error) => error instanceof EditFailed && /lost.*because of/.test(error.message);
    await assert.rejects(page.following.edit(STROKES), isLost);
    assert.equal(page.server.asked.filter((call) => call === "edit").length, 1);
    assert.deepEqual(page.delayed, []);
    assert.deepEqual(page.outdated, []);
  });
}

test("an edit is given up after a while, or when its world is left: nobody knows what became of it", async () => {
  const page = await following();
  page.server.wrong = (call) => (call === "edit" ? new Unreachable("lost") : null);
  const isUnknown = (error) => error instanceof EditFailed && /Nobody knows/.test(error.message);
  const lost = assert.rejects(page.following.edit(STROKES), isUnknown);
  await page.clock.pass(700_000);
  await lost;
  assert.ok(page.server.asked.filter((call) => call === "edit").length < 200);
  assert.equal(page.delayed.at(-1), null);
  const left = assert.rejects(page.following.edit(STROKES), isUnknown);
  await quiet();
  page.following.stop();
  await left;
  assert.ok(page.stream.isClosed);
  assert.deepEqual(
    page.clock.timers.map(({ at }) => at > page.clock.time),
    [],
  );
});

test("a key that has gone meanwhile leaves open what became of an edit", async () => {
  const page = await following();
  let sent = 0;
  page.server.wrong = (call) => (call === "edit" ? (sent++ ? refusal(401) : new Unreachable("lost")) : null);
  const lost = assert.rejects(
    page.following.edit(STROKES),
    (error) => /Nobody knows/.test(error.message) && error.cause.status === 401,
  );
  await page.clock.pass(5_000);
  await lost;
});

test("a seed is asked whether somebody has dug; from then on there is a stream, and the log from its beginning", async () => {
  const page = new Page();
  page.server.isThere = false;
  page.begin(SEED);
  await page.pass(4_000);
  assert.deepEqual([page.server.opens, page.worlds], [0, []]);
  page.server.isThere = true;
  page.server.write();
  await page.pass(2_000);
  assert.deepEqual(page.worlds, [ID]);
  assert.deepEqual(page.outdated, [1]);
  assert.ok(page.following.isLive);
  page.server.wrong = () => refusal(503);
  await page.pass(60_000);
  assert.deepEqual(page.failures, []);
});

test("whether there is a world is an answer, not whatever comes instead", async () => {
  for (const error of [refusal(500), refusal(503), new Unreachable("slow"), refusal(401)]) {
    const page = new Page();
    page.server.wrong = () => error;
    page.begin(SEED);
    await page.pass(1_000);
    assert.deepEqual(page.failures, [error]);
  }
});

test("a world of another generator has the name: the seed is shown without edits", async () => {
  const page = new Page();
  page.server.wrong = (call) => (call === "world" ? refusal(409) : null);
  page.begin(SEED);
  await page.pass(4_000);
  assert.deepEqual([page.failures, page.worlds, page.server.opens], [[], [], 0]);
});

test("the first dig in a seed makes its world, and is sent again until both are there", async () => {
  const page = new Page();
  page.server.isThere = false;
  page.begin(SEED);
  let creations = 0;
  page.server.wrong = (call) => (call === "createWorld" && creations++ < 2 ? refusal(503) : null);
  const dug = page.following.edit(STROKES);
  await page.pass(5_000);
  await dug;
  assert.deepEqual([creations, page.server.log.length], [3, 1]);
  assert.deepEqual(page.outdated, [1]);
  assert.deepEqual(page.worlds, [ID]);
});

test("a log that does not go back that far means that anything may have changed", async () => {
  const page = new Page();
  const world = await page.server.world();
  page.server.write();
  page.server.wrong = (call) => (call === "edits" ? new BadRequest(422, { title: "no" }) : null);
  page.begin(world);
  await page.pass(5_000);
  assert.deepEqual(page.outdated, [null]);
  assert.ok(page.following.isLive);
});

test("what the log no longer has is drawn anew once, not at every look", async () => {
  const page = await following(({ server }) => (server.streamError = new StreamEnded(4400)));
  page.server.wrong = (call) => (call === "edits" ? new BadRequest(422, { title: "no" }) : null);
  page.server.write();
  await page.pass(20_000);
  assert.deepEqual(page.outdated, [null]);
  assert.equal(page.following.revision, 1n);
  page.server.write();
  await page.pass(20_000);
  assert.deepEqual(page.outdated, [null, null]);
});

test("who has missed very much does not read all of it", async () => {
  const page = await following(({ server }) => (server.streamError = new StreamEnded(4400)));
  for (let edit = 0; edit < 1001; edit++) {
    page.server.write();
  }
  await page.pass(4_000);
  assert.deepEqual(page.outdated, [null]);
  assert.equal(page.following.revision, 1001n);
  assert.ok(!page.server.asked.includes("edits"));
});

test("where nothing can be drawn for all the edits of others, they wait a little", async () => {
  const page = await following();
  page.isStarved = true;
  page.server.write();
  await page.pass(1_900);
  assert.deepEqual(page.outdated, []);
  assert.equal(page.following.revision, 0n);
  assert.ok(page.following.isLive);
  page.isStarved = false;
  page.server.write();
  await page.pass(100);
  assert.deepEqual(page.outdated, [1, 2]);
  page.isStarved = true;
  page.server.write();
  await page.pass(2_300);
  assert.deepEqual(page.outdated, [1, 2, 3], "and not for ever");
  assert.deepEqual([page.failures, page.late], [[], []]);
});
