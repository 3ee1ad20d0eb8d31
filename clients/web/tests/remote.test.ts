/** A client on the other side of a port: the same answers, buffers that are moved, errors of the same classes. */

import assert from "node:assert/strict";
import { after, test } from "node:test";
import { MessageChannel } from "node:worker_threads";

import { Client } from "../src/client.js";
import type { WorldDescriptor } from "../src/descriptors.js";
import { BadRequest, NotFound, Unreachable, WorkerFailed } from "../src/errors.js";
import type { ChunkKey } from "../src/mesh.js";
import { serve, type Port } from "../src/remote.js";
import { WorkerClient } from "../src/worker_client.js";
import { given } from "./pages.js";

const URL_GIVEN = given("CHUNKSERVER_URL");
const { port1, port2 } = new MessageChannel();
const moved = new Set<object>();
serve({
  addEventListener: (type, listener) => port2.addEventListener(type, listener as never),
  postMessage(message, transfer) {
    transfer.forEach((buffer) => moved.add(buffer));
    port2.postMessage(message, transfer as never);
  },
});
const client = new WorkerClient(URL_GIVEN, { retry: { attemptsMax: 2, backoffSeconds: 0 } }, port1 as unknown as Port);
after(() => port1.close());
const WORLD = { id: "nowhere" } as unknown as WorldDescriptor;

test("it answers what the client answers", async () => {
  const [here, there] = [new Client(URL_GIVEN), client];
  const world = await there.seed(42, "planet");
  assert.deepEqual(world, await here.seed(42, "planet"));
  const key = { lod: 0, x: 0, y: 6, z: 0 };
  const mesh = await there.chunk(world, key);
  assert.deepEqual(mesh, await here.chunk(world, key));
  assert.equal(mesh.positions.buffer, mesh.indices.buffer);
  assert.equal(moved.size, 1, "its one buffer is moved, not copied");
  assert.deepEqual(await there.chunk(world, key), mesh, "what is in the cache has not gone with it");
});

test("many chunks come, more than are sent ahead", async () => {
  const world = await client.seed(42, "sphere");
  const keys: ChunkKey[] = Array.from({ length: 216 }, (_, at) => ({
    lod: 0,
    x: (at % 6) - 3,
    y: (Math.floor(at / 6) % 6) - 3,
    z: Math.floor(at / 36) - 3,
  }));
  const found = new Set<string>();
  for await (const { key } of client.chunks(world, keys)) {
    found.add(JSON.stringify(key));
  }
  assert.equal(found.size, keys.length);
  assert.ok(moved.size > 20, `${moved.size} buffers were moved`);
});

test("worlds, edits, and what is forgotten after them", async () => {
  const world = await client.createWorld("far", 1, "hills", { lods: 3 });
  const written = await client.edit(world, [{ op: "carve", shape: "sphere", center: [0, 0, 0], radius: 3 }]);
  client.outdate(world, written.stale, written.revision);
  const log = [];
  for await (const edit of client.edits(world)) {
    log.push(edit.revision);
  }
  assert.deepEqual(log, [1n]);
  assert.equal(await client.ticket(world), null);
  await client.deleteWorld("far");
});

test("errors keep their class and their values", async () => {
  await assert.rejects(
    client.world("nowhere"),
    (error) => error instanceof NotFound && error.problem === "unknown-world",
  );
  await assert.rejects(
    client.postRecipe({ op: "sphere", radius: -1 }),
    (error) => error instanceof BadRequest && error.values["path"] === "radius",
  );
  await assert.rejects(async () => {
    const world = await client.seed(42);
    for await (const _ of client.chunks(world, [{ lod: 99, x: 0, y: 0, z: 0 }])) {
      assert.fail();
    }
  }, BadRequest);
});

test("what is aborted ends with the signal's reason, and what is left early ends there, too", async () => {
  await assert.rejects(client.seed(42, "planet", { signal: AbortSignal.abort(new Error("no")) }), /^Error: no$/);
  const stop = new AbortController();
  const asked = client.waitUntilReady(60, { signal: stop.signal });
  stop.abort(new Error("enough"));
  await assert.rejects(asked, /^Error: enough$/);
  const world = await client.seed(42, "sphere");
  for await (const mesh of client.chunks(world, [
    { lod: 1, x: 0, y: 0, z: 0 },
    { lod: 1, x: -1, y: 0, z: 0 },
  ])) {
    assert.ok(mesh);
    break;
  }
});

test("what is under way when it is closed fails", async () => {
  const channel = new MessageChannel();
  const lonely = new WorkerClient(URL_GIVEN, {}, channel.port1 as unknown as Port);
  const asked = lonely.seed(42);
  lonely.close();
  await assert.rejects(asked, Unreachable);
  await assert.rejects(lonely.seed(42), Unreachable);
  channel.port1.close();
});

/** A worker that answers nothing. */
class Mute extends EventTarget {
  isTerminated = false;
  postMessage(): void {}
  terminate(): void {
    this.isTerminated = true;
  }
}

for (const [kind, why] of [
  ["error", /could not be loaded/],
  ["messageerror", /could not be read/],
] as const) {
  test(`a worker that fails with ${kind} ends what is under way, and whatever is asked later`, async () => {
    const worker = new Mute();
    const lonely = new WorkerClient(URL_GIVEN, {}, worker as unknown as Port);
    const isFailed = (error: unknown) => error instanceof WorkerFailed && why.test(error.message);
    const asked = assert.rejects(lonely.seed(42), isFailed);
    const streamed = assert.rejects(async () => {
      for await (const _ of lonely.chunks(WORLD, [{ lod: 0, x: 0, y: 0, z: 0 }])) {
        assert.fail();
      }
    }, isFailed);
    worker.dispatchEvent(new Event(kind));
    await Promise.all([asked, streamed]);
    await assert.rejects(lonely.traffic(), isFailed);
    await assert.rejects(lonely.edits(WORLD).next(), isFailed);
    lonely.outdate(WORLD, null, 1n);
    lonely.close();
    await assert.rejects(lonely.recipes(), isFailed, "why it failed first is what counts");
    assert.ok(worker.isTerminated);
  });
}
