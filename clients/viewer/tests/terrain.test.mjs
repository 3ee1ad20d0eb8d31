import assert from "node:assert/strict";
import { test } from "node:test";

import { Terrain } from "../src/terrain.ts";

const WORLD = { kind: "seed", chunkCells: 32, lods: 4, low: [-4096, -4096, -4096], high: [4096, 4096, 4096] };
const ERRORS = [0.25, 0.5, 1, 2];
const NOWHERE_SOON = [0, 0, 0];

function freed() {
  this.byteLength = 0;
}

const isFree = ({ positions }) => positions.buffer.byteLength === 0;

/** What a mesh holds, of so many bytes each. */
function arraysOf(byteLength) {
  const array = () => ({ byteLength, buffer: { byteLength, transfer: freed } });
  return { positions: array(), normals: array(), indices: array() };
}

/** A server whose chunks come when `answer` is called. */
class Server {
  asked = [];
  meshBytes = 1000;

  async *chunks(_world, chunks, { signal }) {
    const wanted = [...chunks];
    await new Promise((resolve) => this.asked.push(resolve));
    for (const { coarser, ...key } of wanted) {
      signal.throwIfAborted();
      yield { key, coarser, content: "surface", ...arraysOf(this.meshBytes) };
    }
  }

  async answer() {
    this.asked.splice(0).forEach((resolve) => resolve());
    await new Promise((resolve) => setTimeout(resolve));
  }
}

/** What is drawn, by name; nothing twice. */
class Canvas {
  drawn = new Map();
  draws = 0;

  draw(name, mesh) {
    assert.ok(!this.drawn.has(name), `${name} is drawn twice`);
    this.drawn.set(name, mesh.key);
    this.draws += 1;
  }

  remove(name) {
    this.drawn.delete(name);
  }

  /** Names of those that lie within another one, or where another one is. */
  get doubled() {
    const keys = [...this.drawn.values()];
    const isOver = (one, other) =>
      one !== other &&
      one.lod >= other.lod &&
      ["x", "y", "z"].every((axis) => Math.floor(other[axis] / 2 ** (one.lod - other.lod)) === one[axis]);
    return keys.flatMap((one) => keys.filter((other) => isOver(one, other)));
  }
}

async function settle(terrain, server, position) {
  for (let frame = 0; frame < 400; frame++) {
    terrain.update(position, NOWHERE_SOON);
    if (terrain.isSettled) {
      return;
    }
    await server.answer();
  }
  assert.fail("it does not settle");
}

test("a chunk that an edit outdates is not left behind where another level takes its place", async () => {
  const [server, canvas] = [new Server(), new Canvas()];
  const options = { errorPixels: 8, screenPixels: 720, reach: 512 };
  const failed = (error) => assert.fail(error);
  const terrain = new Terrain(server, WORLD, { ...WORLD, geometricErrors: ERRORS }, options, canvas, failed);
  await settle(terrain, server, [16, 16, 16]);
  const before = new Set(canvas.drawn.keys());
  assert.deepEqual(canvas.doubled, []);
  terrain.outdate(null, 1n);
  await settle(terrain, server, [300, 16, 16]);
  assert.notDeepEqual(new Set(canvas.drawn.keys()), before);
  assert.deepEqual(canvas.doubled, []);
  assert.equal(canvas.drawn.size, terrain.chunks);
});

