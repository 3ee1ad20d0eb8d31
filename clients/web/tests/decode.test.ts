/** docs/wire/native-v1.md and glb.md: the examples, decoded; bytes that are no chunk, refused. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { GLB_MEDIA_TYPE, decode } from "../src/decoding.js";
import { BadChunk } from "../src/errors.js";
import { CONTENTS, latticePositions, positionsInMetres, type ChunkMesh } from "../src/mesh.js";
import { hexdump, page, stated } from "./pages.js";

const NATIVE = page("wire/native-v1.md");
const PROFILES = ["std", "f32"];

function rows(array: ArrayLike<number>, components: number): number[][] {
  return Array.from({ length: array.length / components }, (_, row) =>
    Array.from({ length: components }, (_, at) => array[row * components + at]!),
  );
}

for (const name of ["std", "f32", "empty"]) {
  test(`the header of the example ${name}`, () => {
    const [mesh, says] = [decode(hexdump(NATIVE, name)), stated(NATIVE, name)];
    assert.deepEqual(mesh.key, { lod: says.lod, x: says.x, y: says.y, z: says.z });
    assert.equal(mesh.revision, BigInt(says.revision));
    assert.equal(mesh.content, CONTENTS[says.content]);
    assert.equal(mesh.profile, PROFILES[says.profile]);
    const { cells, voxelSize, coarser, geometricError, low, high } = mesh;
    const { voxel_size, geometric_error } = says;
    assert.deepEqual(
      [cells, voxelSize, coarser, geometricError, low, high],
      [says.cells, voxel_size, says.coarser, geometric_error, says.low, says.high],
    );
    assert.equal(hexdump(NATIVE, name).length, says.file_bytes);
    assert.equal(mesh.content === "surface" ? mesh.indices.BYTES_PER_ELEMENT : 0, says.index_bytes);
  });
}

for (const name of PROFILES) {
  test(`the arrays of the example ${name}, which are views`, () => {
    const file = hexdump(NATIVE, name);
    const [mesh, says] = [decode(file), stated(NATIVE, name)];
    assert.deepEqual(rows(mesh.positions, mesh.components), says.positions);
    rows(mesh.normals, mesh.components).forEach((normal, vertex) =>
      normal.forEach((value, axis) => assert.ok(Math.abs(value - says.normals[vertex][axis]) < 1e-7)),
    );
    assert.deepEqual([...mesh.indices], says.indices);
    assert.deepEqual(rows(positionsInMetres(mesh), 3), says.metres);
    const lattice = rows(latticePositions(mesh), 3);
    assert.deepEqual(
      lattice,
      stated(NATIVE, "std").positions.map(([x, y, z]: number[]) => [
        4 * (-3 * 32768 + x! - 16384),
        4 * (y! - 16384),
        4 * (5 * 32768 + z! - 16384),
      ]),
    );
    for (const array of [mesh.positions, mesh.normals, mesh.indices]) {
      assert.equal(array.buffer, file.buffer);
    }
  });
}

test("metres from an origin that is far away are exact", () => {
  const file = hexdump(NATIVE, "std");
  new DataView(file.buffer).setBigInt64(8, 2n ** 33n - 1n, true);
  const mesh = decode(file);
  const origin = (2 ** 33 - 1) * 128;
  assert.deepEqual(rows(positionsInMetres(mesh, [origin, 0, 640]), 3)[1], [2, 8.5, 0]);
  assert.throws(() => positionsInMetres(mesh, [0.5, 0, 0]), RangeError);
});

test("the empty example has arrays of length 0", () => {
  const mesh = decode(hexdump(NATIVE, "empty"));
  assert.deepEqual([mesh.vertexCount, mesh.positions.length, mesh.normals.length, mesh.indices.length], [0, 0, 0, 0]);
});

test("a file at any place of a larger buffer", () => {
  const file = hexdump(NATIVE, "std");
  for (const shift of [1, 2, 16]) {
    const whole = new Uint8Array(file.length + 40);
    whole.set(file, shift);
    const mesh = decode(whole.subarray(shift, shift + file.length));
    assert.deepEqual(mesh.positions, decode(file).positions);
    assert.equal(mesh.positions.buffer === whole.buffer, shift === 16);
  }
});

/** A GLB written from docs/wire/glb.md: the mesh of the native example. */
function glb(change: (scene: any) => void = () => {}): Uint8Array {
  const says = stated(NATIVE, "std");
  const scene = {
    asset: { version: "2.0" },
    scenes: [{ nodes: [0] }],
    nodes: [
      {
        mesh: 0,
        translation: [-3.5, -0.5, 4.5].map((place) => place * 64),
        scale: [2 ** -9, 2 ** -9, 2 ** -9],
        extras: {
          lod: "2",
          x: "-3",
          y: "0",
          z: "5",
          cells: 32,
          voxel_size: 0.5,
          revision: "7",
          coarser: 0,
          content: "surface",
          geometric_error: 0.75,
        },
      },
    ],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 1 }, indices: 2 }] }],
    accessors: [
      { bufferView: 0, componentType: 5123, count: 4, type: "VEC3", min: says.low, max: says.high },
      { bufferView: 1, componentType: 5120, normalized: true, count: 4, type: "VEC3" },
      { bufferView: 2, componentType: 5123, count: 6, type: "SCALAR" },
    ],
    bufferViews: [
      { buffer: 0, byteOffset: 0, byteLength: 32, byteStride: 8 },
      { buffer: 0, byteOffset: 32, byteLength: 16, byteStride: 4 },
      { buffer: 0, byteOffset: 48, byteLength: 12 },
    ],
    extensionsRequired: ["KHR_mesh_quantization"],
  };
  change(scene);
  const json = JSON.stringify(scene);
  const text = new TextEncoder().encode(json.padEnd(Math.ceil(json.length / 4) * 4));
  const file = new Uint8Array(12 + 8 + text.length + 8 + 60);
  const view = new DataView(file.buffer);
  [0x46546c67, 2, file.length, text.length, 0x4e4f534a].forEach((value, at) => view.setUint32(4 * at, value, true));
  file.set(text, 20);
  view.setUint32(20 + text.length, 60, true);
  view.setUint32(24 + text.length, 0x004e4942, true);
  file.set(hexdump(NATIVE, "std").subarray(0x90, 0xcc), 28 + text.length);
  return file;
}

