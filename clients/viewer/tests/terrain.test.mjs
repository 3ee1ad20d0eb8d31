import assert from "node:assert/strict";
import { test } from "node:test";

import { Terrain } from "../src/terrain.ts";

const WORLD = { kind: "seed", chunkCells: 32, lods: 4, low: [-4096, -4096, -4096], high: [4096, 4096, 4096] };
const ERRORS = [0.25, 0.5, 1, 2];
const NOWHERE_SOON = [0, 0, 0];

/** A server whose chunks come when `answer` is called. */
class Server {
  asked = [];

  async *chunks(_world, chunks, { signal }) {
    const wanted = [...chunks];
    await new Promise((resolve) => this.asked.push(resolve));
    for (const { coarser, ...key } of wanted) {
      signal.throwIfAborted();
      yield { key, coarser, content: "surface" };
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

  draw(name, mesh) {
    assert.ok(!this.drawn.has(name), `${name} is drawn twice`);
    this.drawn.set(name, mesh.key);
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
  terrain.outdate(null);
  await settle(terrain, server, [300, 16, 16]);
  assert.notDeepEqual(new Set(canvas.drawn.keys()), before);
  assert.deepEqual(canvas.doubled, []);
  assert.equal(canvas.drawn.size, terrain.chunks);
});