/** The same numbers each time: mulberry32. */
function randomsFrom(seed) {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let mixed = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

/**
 * A world that is edited while its chunks are on their way. A batch has the chunks as they are when it is asked for. Its
 * answers come whenever they like, in any order, also when nobody waits for them any more.
 */
class Edited {
  edits = [];
  held = [];
  asked = 0;
  leastAsked = [];
  made = [];

  constructor(random) {
    this.random = random;
  }

  get revision() {
    return BigInt(this.edits.length);
  }

  /** Of the last edit that may have changed it. */
  revisionOf({ lod, x, y, z }) {
    const within = ({ low, high }) => [x, y, z].every((at, axis) => low[axis] <= at && at <= high[axis]);
    return BigInt(1 + this.edits.findLastIndex((ranges) => ranges.some((range) => range.lod === lod && within(range))));
  }

  /** Somewhere; which chunks it may have changed, on all levels. */
  edit() {
    const [from, to] = [0, 1].map(() => [0, 1, 2].map(() => Math.floor((this.random() - 0.5) * 700)));
    const ranges = [0, 1, 2, 3].map((lod) => ({
      lod,
      low: from.map((at, axis) => Math.floor(Math.min(at, to[axis]) / (32 * 2 ** lod))),
      high: from.map((at, axis) => Math.floor(Math.max(at, to[axis]) / (32 * 2 ** lod))),
    }));
    this.edits.push(ranges);
    return ranges;
  }

  async *chunks(_world, chunks, { minRevision = 0n }) {
    const meshes = [...chunks].map(({ coarser, ...key }) => {
      this.asked += 1;
      return { key, coarser, content: "surface", revision: this.revisionOf(key), ...arraysOf(1000) };
    });
    this.made.push(...meshes);
    this.leastAsked.push([minRevision, this.revision]);
    for (let count = 0; count < meshes.length; count++) {
      await new Promise((resolve) => this.held.push(resolve));
      yield meshes[count];
    }
  }

  /** Lets some answers go. */
  async answer(count) {
    for (let left = count; left > 0 && this.held.length > 0; left--) {
      this.held.splice(Math.floor(this.random() * this.held.length), 1)[0]();
    }
    await new Promise((resolve) => setImmediate(resolve));
  }
}

/** A canvas that nothing is drawn on which is older than what the page was told of. */
class Fresh extends Canvas {
  constructor(world) {
    super();
    this.world = world;
    this.meshes = new Map();
    this.kept = new Set();
  }

  draw(name, mesh) {
    super.draw(name, mesh);
    const told = this.world.revisionOf(mesh.key);
    assert.ok(mesh.revision >= told, `${name} is of ${mesh.revision}, and an edit of ${told} is known`);
    this.meshes.set(name, mesh);
    this.kept.add(mesh);
  }

  remove(name) {
    super.remove(name);
    this.meshes.delete(name);
  }
}

for (const seed of [1, 2, 3, 4, 5, 6]) {
  test(`no chunk from before an edit is drawn behind it, or stays, however late answers come (${seed})`, async () => {
    const random = randomsFrom(seed);
    const world = new Edited(random);
    const canvas = new Fresh(world);
    const options = { errorPixels: 8, screenPixels: 720, reach: 512 };
    const failed = (error) => assert.fail(error);
    const shown = { ...WORLD, kind: "world", geometricErrors: ERRORS };
    const terrain = new Terrain(world, shown, shown, options, canvas, failed);
    let position = [16, 16, 16];
    for (let frame = 0; frame < 1500; frame++) {
      if (random() < 0.02) {
        terrain.outdate(world.edit(), world.revision);
      }
      if (random() < 0.02) {
        position = position.map((at) => at + (random() - 0.5) * 100);
        terrain.selectedAt = -Infinity; // as if time had passed
      }
      terrain.update(position, NOWHERE_SOON);
      assert.deepEqual(canvas.drawn.size, canvas.meshes.size);
      await world.answer(random() < 0.5 ? 0 : Math.floor(random() * 60));
    }
    assert.ok(world.edits.length > 10);
    for (let frame = 0; !terrain.isSettled; frame++) {
      assert.ok(frame < 2000, "it does not settle");
      terrain.update(position, NOWHERE_SOON);
      await world.answer(100);
    }
    for (const [name, { key, revision }] of canvas.meshes) {
      assert.equal(revision, world.revisionOf(key), name);
    }
    assert.deepEqual(canvas.doubled, []);
    const [kept, others] = [true, false].map((isKept) => world.made.filter((mesh) => canvas.kept.has(mesh) === isKept));
    assert.ok(!kept.some(isFree), "what was drawn is left to the canvas");
    assert.ok(others.some(isFree), "what came and was not drawn is freed");
    assert.ok(
      world.leastAsked.every(([least, revision]) => least === revision),
      "the server is told from when on",
    );
  });
}

test("a seed, which has no revisions, is asked for without one", async () => {
  const world = new Edited(randomsFrom(1));
  const options = { errorPixels: 8, screenPixels: 720, reach: 512 };
  const shown = { ...WORLD, geometricErrors: ERRORS };
  const terrain = new Terrain(world, shown, shown, options, new Canvas(), (error) => assert.fail(error));
  terrain.outdate(world.edit(), world.revision);
  for (let frame = 0; frame < 100 && world.leastAsked.length === 0; frame++) {
    terrain.update([16, 16, 16], NOWHERE_SOON);
  }
  assert.deepEqual(world.leastAsked[0], [0n, 1n]);
  terrain.dispose();
});

test("chunks that cannot be had are asked for again when that is wanted, and not before", async () => {
  const [server, canvas] = [new Server(), new Canvas()];
  const options = { errorPixels: 8, screenPixels: 720, reach: 512 };
  const failures = [];
  const failed = (error) => failures.push(error);
  const terrain = new Terrain(server, WORLD, { ...WORLD, geometricErrors: ERRORS }, options, canvas, failed);
  const { chunks } = server;
  let asked = 0;
  server.chunks = async function* () {
    asked += 1;
    throw new Error("too slow");
  };
  for (let frame = 0; frame < 50; frame++) {
    terrain.update([16, 16, 16], NOWHERE_SOON);
    await server.answer();
  }
  assert.equal(failures.length, 1);
  assert.ok(asked <= 2);
  assert.ok(!terrain.isPresentable);
  server.chunks = chunks;
  terrain.resume();
  await settle(terrain, server, [16, 16, 16]);
  assert.ok(terrain.isPresentable);
});

test("another height of the picture is another choice of levels, the same as if it had been so from the start", async () => {
  const names = async (heights) => {
    const [server, canvas] = [new Server(), new Canvas()];
    const options = { errorPixels: 8, screenPixels: heights[0], reach: 512 };
    const failed = (error) => assert.fail(error);
    const terrain = new Terrain(server, WORLD, { ...WORLD, geometricErrors: ERRORS }, options, canvas, failed);
    await settle(terrain, server, [16, 16, 16]);
    for (const height of heights.slice(1)) {
      terrain.resize(height);
      assert.ok(!terrain.isSettled);
      await settle(terrain, server, [16, 16, 16]);
      assert.deepEqual(canvas.doubled, []);
    }
    return new Set(canvas.drawn.keys());
  };
  const [small, large] = [await names([360]), await names([2160])];
  assert.ok(large.size > small.size);
  assert.deepEqual(await names([360, 2160]), large);
  assert.deepEqual(await names([2160, 360]), small);
});

test("what has come at once is drawn step by step over frames, and no frame shows a hole or a chunk twice", async () => {
  const [server, canvas] = [new Server(), new Canvas()];
  const options = { errorPixels: 8, screenPixels: 720, reach: 512 };
  const failed = (error) => assert.fail(error);
  const terrain = new Terrain(server, WORLD, { ...WORLD, geometricErrors: ERRORS }, options, canvas, failed);
  await settle(terrain, server, [16, 16, 16]);
  const volume = () => [...canvas.drawn.values()].reduce((sum, { lod }) => sum + 8 ** lod, 0);
  const [before, full] = [new Set(canvas.drawn.keys()), volume()];
  server.meshBytes = 4_000_000;
  const touches = (one, other) =>
    ["x", "y", "z"].every((axis) => {
      const [low, next] = [one, other].map((key) => key[axis] * 2 ** key.lod);
      return low <= next + 2 ** other.lod && next <= low + 2 ** one.lod;
    });
  const apart = [];
  for (const key of canvas.drawn.values()) {
    if (!apart.some((other) => touches(key, other))) {
      apart.push(key);
    }
  }
  assert.ok(apart.length > 2);
  terrain.outdate(
    apart.map(({ lod, x, y, z }) => ({ lod, low: [x, y, z], high: [x, y, z] })),
    1n,
  );
  const draws = [];
  for (let frame = 0; frame < 400 && !terrain.isSettled; frame++) {
    const was = canvas.draws;
    terrain.update([16, 16, 16], NOWHERE_SOON);
    draws.push(canvas.draws - was);
    assert.equal(volume(), full);
    assert.deepEqual(canvas.doubled, []);
    await server.answer();
  }
  assert.ok(terrain.isSettled);
  assert.deepEqual(new Set(canvas.drawn.keys()), before);
  assert.deepEqual(
    draws.filter((count) => count > 0),
    apart.map(() => 1),
  );
});

test("what is to be swapped is worked out over many frames: none shows a hole, and all of it is shown in the end", async (context) => {
  let clock = performance.now();
  context.mock.method(performance, "now", () => (clock += 2)); // a frame has time for one part
  const [server, canvas] = [new Server(), new Canvas()];
  const box = { low: [-768, -256, -768], high: [768, 256, 768] }; // whole chunks of each level, all within reach
  const options = { errorPixels: 8, screenPixels: 720, reach: 4096, box };
  const failed = (error) => assert.fail(error);
  const terrain = new Terrain(server, WORLD, { ...WORLD, geometricErrors: ERRORS }, options, canvas, failed);
  const volume = () => [...canvas.drawn.values()].reduce((sum, { lod }) => sum + 8 ** lod, 0);
  await settle(terrain, server, [16, 16, 16]);
  const full = volume();
  let idle = 0;
  for (let frame = 0; frame < 600; frame++) {
    const was = canvas.draws;
    terrain.update([16 + Math.min(frame, 200), 16, 16], NOWHERE_SOON);
    idle += canvas.draws === was ? 1 : 0;
    if (frame % 50 === 20) {
      terrain.outdate(null, 0n);
    }
    assert.deepEqual(canvas.doubled, []);
    assert.equal(volume(), full);
    await server.answer();
  }
  await settle(terrain, server, [216, 16, 16]);
  assert.ok(idle > 200);
  assert.deepEqual(new Set(canvas.drawn.keys()), new Set(terrain.selection.chunks.keys()));
});

test("whoever moves sees more of a world that others edit in every frame", async (context) => {
  let clock = performance.now();
  context.mock.method(performance, "now", () => (clock += 2));
  const [server, canvas] = [new Server(), new Canvas()];
  const options = { errorPixels: 8, screenPixels: 720, reach: 512 };
  const failed = (error) => assert.fail(error);
  const terrain = new Terrain(server, WORLD, { ...WORLD, geometricErrors: ERRORS }, options, canvas, failed);
  await settle(terrain, server, [16, 16, 16]);
  const [{ lod, x, y, z }] = canvas.drawn.values();
  const before = canvas.draws;
  for (let frame = 0; frame < 600; frame++) {
    terrain.outdate([{ lod, low: [x, y, z], high: [x, y, z] }], 0n);
    terrain.update([1016, 16, 16], NOWHERE_SOON);
    await server.answer();
  }
  assert.ok(canvas.draws > before + 50, `${canvas.draws - before} chunks were drawn`);
});

test("edits that come faster than chunks leave nothing drawn: it is starved, until they wait", async (context) => {
  let clock = performance.now();
  context.mock.method(performance, "now", () => clock);
  const [server, canvas] = [new Server(), new Canvas()];
  const options = { errorPixels: 8, screenPixels: 720, reach: 512 };
  const failed = (error) => assert.fail(error);
  const terrain = new Terrain(server, WORLD, { ...WORLD, geometricErrors: ERRORS }, options, canvas, failed);
  let edits = 0;
  const live = async (frames, waits) => {
    for (let frame = 0; frame < frames; frame++) {
      clock += 50;
      terrain.update([16, 16, 16], NOWHERE_SOON);
      if (frame % 2 === 1) {
        await server.answer();
      }
      if (!waits || !terrain.isStarved) {
        edits += 1;
        terrain.outdate(null, BigInt(edits));
      }
    }
  };
  await live(19, true);
  assert.ok(!terrain.isStarved);
  await live(40, false);
  assert.equal(canvas.draws, 0);
  assert.ok(terrain.isStarved);
  await live(40, true);
  assert.ok(canvas.draws > 0);
  assert.ok(terrain.isOutdated);
  for (let frame = 0; frame < 400 && !terrain.isSettled; frame++) {
    clock += 50;
    terrain.update([16, 16, 16], NOWHERE_SOON);
    await server.answer();
  }
  assert.ok(terrain.isSettled && !terrain.isOutdated && !terrain.isStarved);
});
