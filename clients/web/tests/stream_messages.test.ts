/** docs/wire/edit_v1.examples.json, as the client reads and writes it; and answers that are none. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { BadAnswer, BadRequest } from "../src/errors.js";
import { edit, hello, readMessage, regionsChanged, type WireFrame } from "../src/stream/messages.js";
import { bytesOf, page } from "./pages.js";

interface Example {
  readonly name: string;
  readonly text?: string;
  readonly binary?: string;
}

const EXAMPLES: { client: Example[]; server: Example[] } = JSON.parse(page("wire/edit_v1.examples.json"));
const CARVE = { op: "carve", shape: "sphere", center: [8, 200, 3], radius: 6 };
const NEAR = { low: [-64, 0, -64], high: [64, 256, 64], lod: 3 } as const;
const VALUES = Int32Array.of(0, 1, -1, 1024, -1024, 2 ** 20, -(2 ** 20), 7);
const DELTA = { op: "delta", min: [-3, 0, 5], size: [2, 2, 2] };
const RANGES = [
  { lod: 0, low: [0, 5, -1], high: [0, 6, 0] },
  { lod: 1, low: [0, 2, -1], high: [0, 3, 0] },
];

const READ: Record<string, object> = {
  welcome: { kind: "welcome", epoch: "k7Qx2", revision: 45n, floor: 12n, lastSeq: 7, inflight: 64 },
  "welcome, first": {
    kind: "welcome",
    epoch: "k7Qx2",
    revision: 9007199254740993n,
    floor: 0n,
    lastSeq: null,
    inflight: 64,
  },
  ack: { kind: "ack", seq: 7, revision: 43n, duplicate: false, stale: RANGES },
  "ack, below the floor": { kind: "ack", seq: 2, revision: 12n, duplicate: true, stale: null },
  edits: {
    kind: "edits",
    after: 42n,
    revision: 45n,
    edits: [
      { revision: 44n, strokes: [CARVE] },
      { revision: 45n, strokes: null },
    ],
    stale: RANGES,
  },
  progress: { kind: "progress", revision: 45n, asked: 1 },
  stale: { kind: "stale", stale: RANGES, revision: 60n },
  resync: { kind: "resync", floor: 50n, revision: 80n, epoch: "k7Qx2" },
};

const WRITTEN: Record<string, WireFrame> = {
  hello: hello("player-1", null, null, [NEAR]),
  "hello again": hello("player-1", "k7Qx2", 42n, [NEAR, { low: [0, 0, 0], high: [0, 0, 0] }]),
  edit: edit(7, [CARVE]),
  "edit with bulk deltas": edit(8, [CARVE, { ...DELTA, values: VALUES }]),
  subscribe: regionsChanged(true, [{ low: [100, 0, 0], high: [200, 64, 64], lod: 0 }]),
  unsubscribe: regionsChanged(false, [NEAR]),
};

for (const { name, text } of EXAMPLES.server) {
  test(`reads the example ${name}`, () => {
    const message = readMessage(text!);
    if (name === "nack") {
      assert.ok(message?.kind === "nack" && message.seq === 9 && message.problem instanceof BadRequest);
      assert.deepEqual([message.problem.problem, message.problem.values["path"]], ["bad-stroke", "strokes.0.radius"]);
    } else {
      assert.deepEqual(message, READ[name]);
    }
  });
}

for (const { name, text, binary } of EXAMPLES.client) {
  test(`writes the example ${name}`, () => {
    const frame = WRITTEN[name]!;
    if (typeof frame === "string") {
      assert.deepEqual(withLods(JSON.parse(frame)), withLods(JSON.parse(text!)));
    } else {
      assert.deepEqual(frame, bytesOf(binary!));
    }
  });
}

/** `lod` may be left out. */
function withLods(message: { regions?: object[] }): object {
  return { ...message, regions: message.regions?.map((region) => ({ lod: 20, ...region })) };
}

test("values of either kind stay in their order; in text they are base64", () => {
  const told = { ...DELTA, values: "AAAAAAEAAAD/////AAQAAAD8//8AABAAAADw/wcAAAA=" };
  const frame = edit(1, [told, { ...DELTA, values: new Int32Array(8) }]);
  assert.ok(typeof frame !== "string");
  const bulk = new Uint8Array([...new Uint8Array(VALUES.buffer), ...new Uint8Array(32)]);
  assert.deepEqual(frame.slice(-64), bulk);
});

test("an unknown type is no message", () => assert.equal(readMessage('{"type":"weather","rain":true}'), null));

for (const text of [
  "no",
  "[]",
  "{}",
  '{"type":"progress","revision":5,"asked":0}',
  '{"type":"progress","revision":"05","asked":0}',
  '{"type":"progress","revision":"5"}',
  '{"type":"stale","chunks":[{"lod":21,"min":[0,0,0],"max":[0,0,0]}],"revision":"1"}',
  '{"type":"stale","chunks":[{"lod":0,"min":[0,0],"max":[0,0,0]}],"revision":"1"}',
  '{"type":"stale","chunks":[{"lod":0,"min":[0,0,0],"max":[0,0,0.5]}],"revision":"1"}',
  '{"type":"nack","seq":1,"problem":{"status":200}}',
  '{"type":"edits","after":"1","revision":"2","edits":[{"revision":"2","strokes":[1]}],"stale":[]}',
]) {
  test(`what is no message is refused: ${text}`, () => assert.throws(() => readMessage(text), BadAnswer));
}

test("a binary frame of the server is refused", () => assert.throws(() => readMessage(new ArrayBuffer(4)), BadAnswer));

test("an edit fits a frame, and a region is one", () => {
  const values = new Int32Array(2 ** 14);
  assert.throws(() => edit(1, [{ ...DELTA, size: [2 ** 14, 1, 1], values }]), /at most 65536/);
  assert.throws(() => edit(1, [{ ...CARVE, radius: NaN }]), /JSON/);
  for (const region of [
    { low: [1, 0, 0], high: [0, 0, 0] },
    { low: [0, 0, 0], high: [0, 0, 2 ** 41] },
    { low: [0, 0, 0], high: [1, 1, 1], lod: 21 },
    { low: [0, 0, 0.5], high: [1, 1, 1] },
  ] as const) {
    assert.throws(() => hello("a", null, null, [region]), RangeError);
  }
});
