/** Streams of edits over real sockets: seen by others, resumed, sent again, ended. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { Client } from "../src/client.js";
import { EditStream } from "../src/edit_stream.js";
import { BadRequest, EditLost, Gone, StreamEnded, Unreachable } from "../src/errors.js";
import type { ChunkKey } from "../src/mesh.js";
import type { StreamEvent } from "../src/stream/inbox.js";
import { Line } from "./line.js";
import { given } from "./pages.js";

const URL_GIVEN = given("CHUNKSERVER_URL");
const RETRY = { backoffSeconds: 0.05, backoffSecondsMax: 0.2 };
const KEYS: ChunkKey[] = [-1, 0].map((y) => ({ lod: 0, x: 0, y, z: 0 }));
const hole = (x: number) => ({ op: "carve", shape: "sphere", center: [x, 0, 8], radius: 5 });

/** Takes events until something holds; fails after some seconds. */
async function until(stream: EditStream, holds: (events: StreamEvent[]) => boolean): Promise<StreamEvent[]> {
  const found: StreamEvent[] = [];
  const deadline = performance.now() + 15_000;
  while (!holds(found)) {
    assert.ok(performance.now() < deadline, JSON.stringify(found.map(({ kind }) => kind)));
    found.push(...stream.poll());
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
  return found;
}

test("what one digs the other sees, and fetches as it is by then", async () => {
  const [client, other] = [new Client(URL_GIVEN), new Client(URL_GIVEN)];
  const world = await client.createWorld("mine", 42, "hills", { lods: 5 });
  const [alice, bob] = [await EditStream.open(client, world, "alice"), await EditStream.open(other, world, "bob")];
  bob.show(...KEYS);
  const dug = await alice.edit([hole(4)]);
  assert.deepEqual([dug.kind, dug.revision, dug.duplicate], ["ack", 1n, false]);
  let strokes = 0;
  const revisions: bigint[] = [];
  for await (const event of bob) {
    if (event.kind === "edits") {
      strokes += event.edits.flatMap((edit) => edit.strokes ?? []).length;
    }
    if (event.kind === "refresh") {
      for await (const mesh of other.chunks(world, event.keys, { minRevision: event.revision })) {
        revisions.push(mesh.revision);
      }
      bob.shown(event);
    }
    if (bob.revision === 1n && bob.areChunksCurrent) {
      break;
    }
  }
  assert.equal(strokes, 1);
  assert.ok(revisions.includes(1n));
  await assert.rejects(
    alice.edit([{ ...hole(0), radius: -1 }]),
    (error) => error instanceof BadRequest && error.values["path"] === "strokes.0.radius",
  );
  const values = Int32Array.of(1024, 1024, 1024, 1024, 1024, 1024, 1024, 1024);
  assert.equal((await alice.edit([{ op: "delta", min: [0, 0, 0], size: [2, 2, 2], values }])).revision, 2n);
  assert.equal((await client.edit(world, [{ op: "delta", min: [0, 0, 0], size: [2, 2, 2], values }])).revision, 3n);
  await until(bob, () => bob.revision === 3n);
  alice.close();
  bob.close();
  for await (const event of alice) {
    assert.ok(event);
  }
  assert.throws(() => alice.edit([hole(0)]), StreamEnded);
  await client.deleteWorld("mine");
});

test("what a cut line has lost is sent again, and is written once; what was missed comes", async () => {
  const line = await Line.to(URL_GIVEN);
  const [client, far] = [new Client(URL_GIVEN), new Client(line.url, { retry: RETRY })];
  const world = await client.createWorld("torn", 42, "hills", { lods: 5 });
  const [alice, bob] = [
    await EditStream.open(client, world, "alice"),
    await EditStream.open(far, world, "bob", { retry: RETRY }),
  ];
  const answers = [];
  const heard: StreamEvent[] = [];
  for (let round = 0; round < 8; round++) {
    answers.push(bob.edit([hole(round)]));
    await alice.edit([hole(round + 20)]);
    const { opened } = line;
    line.cut();
    answers.push(bob.edit([hole(round + 40)]));
    heard.push(...(await until(bob, () => line.opened > opened && bob.isLive)));
  }
  const acks = await Promise.all(answers);
  heard.push(...(await until(bob, () => bob.revision === 24n)));
  assert.equal(new Set(acks.map(({ revision }) => revision)).size, 16);
  const log = [];
  for await (const { revision } of client.edits(world)) {
    log.push(revision);
  }
  assert.equal(log.length, 24);
  const seen = heard.flatMap((event) => (event.kind === "edits" ? event.edits.map(({ revision }) => revision) : []));
  const own = new Set(acks.map(({ revision }) => revision));
  assert.deepEqual(
    seen,
    log.filter((revision) => !own.has(revision)),
    "others' edits, each once and in order",
  );
  assert.ok(line.opened >= 9);
  bob.close();
  alice.close();
  line.close();
  await client.deleteWorld("torn");
});

test("a line that is held still is given up after 5 s, and resumed", async () => {
  const line = await Line.to(URL_GIVEN);
  const client = new Client(URL_GIVEN);
  const world = await client.createWorld("still", 42, "hills", { lods: 5 });
  const bob = await EditStream.open(new Client(line.url), world, "bob", { retry: RETRY });
  line.hold();
  await client.edit(world, [hole(0)]);
  const started = performance.now();
  await until(bob, (events) => events.some(({ kind }) => kind === "edits"));
  assert.ok(performance.now() - started > 3000 && bob.revision === 1n);
  bob.close();
  line.close();
  await client.deleteWorld("still");
});

test("ends that are final end it, and say why", async () => {
  const client = new Client(URL_GIVEN);
  const world = await client.createWorld("ended", 42, "hills", { lods: 5 });
  const first = await EditStream.open(client, world, "alice");
  const second = await EditStream.open(client, world, "alice");
  await assert.rejects(
    async () => {
      for await (const event of first) {
        assert.ok(event);
      }
    },
    (error) => error instanceof StreamEnded && error.code === 4409,
  );
  await client.deleteWorld("ended");
  await assert.rejects(
    async () => {
      for await (const event of second) {
        assert.ok(event);
      }
    },
    (error) => error instanceof StreamEnded && error.code === 4404,
  );
  await assert.rejects(
    EditStream.open(client, world, "alice"),
    (error) => error instanceof StreamEnded && error.code === 4404,
  );
  const again = await client.createWorld("ended", 42, "hills", { lods: 5 });
  await assert.rejects(EditStream.open(client, world, "alice"), Gone);
  await assert.rejects(EditStream.open(client, again, "two words"), RangeError);
  await client.deleteWorld("ended");
});

test("a server that is away is waited for, so long; edits without an answer are lost when it is closed", async () => {
  const line = await Line.to(URL_GIVEN);
  const client = new Client(URL_GIVEN);
  const world = await client.createWorld("away", 42, "hills", { lods: 5 });
  const bob = await EditStream.open(new Client(line.url), world, "bob", { retry: RETRY });
  line.hold();
  const answer = bob.edit([hole(0)]);
  assert.equal(bob.unanswered, 1);
  bob.close();
  await assert.rejects(answer, EditLost);
  line.close();
  const nobody = new Client(line.url, { retry: { attemptsMax: 1 } });
  await assert.rejects(EditStream.open(nobody, world, "carol", { retry: { ...RETRY, secondsMax: 0.5 } }), Unreachable);
  await client.deleteWorld("away");
});

test("a client with a key opens its stream with tickets, each time a new one", async () => {
  const line = await Line.to(given("CHUNKSERVER_KEYED_URL"));
  const client = new Client(line.url, { apiKey: given("CHUNKSERVER_KEY"), retry: RETRY });
  const world = await client.createWorld("locked", 42, "hills", { lods: 5 });
  const stream = await EditStream.open(client, world, "alice", { retry: RETRY });
  assert.equal((await stream.edit([hole(0)])).revision, 1n);
  line.cut();
  assert.equal((await stream.edit([hole(1)])).revision, 2n);
  stream.close();
  const wrong = new Client(line.url, { apiKey: "wrong", retry: RETRY });
  await assert.rejects(
    EditStream.open(wrong, world, "bob"),
    (error) => error instanceof StreamEnded && error.code === 4401,
  );
  await client.deleteWorld("locked");
  line.close();
});
