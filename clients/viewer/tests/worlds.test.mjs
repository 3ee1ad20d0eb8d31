import assert from "node:assert/strict";
import { test } from "node:test";

import { StreamEnded, Unreachable, WorkerFailed } from "chunkserver-client";

import { EditFailed } from "../src/sending.ts";
import { KEPT_MS_MAX } from "../src/showing.ts";
import { Worlds } from "../src/worlds.ts";
import { FakeClock, problem, quiet } from "./fakes.mjs";

const refusal = (status) => problem(status, { title: "no", detail: `because of ${status}` });
const linkOf = (id, position = null) => ({
  source: { kind: "world", id },
  position,
  ahead: null,
  isWalking: false,
  view: "shaded",
});

/** A world that is on the screen, or is not yet. */
class World {
  isPresentable = false;
  isRetired = false;
  isDisposed = false;
  resumed = [];
  prepared = [];
  place = { position: [1, 2, 3], ahead: [0, 0, -1], isWalking: true, view: "shaded" };

  constructor(world, link, troubles) {
    Object.assign(this, { world, link, troubles });
  }

  prepare(leader) {
    this.prepared.push(leader);
  }

  resume(part) {
    this.resumed.push(part);
  }

  retire() {
    this.isRetired = true;
  }

  dispose() {
    this.isDisposed = this.isRetired = true;
  }
}

class Page {
  clock = new FakeClock();
  made = [];
  said = [];
  held = null;
  arrivals = [];
  chosen = [];
  entered = null;
  clients = [];
  wrong = () => null;

  connect() {
    const client = {
      isClosed: false,
      close: () => (client.isClosed = true),
      world: async (id) => {
        const error = this.wrong(id);
        if (error !== null) {
          throw error;
        }
        return { kind: "world", id };
      },
      recipes: async () => {
        const error = this.wrong("recipes");
        if (error !== null) {
          throw error;
        }
        return ["planet"];
      },
      waitUntilReady: async () => {
        const error = this.wrong("ready");
        if (error !== null) {
          throw error;
        }
      },
    };
    this.clients.push(client);
    return client;
  }

  make(_client, world, link, troubles) {
    const made = new World(world, link, troubles);
    this.made.push(made);
    return made;
  }

  arrived(world, link, before) {
    this.arrivals.push([world.world.id, link, before]);
  }

  offer(_recipes, chosen) {
    this.chosen.push(chosen?.id ?? null);
  }

  askForKey(entered) {
    this.entered = entered;
  }

  say(message) {
    this.said.push(message);
  }

  hold(message) {
    this.held = message;
  }
}

async function shown(change = () => {}) {
  const page = new Page();
  change(page);
  const worlds = new Worlds(page, linkOf("one"), page.clock);
  await worlds.start();
  await quiet();
  return { page, worlds, one: page.made[0] };
}

test("the picture of a world stays until there is one of the next, which takes its place in one frame", async () => {
  const { page, worlds, one } = await shown();
  assert.equal(worlds.current, one, "the first one has nothing to wait for");
  assert.ok(!worlds.isOpening);
  const asked = worlds.show(linkOf("two"), true);
  assert.ok(worlds.isOpening);
  await asked;
  const two = page.made[1];
  worlds.update();
  assert.equal(worlds.current, one);
  assert.deepEqual([one.isRetired, one.isDisposed], [true, false]);
  assert.deepEqual(two.prepared, [one], "it follows the viewer");
  assert.deepEqual(page.chosen, ["one"]);
  assert.ok(worlds.isOpening);
  two.isPresentable = true;
  worlds.update();
  assert.equal(worlds.current, two);
  assert.ok(one.isDisposed && !two.isRetired);
  assert.ok(!worlds.isOpening);
  assert.deepEqual(page.chosen, ["one", "two"]);
  assert.deepEqual(page.arrivals.at(-1).slice(2), [one]);
  assert.equal(worlds.source.id, "two");
});

