/** What is freed at once, and in which order chunks are asked for. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { free } from "../src/freeing.ts";
import { byDistance } from "../src/places.ts";

/** As browsers have it: this Node.js may not. */
function transfer(byteLength) {
  structuredClone(this, { transfer: [this] });
  return new ArrayBuffer(byteLength);
}

test("a mesh that is freed has no bytes left, whether its arrays share a buffer or not", (context) => {
  const { prototype } = ArrayBuffer;
  const own = Object.getOwnPropertyDescriptor(prototype, "transfer");
  context.after(() => (own ? Object.defineProperty(prototype, "transfer", own) : delete prototype.transfer));
  const buffer = new ArrayBuffer(64);
  const shared = {
    positions: new Uint16Array(buffer, 0, 8),
    normals: new Int8Array(buffer, 16, 8),
    indices: new Uint16Array(buffer, 32, 6),
  };
  const apart = { positions: new Uint16Array(8), normals: new Int8Array(8), indices: new Uint16Array(6) };
  const empty = { positions: new Uint16Array(0), normals: new Int8Array(0), indices: new Uint16Array(0) };
  const bytesOf = (mesh) => Object.values(mesh).reduce((sum, { byteLength }) => sum + byteLength, 0);
  prototype.transfer = undefined;
  free(shared);
  assert.equal(bytesOf(shared), 36);
  prototype.transfer = transfer;
  for (const mesh of [shared, apart, empty]) {
    free(mesh);
    assert.equal(bytesOf(mesh), 0);
    free(mesh);
  }
});

test("the nearest chunks come first, of those as near the coarser", () => {
  const chunk = (lod, x) => [`${lod}/${x}`, { lod, x, y: 0, z: 0, coarser: 0 }];
  const sets = [new Map([chunk(0, 5), chunk(0, 1)]), new Map([chunk(1, 1), chunk(1, 0), chunk(0, 2)])];
  const names = byDistance(sets, [40, 16, 16], 32).map(([name]) => name);
  assert.deepEqual(names, ["1/0", "0/1", "1/1", "0/2", "0/5"]);
});