test("a GLB is the same mesh", () => {
  const [mesh, native] = [decode(glb(), `${GLB_MEDIA_TYPE}; x=y`), decode(hexdump(NATIVE, "std"))];
  const plain = (each: ChunkMesh) => ({
    ...each,
    positions: [...each.positions],
    normals: [...each.normals],
    indices: [...each.indices],
  });
  assert.deepEqual(plain(mesh), plain(native));
});

test("an empty GLB", () => {
  const mesh = decode(
    glb((scene) => {
      delete scene.nodes[0].mesh;
      scene.nodes[0].extras.content = "rock";
    }),
    GLB_MEDIA_TYPE,
  );
  assert.deepEqual([mesh.content, mesh.vertexCount, mesh.revision], ["rock", 0, 7n]);
});

for (const [what, change] of Object.entries<(scene: any) => void>({
  "put somewhere else": (scene) => (scene.nodes[0].translation[0] += 1),
  "of another scale": (scene) => (scene.nodes[0].scale[1] *= 2),
  "of another stride": (scene) => (scene.bufferViews[0].byteStride = 12),
  "longer than its buffer": (scene) => (scene.bufferViews[2].byteLength = 64),
  "with more vertices than there are": (scene) => (scene.accessors[0].count = 5),
  "with an odd place": (scene) => (scene.bufferViews[2].byteOffset = 47),
  "that needs an extension": (scene) => scene.extensionsRequired.push("KHR_draco_mesh_compression"),
})) {
  test(`a GLB ${what} is refused`, () => assert.throws(() => decode(glb(change), GLB_MEDIA_TYPE), BadChunk));
}