test("a world that does not come takes its place all the same after a while", async () => {
  const { page, worlds, one } = await shown();
  await worlds.show(linkOf("two"));
  const two = page.made[1];
  await page.clock.pass(KEPT_MS_MAX - 1);
  worlds.update();
  assert.equal(worlds.current, one);
  assert.deepEqual(two.prepared, [null], "it is seen from elsewhere");
  await page.clock.pass(2);
  worlds.update();
  assert.equal(worlds.current, two);
});

test("who chooses twice sees what was chosen last, and the other one is left", async () => {
  const { page, worlds, one } = await shown();
  await worlds.show(linkOf("two"));
  await worlds.show(linkOf("three"));
  const [, two, three] = page.made;
  assert.ok(two.isDisposed);
  two.isPresentable = true;
  worlds.update();
  assert.equal(worlds.current, one);
  three.isPresentable = true;
  worlds.update();
  assert.equal(worlds.current, three);
  let answer;
  page.wrong = (id) => (id === "slow" ? assert.fail() : null);
  worlds.client.world = (id) =>
    id === "slow" ? new Promise((resolve) => (answer = resolve)) : Promise.resolve({ kind: "world", id });
  const slow = worlds.show(linkOf("slow"));
  await worlds.show(linkOf("four"));
  answer({ kind: "world", id: "slow" });
  await slow;
  assert.deepEqual(
    page.made.map(({ world }) => world.id),
    ["one", "two", "three", "four"],
  );
});

test("a world that comes when another one is chosen already is shown, and is not what is chosen", async () => {
  const { page, worlds } = await shown();
  await worlds.show(linkOf("two"));
  let answer;
  worlds.client.world = () => new Promise((resolve) => (answer = resolve));
  const third = worlds.show(linkOf("three"), true);
  page.made[1].isPresentable = true;
  worlds.update();
  assert.equal(worlds.current, page.made[1]);
  assert.deepEqual(page.chosen, ["one"]);
  answer({ kind: "world", id: "three" });
  await third;
  page.made[2].isPresentable = true;
  worlds.update();
  assert.deepEqual(page.chosen, ["one", "three"]);
  page.wrong = (id) => (id === "four" ? refusal(422) : null);
  worlds.client = page.connect();
  await worlds.show(linkOf("four"), true);
  assert.deepEqual(page.chosen, ["one", "three"], "who edits a recipe keeps what is written");
  assert.equal(page.said.length, 1);
});

test("a world that is not there is said to be, and the one that is shown goes on", async () => {
  const { page, worlds, one } = await shown();
  page.wrong = (id) => (id === "two" || id === "ready" ? new Unreachable("no answer") : null);
  one.troubles.chunksFailed(new Unreachable("no answer"));
  await worlds.show(linkOf("two"));
  assert.match(page.held, /is away/);
  await page.clock.pass(10_000);
  page.wrong = (id) => (id === "two" ? refusal(404) : null);
  await page.clock.pass(10_000);
  assert.deepEqual(one.resumed, ["chunks"]);
  assert.equal(worlds.current, one);
  assert.ok(!one.isRetired);
  assert.deepEqual(page.said, ["404 no: because of 404"]);
  assert.equal(page.held, null);
  assert.equal(page.chosen.at(-1), "one", "the panel has what is shown");
  assert.ok(!worlds.isOpening);
  one.troubles.failed(refusal(410));
  await page.clock.pass(10);
  assert.deepEqual(page.made[1].link, { ...linkOf("one"), ...one.place }, "it is still that one which is wanted");
});

test("a world that is gone while another one is waited for is not opened anew", async () => {
  const { page, worlds, one } = await shown();
  page.wrong = (id) => (id === "two" || id === "ready" ? new Unreachable("no answer") : null);
  await worlds.show(linkOf("two", [7, 7, 7]));
  one.troubles.failed(refusal(410));
  await page.clock.pass(10_000);
  page.wrong = () => null;
  await page.clock.pass(10_000);
  assert.deepEqual(
    page.made.map(({ link }) => link),
    [linkOf("one"), linkOf("two", [7, 7, 7])],
  );
});

