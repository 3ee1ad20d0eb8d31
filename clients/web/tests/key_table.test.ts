import assert from "node:assert/strict";
import { test } from "node:test";

import { KeyTable } from "../src/key_table.js";
import { keyName, type ChunkKey } from "../src/mesh.js";

test("keys have the numbers of their places, near the origin and far away, and the same one only once", () => {
  const far = [0, -1, 5, 2 ** 32, -(2 ** 32), 2 ** 32 + 5, 2 ** 35 - 1, -(2 ** 35)];
  const keys: ChunkKey[] = [0, 9, 20].flatMap((lod) =>
    far.flatMap((x) => far.flatMap((y) => far.map((z) => ({ lod, x, y, z })))),
  );
  const table = new KeyTable(keys.length);
  const byName = new Map(keys.map((key, number) => [keyName(key), number]));
  assert.equal(byName.size, keys.length);
  for (const key of [...keys, ...keys]) {
    assert.equal(table.add({ ...key }), byName.get(keyName(key)));
  }
  assert.equal(table.keys.length, keys.length);
  for (const { lod, x, y, z } of keys) {
    assert.equal(table.find(lod, x, y, z), byName.get(keyName({ lod, x, y, z })));
    assert.equal(table.find(lod + 1, x, y, z), -1);
    assert.equal(table.find(lod, x + 7, y, z), -1);
  }
});

test("a table without keys finds none", () => {
  assert.equal(new KeyTable(0).find(0, 0, 0, 0), -1);
});