test("an unknown media type is refused by name", () => {
  assert.throws(() => decode(hexdump(NATIVE, "std"), "text/html; charset=utf-8"), /text\/html/);
});

const u16 = (value: number) => [value & 255, value >> 8];

for (const [name, offset, bytes, why] of [
  ["std", 0, [0x44], /begins with/],
  ["std", 4, u16(2), /begins with/],
  ["std", 68, [0xcf], /file_bytes is 207/],
  ["std", 52, [5], /index_count is 5/],
  ["std", 60, u16(17), /cells is 17/],
  ["std", 62, [21], /lod is 21/],
  ["std", 39, [0x80], /revision is/],
  ["std", 15, [0x7f], /voxels from the origin/],
  ["std", 46, [0xf0, 0x7f], /voxel size is/],
  ["std", 59, [0xff], /geometric_error is/],
  ["std", 64, [64], /coarser is 64/],
  ["std", 65, [3], /content is 3/],
  ["std", 65, [0], /content is air, but there are 4 vertices/],
  ["std", 66, [3], /index_bytes is 3/],
  ["std", 67, [2], /no block of kind 3/],
  ["std", 6, u16(200), /beyond the file/],
  ["std", 73, [0x60], /low is .* above high/],
  ["std", 0x62, u16(5121), /block 0 of kind 1 has type/],
  ["std", 0x70, u16(1), /block 1 of kind 1 has type/],
  ["std", 0x88, u16(0xc2), /block 2 of kind 3 has 12 bytes at 194/],
  ["std", 0x88, u16(0x40), /block 2 of kind 3 has 12 bytes at 64/],
  ["std", 0x88, u16(0xd0), /block 2 of kind 3 has 12 bytes at 208/],
  ["std", 0x8c, u16(14), /block 2 of kind 3 has 14 bytes/],
  ["std", 0xc2, u16(4), /an index is 4: there are 4 vertices/],
  ["f32", 0x92, [0xc0, 0x7f], /a position is NaN/],
  ["f32", 0xc2, [0x80, 0x40], /a normal is/],
] as const) {
  test(`a file of ${name} with ${bytes} at ${offset} is refused, and why`, () => {
    const file = hexdump(NATIVE, name);
    file.set(bytes, offset);
    assert.throws(() => decode(file), why);
    assert.throws(() => decode(file), BadChunk);
  });
}

test("kinds of blocks that a later writer adds are passed over", () => {
  const file = hexdump(NATIVE, "std");
  const longer = new Uint8Array([...file.subarray(0, 0x90), 9, ...new Uint8Array(15), ...file.subarray(0x90)]);
  longer[67] = 4;
  longer[68]! += 16;
  [0x68, 0x78, 0x88].forEach((offset) => (longer[offset]! += 16));
  assert.deepEqual([...decode(longer).indices], [...decode(file).indices]);
});

test("whatever the bytes are, it is a chunk or a BadChunk", () => {
  let state = 12345;
  const random = (below: number) => (state = (state * 1103515245 + 12345) % 2 ** 31) % below;
  const files: [Uint8Array, string | undefined][] = [
    ...["std", "f32", "empty"].map((name): [Uint8Array, undefined] => [hexdump(NATIVE, name), undefined]),
    [glb(), GLB_MEDIA_TYPE],
  ];
  let refused = 0;
  for (let round = 0; round < 20_000; round++) {
    const [file, type] = files[round % files.length]!;
    let bytes = file.slice(0, round % 3 ? file.length : random(file.length + 1));
    for (let hits = random(4); hits >= 0 && bytes.length; hits--) {
      bytes[random(bytes.length)] = random(256);
    }
    try {
      const mesh = decode(bytes, type);
      assert.ok(mesh.indices.every((index) => index < mesh.vertexCount));
    } catch (error) {
      assert.ok(error instanceof BadChunk, String(error));
      refused += 1;
    }
  }
  assert.ok(refused > 5_000);
});