test("a world that is on its way goes on, too, when the next one is not there", async () => {
  const { page, worlds } = await shown();
  await worlds.show(linkOf("two"));
  page.wrong = (id) => (id === "three" ? refusal(404) : null);
  await worlds.show(linkOf("three"));
  assert.deepEqual([page.said, page.held], [["404 no: because of 404"], null]);
  page.made[1].isPresentable = true;
  worlds.update();
  assert.equal(worlds.current.world.id, "two");
  assert.ok(!worlds.isOpening);
});

test("the viewer stays where they are, though it takes more than one attempt to open the world anew", async () => {
  const { page, worlds, one } = await shown();
  page.wrong = () => refusal(503);
  one.troubles.failed(new StreamEnded(4404));
  await page.clock.pass(1_000);
  page.wrong = () => null;
  await page.clock.pass(10_000);
  worlds.update();
  assert.deepEqual(page.made[1].prepared, [one]);
});

test("a world that was gone before there was a picture of it takes no other one's place", async () => {
  const { page, worlds, one } = await shown();
  await worlds.show(linkOf("two"));
  page.wrong = () => refusal(503);
  page.made[1].troubles.failed(new StreamEnded(4404));
  await page.clock.pass(2 * KEPT_MS_MAX, () => worlds.update());
  assert.equal(worlds.current, one);
  page.wrong = () => null;
  await page.clock.pass(10_000);
  page.made[2].isPresentable = true;
  worlds.update();
  assert.equal(worlds.current, page.made[2]);
  assert.ok(one.isDisposed && page.made[1].isDisposed);
});

test("a world that is left is not resumed", async () => {
  const { page, one } = await shown();
  page.wrong = (id) => (id === "one" ? refusal(500) : null);
  one.troubles.chunksFailed(new Unreachable("no answer"));
  one.troubles.failed(new StreamEnded(4404));
  await page.clock.pass(10_000);
  assert.ok(one.isRetired);
  assert.deepEqual(one.resumed, []);
});

test("a world that is not there at the start is said to be, with what there is to choose", async (t) => {
  t.mock.method(console, "error", () => {});
  const { page, worlds } = await shown((it) => (it.wrong = (id) => (id === "one" ? refusal(404) : null)));
  assert.equal(page.held, "404 no: because of 404");
  assert.deepEqual(page.chosen, [null]);
  page.wrong = () => new Unreachable("no answer");
  await worlds.show(linkOf("two"));
  assert.match(page.held, /is away/, "what was wrong before does not count");
  page.wrong = () => null;
  await page.clock.pass(10_000);
  assert.equal(page.held, null);
  assert.equal(worlds.current, page.made[0]);
  assert.equal(worlds.current.world.id, "two");
});

for (const [what, fail] of [
  ["chunks are gone", (world) => world.troubles.chunksFailed(refusal(410))],
  ["stream is over", (world) => world.troubles.failed(new StreamEnded(4404))],
]) {
  test(`a world whose ${what} is shown as it is now, and not in a hot loop`, async () => {
    const { page, worlds, one } = await shown();
    fail(one);
    await page.clock.pass(10, () => worlds.update());
    const two = page.made[1];
    assert.equal(worlds.current, one, "its picture stays");
    assert.ok(one.isRetired);
    assert.deepEqual(two.link, { ...linkOf("one"), ...one.place });
    one.troubles.failed(refusal(410));
    assert.equal(page.made.length, 2, "what is left does not count any more");
    for (let time = 0; time < 6000; time++) {
      if (!page.made.at(-1).isRetired) {
        page.made.at(-1).isPresentable = true;
        worlds.update();
        fail(page.made.at(-1));
      }
      await page.clock.pass(100, () => worlds.update());
    }
    assert.ok(page.made.length > 8 && page.made.length < 24, `${page.made.length} times in ten minutes`);
    assert.notEqual(page.held, null);
  });
}

