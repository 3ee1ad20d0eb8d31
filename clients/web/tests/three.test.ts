/** The adapter for three.js: views, places as exact integers, the shader's text, rays. */

import assert from "node:assert/strict";
import { test } from "node:test";
import {
  MeshBasicMaterial,
  MeshLambertMaterial,
  Raycaster,
  ShaderLib,
  Vector3,
  type InstancedBufferAttribute,
} from "three";

import { decode } from "../src/decoding.js";
import { latticePositions, type ChunkMesh, type Triple } from "../src/mesh.js";
import { ChunkGroup, ChunkObject, placed, placedShader } from "../src/three.js";
import { hexdump, page } from "./pages.js";

const NATIVE = page("wire/native-v1.md");
const MATERIAL = placed(new MeshBasicMaterial());
const WORLD = { chunkCells: 32, voxelSize: 0.5 };

/** The example as another chunk. */
function chunkAt(lod: number, x: number, y: number, z: number): ChunkMesh {
  return { ...decode(hexdump(NATIVE, "std")), key: { lod, x, y, z } };
}

/** What the vertex shader makes of a vertex, in float32. */
function shaded(object: ChunkObject, vertex: number): number[] {
  const place = object.geometry.getAttribute("chunkPlace") as InstancedBufferAttribute;
  const position = object.geometry.getAttribute("position");
  return [0, 1, 2].map((axis) =>
    Math.fround(place.array[axis]! + Math.fround(position.getComponent(vertex, axis) * place.array[3]!)),
  );
}

test("attributes are views of the bytes that came", () => {
  const chunk = decode(hexdump(NATIVE, "std"));
  const { geometry } = new ChunkObject(chunk, MATERIAL);
  assert.equal(geometry.getAttribute("position").array, chunk.positions);
  assert.equal(geometry.getAttribute("normal").array, chunk.normals);
  assert.equal(geometry.index!.array, chunk.indices);
  assert.deepEqual(
    [geometry.getAttribute("position").count, geometry.getAttribute("normal").normalized, geometry.instanceCount],
    [4, true, 1],
  );
});

test("a vertex is the exact integer from the anchor, rounded once", () => {
  const far = 2 ** 30;
  for (const [lod, x] of [
    [0, far + 3],
    [0, far - 200],
    [5, far / 32 + 7],
    [11, far / 2048 - 12],
    [11, far / 2048 + 15],
  ] as const) {
    const [chunk, group] = [chunkAt(lod, x, 0, -1), new ChunkGroup(WORLD)];
    const object = new ChunkObject(chunk, MATERIAL);
    group.moveAnchor([far * 32 + 5, -7, 31]);
    group.add(object);
    const exact = latticePositions(chunk);
    const anchor = [far, -1, 0].map((place) => place * 32768);
    for (let vertex = 0; vertex < chunk.vertexCount; vertex++) {
      assert.deepEqual(
        shaded(object, vertex),
        anchor.map((origin, axis) => Math.fround(exact[3 * vertex + axis]! - origin)),
      );
    }
  }
});

test("the scene's origin is the anchor, in metres", () => {
  const group = new ChunkGroup(WORLD);
  assert.deepEqual(group.positionOf([10, 20, -30]).toArray(), [5, 10, -15]);
  const moved = group.moveAnchor([2 ** 40 - 1, 33, -1]);
  assert.deepEqual(group.anchor, [2 ** 40 - 32, 32, -32]);
  assert.deepEqual(moved.toArray(), [-(2 ** 40 - 32) / 2, -16, 16]);
  assert.deepEqual(group.positionOf([2 ** 40 - 31.5, 32, -32]).toArray(), [0.25, 0, 0]);
  assert.deepEqual(group.voxelAt(new Vector3(0.25, 0, 0)), [2 ** 40 - 31.5, 32, -32] as Triple);
});

test("bounds follow the anchor, and all chunks share one matrix", () => {
  const group = new ChunkGroup(WORLD);
  const objects = [new ChunkObject(chunkAt(2, -3, 0, 5), MATERIAL), new ChunkObject(chunkAt(0, 8, 1, 1), MATERIAL)];
  group.add(...objects);
  group.add(...objects);
  group.moveAnchor([-400, 0, 600]);
  group.updateMatrixWorld(true);
  for (const object of objects) {
    assert.deepEqual(object.matrixWorld.elements, objects[0]!.matrixWorld.elements);
  }
  const box = objects[0]!.geometry.boundingBox!.clone().applyMatrix4(objects[0]!.matrixWorld);
  const corner = group.positionOf([-384, 18 - 1, 640]); // metres -192, 8.5, 320
  assert.deepEqual(box.min.toArray(), corner.toArray());
  assert.deepEqual(box.max.clone().sub(box.min).toArray(), [2, 0.5, 2]);
});

test("a ray hits a chunk where it is", () => {
  const group = new ChunkGroup(WORLD);
  const object = new ChunkObject(chunkAt(2, -3, 0, 5), MATERIAL);
  group.add(object, new ChunkObject(chunkAt(2, 3, 0, 5), MATERIAL));
  group.moveAnchor([-400, 0, 600]);
  group.updateMatrixWorld(true);
  const [from, down] = [group.positionOf([-382.5, 100, 641]), new Vector3(0, -1, 0)];
  const hits = new Raycaster(from, down).intersectObject(group, true);
  assert.equal(hits.length, 1);
  assert.equal(hits[0]!.object, object);
  const [x, y, z] = group.voxelAt(hits[0]!.point);
  assert.deepEqual([x, y, z], [-382.5, 17.625, 641]);
});

test("every vertex shader of three.js's own materials takes the place, once for all chunks", () => {
  for (const name of ["basic", "lambert", "phong", "standard", "normal", "depth", "toon", "matcap"] as const) {
    const source = placedShader(ShaderLib[name]!.vertexShader);
    assert.match(source, /^attribute vec4 chunkPlace;/);
    assert.ok(source.includes("vec3 transformed = chunkPlace.xyz + position * chunkPlace.w;"));
  }
  assert.throws(() => placedShader("void main() {}"), RangeError);
});

test("a material keeps what it does before it is compiled", () => {
  const material = new MeshLambertMaterial();
  material.onBeforeCompile = (shader) => void (shader.vertexShader += "// mine");
  const shader = { vertexShader: ShaderLib["lambert"]!.vertexShader } as Parameters<typeof material.onBeforeCompile>[0];
  placed(material).onBeforeCompile(shader, undefined as never);
  assert.match(shader.vertexShader, /^attribute vec4 chunkPlace;[^]*\/\/ mine$/);
  assert.notEqual(material.customProgramCacheKey(), new MeshLambertMaterial().customProgramCacheKey());
});

test("another profile, and an empty chunk, are refused by name", () => {
  assert.throws(() => new ChunkObject(decode(hexdump(NATIVE, "f32")), MATERIAL), /profile f32/);
  assert.throws(() => new ChunkObject(decode(hexdump(NATIVE, "empty")), MATERIAL), /rock/);
});