test("a recipe that the server has forgotten is made known to it again", async () => {
  const page = new Page();
  const recipe = { name: "d1", digest: "d1", expression: { op: "plane" } };
  const known = new Set(["d1"]);
  const connect = page.connect.bind(page);
  page.connect = () =>
    Object.assign(connect(), {
      seed: async (seed, name) => {
        if (!known.has(name)) {
          throw refusal(404);
        }
        return { kind: "seed", seed, recipe };
      },
      worlds: async () => [],
      postRecipe: async (expression) => {
        assert.deepEqual(expression, recipe.expression);
        known.add("d1");
      },
    });
  const link = { ...linkOf(""), source: { kind: "seed", seed: 42n, recipe: "d1" } };
  const worlds = new Worlds(page, link, page.clock);
  await worlds.start();
  known.clear();
  page.made[0].troubles.chunksFailed(refusal(404));
  await page.clock.pass(100);
  assert.equal(page.made.length, 2);
  assert.equal(page.held, null);
  known.clear();
  await worlds.show({ ...link, source: { ...link.source, recipe: "d2" } });
  assert.deepEqual(page.said, ["404 no: because of 404"]);
  assert.equal(known.size, 0);
});

test("a world that cannot be opened anew is said to be so, and its last picture stays", async (t) => {
  t.mock.method(console, "error", () => {});
  const { page, worlds, one } = await shown();
  page.wrong = (id) => (id === "one" ? refusal(404) : null);
  one.troubles.failed(new StreamEnded(4404));
  await page.clock.pass(100);
  assert.equal(page.held, "404 no: because of 404");
  assert.equal(worlds.current, one);
  assert.deepEqual(page.said, []);
});

test("an edit that failed is said, once; what else it means is done", async () => {
  const { page, worlds, one } = await shown();
  worlds.refused(new EditFailed("Your last change is lost.", { cause: refusal(422) }), one);
  assert.deepEqual(page.said, ["Your last change is lost."]);
  assert.equal(page.held, null);
  worlds.refused(new EditFailed("Lost.", { cause: refusal(403) }), one);
  assert.notEqual(page.entered, null);
  worlds.refused(new EditFailed("Lost.", { cause: refusal(404) }), one);
  await page.clock.pass(10);
  assert.equal(page.made.length, 2);
  worlds.refused(new EditFailed("Lost.", { cause: new Unreachable("x") }), page.made[1]);
  assert.ok(!worlds.recovery.isAway, "whoever asks for more says whether the server is away");
});

test("edits of others that come late are said to, once, and why", async () => {
  const { page, one } = await shown();
  one.troubles.late(new StreamEnded(4400));
  assert.match(page.said[0], /a little later.*4400: a message was malformed/);
  one.troubles.late(null);
  assert.equal(page.said.length, 1);
  assert.equal(page.held, null);
});

test("an edit that is sent again is said to be, as long as it is", async () => {
  const { page, one } = await shown();
  one.troubles.delayed(new Unreachable("x"));
  assert.match(page.held, /sent again/);
  one.troubles.delayed(null);
  assert.equal(page.held, null);
});

test("another key makes another client, and the world is opened anew in its place", async () => {
  const { page, worlds, one } = await shown();
  one.troubles.failed(refusal(401));
  assert.equal(page.held, "because of 401");
  page.entered();
  await quiet();
  const [before, now] = page.clients;
  assert.ok(before.isClosed && !now.isClosed);
  assert.equal(worlds.client, now);
  assert.equal(page.held, null);
  assert.deepEqual(page.made[1].link, { ...linkOf("one"), ...one.place });
});

test("a worker that has failed is said to have", async (t) => {
  t.mock.method(console, "error", () => {});
  const { page } = await shown(
    (it) => (it.wrong = () => new WorkerFailed("the worker has failed: it could not be loaded")),
  );
  assert.match(page.held, /Reload the page: the worker has failed/);
  await page.clock.pass(60_000);
  assert.equal(page.made.length, 0);
});
