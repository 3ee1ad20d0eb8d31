/** The client against a real server: chunks, batches, tags, worlds, edits, errors, lost connections. */

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";

import { Client, type ClientOptions } from "../src/client.js";
import { BadAnswer, BadRequest, Conflict, NotFound, Unreachable } from "../src/errors.js";
import { latticePositions, type ChunkKey, type ChunkMesh } from "../src/mesh.js";
import { given } from "./pages.js";

const URL_GIVEN = given("CHUNKSERVER_URL");
const KEYS: ChunkKey[] = [-2, -1, 0, 1].flatMap((x) => [3, 4, 5, 6].map((y) => ({ lod: 0, x, y, z: 0 })));

/** A client that counts what it asks. */
function counting(
  options: ClientOptions = {},
  change: (url: string, init: RequestInit) => Promise<Response> | null = () => null,
) {
  const asked: { url: string; init: RequestInit; status: number }[] = [];
  const fetch: typeof globalThis.fetch = async (url, init = {}) => {
    const entry = { url: String(url), init, status: 0 };
    asked.push(entry);
    const response = await (change(String(url), init) ?? globalThis.fetch(url, init));
    entry.status = response.status;
    return response;
  };
  return { client: new Client(URL_GIVEN, options, fetch), asked };
}

function digest(mesh: ChunkMesh): string {
  const hash = createHash("sha256").update(`${mesh.content} ${mesh.revision} ${mesh.coarser} ${mesh.vertexCount}`);
  return [mesh.positions, mesh.normals, mesh.indices]
    .reduce((sum, array) => sum.update(new Uint8Array(array.buffer, array.byteOffset, array.byteLength)), hash)
    .digest("hex");
}

async function all<Item>(items: AsyncIterable<Item>): Promise<Item[]> {
  const found: Item[] = [];
  for await (const item of items) {
    found.push(item);
  }
  return found;
}

test("a chunk alone and in batches of every coding is the same mesh", async () => {
  const { client } = counting();
  const world = await client.seed(42, "planet");
  const alone = new Map<string, string>();
  for (const key of KEYS) {
    const mesh = await client.chunk(world, key);
    assert.deepEqual(mesh.key, key);
    alone.set(JSON.stringify(key), digest(mesh));
  }
  assert.ok(new Set(alone.values()).size > 5);
  for (const coding of ["identity", "gzip", "zstd"] as const) {
    const meshes = await all(counting({ coding, cacheBytes: 0 }).client.chunks(world, KEYS, { viewer: [0, 200, 0] }));
    assert.deepEqual(new Map(meshes.map((mesh) => [JSON.stringify(mesh.key), digest(mesh)])).size, KEYS.length);
    for (const mesh of meshes) {
      assert.equal(digest(mesh), alone.get(JSON.stringify(mesh.key)));
    }
  }
  const key = { lod: 0, x: 0, y: 6, z: 0 };
  const glb = await client.chunk(world, key, { format: "glb" });
  assert.equal(digest(glb), alone.get(JSON.stringify(key)));
  const floats = await client.chunk(world, key, { profile: "f32" });
  assert.deepEqual(latticePositions(floats), latticePositions(glb));
});

test("each chunk of a batch has its own mask, and neighbours share the points of their border", async () => {
  const { client } = counting();
  const world = await client.seed(42, "hills");
  const [fine, coarse] = await all(
    client.chunks(world, [
      { lod: 0, x: 1, y: -1, z: 0, coarser: 2 },
      { lod: 1, x: 1, y: -1, z: 0 },
    ]),
  ).then((meshes) => [meshes.find((mesh) => mesh.key.lod === 0)!, meshes.find((mesh) => mesh.key.lod === 1)!]);
  assert.deepEqual([fine!.coarser, coarse!.coarser], [2, 0]);
  const border = (mesh: ChunkMesh) => {
    // inside of the face of the finer one
    const points = latticePositions(mesh);
    const found = new Set<string>();
    for (let at = 0; at < points.length; at += 3) {
      const [x, y, z] = points.subarray(at, at + 3);
      if (x === 2 * 32768 && -32768 < y! && y! < 0 && 0 < z! && z! < 32768) {
        found.add(`${y} ${z}`);
      }
    }
    return found;
  };
  assert.ok(border(coarse!).size > 5);
  assert.deepEqual([...border(fine!)].sort(), [...border(coarse!)].sort());
});

test("what is immutable is not asked for again, alone or in a batch", async () => {
  const { client, asked } = counting();
  const world = await client.seed(42, "planet");
  const [first] = await all(client.chunks(world, [KEYS[2]!]));
  const again = await client.chunk(world, KEYS[2]!);
  await all(client.chunks(world, [KEYS[2]!]));
  assert.equal(asked.length, 2);
  const twice = [await client.chunk(world, KEYS[3]!), await client.chunk(world, KEYS[3]!)];
  assert.equal(asked.length, 3);
  assert.notEqual(twice[0]!.positions.buffer, twice[1]!.positions.buffer, "what is kept is nobody's to change");
  assert.equal(digest(again), digest(first!));
  assert.equal((await client.traffic()).cached, 3);
  assert.notEqual(again.positions.buffer, first!.positions.buffer);
});

test("what may change is asked for with its tag: 304", async () => {
  const { client, asked } = counting({ coding: "gzip" }); // as fetch of Node.js asks: each coding has its own tag
  await client.createWorld("tagged", 42, "planet", { lods: 5 });
  const world = await client.world("tagged");
  const key = KEYS[3]!;
  const first = await client.chunk(world, key);
  const head = await client.chunkHead(world, key);
  const second = await client.chunk(world, key);
  const [third] = await all(client.chunks(world, [key]));
  assert.deepEqual(
    [second, third].map((mesh) => digest(mesh!)),
    [digest(first), digest(first)],
  );
  const [, , get, , again, batch] = asked;
  assert.equal(get!.status, 200);
  assert.equal(again!.status, 304);
  const tag = (again!.init.headers as Record<string, string>)["if-none-match"]!;
  assert.match(tag, /^"[0-9a-f]{32}"$/);
  assert.match(head.etag, /^[0-9a-f]{32}$/);
  assert.deepEqual(JSON.parse(batch!.init.body as string).known, [tag.slice(1, -1)]);
  const { requests, bytes, cached } = await client.traffic();
  assert.deepEqual([requests, cached], [6, 2]);
  assert.ok(bytes > first.positions.byteLength && bytes < 4 * first.positions.buffer.byteLength, String(bytes));
  await client.deleteWorld("tagged");
});

test("a 304 for another tag is not believed", async () => {
  const other = () => new Response(null, { status: 304, headers: { etag: '"0"' } });
  const { client, asked } = counting({ retry: { attemptsMax: 2, backoffSeconds: 0 } }, (_, init) =>
    (init.headers as Record<string, string>)["if-none-match"] === undefined ? null : Promise.resolve(other()),
  );
  await client.createWorld("doubted", 42, "planet", { lods: 5 });
  const world = await client.world("doubted");
  await client.chunk(world, KEYS[3]!);
  assert.equal((await client.chunk(world, KEYS[3]!)).content, "surface"); // the second attempt is without a tag
  assert.deepEqual(
    asked.slice(-2).map(({ status }) => status),
    [304, 200],
  );
  await client.deleteWorld("doubted");
});

test("an edit is in the chunks of whoever asks after it, and leaves the cache", async () => {
  const [{ client }, { client: other }] = [counting(), counting()];
  const world = await client.createWorld("dug", 42, "hills", { lods: 5 });
  const keys: ChunkKey[] = [-1, 0].map((y) => ({ lod: 0, x: 0, y, z: 0 }));
  const before = await all(client.chunks(world, keys, { revision: 0n }));
  const stroke = { op: "carve", shape: "sphere", center: [8, 0, 8], radius: 6 };
  const written = await client.edit(world, [stroke], "first");
  assert.deepEqual([written.revision, written.duplicate], [1n, false]);
  assert.ok(written.stale.some(({ lod }) => lod === 0));
  assert.deepEqual([(await client.edit(world, [stroke], "first")).duplicate], [true]);
  const [after, seen] = await Promise.all([
    all(client.chunks(world, keys, { revision: 1n })),
    all(other.chunks(world, keys, { minRevision: 1n })),
  ]);
  const dropped = await all(client.chunks(world, keys, { revision: 0n }));
  const byKey = (meshes: ChunkMesh[]) => meshes.sort((one, next) => one.key.y - next.key.y).map(digest);
  assert.deepEqual(byKey(after), byKey(seen));
  assert.notDeepEqual(byKey(after), byKey(before));
  assert.deepEqual(byKey(dropped), byKey(after), "what was kept for the revision before is stale");
  assert.ok(after.some(({ revision }) => revision === 1n));
  const log = await all(other.edits(world));
  assert.deepEqual(
    log.map(({ revision, strokes }) => [revision, strokes.length, strokes[0]!["shape"]]),
    [[1n, 1, "sphere"]],
  );
  await assert.rejects(
    client.edit(world, [{ ...stroke, radius: -1 }]),
    (error) => error instanceof BadRequest && error.values["path"] === "strokes.0.radius",
  );
  await assert.rejects(client.edit(world, [{ ...stroke, radius: NaN }]), RangeError);
  await client.deleteWorld("dug");
});

test("a tag is good for whoever waits for another revision", async () => {
  const { client } = counting();
  const world = await client.createWorld("waited", 42, "hills", { lods: 3 });
  const keys: ChunkKey[] = [-1, 0].map((y) => ({ lod: 0, x: 0, y, z: 0 }));
  const far = { op: "carve", shape: "sphere", center: [900, 0, 900], radius: 4 };
  const meshes = [];
  for (const minRevision of [1n, 2n]) {
    await client.edit(world, [far]);
    meshes.push((await all(client.chunks(world, keys, { minRevision }))).map(digest).sort());
  }
  assert.deepEqual(meshes[0], meshes[1]);
  assert.equal((await client.traffic()).cached, keys.length);
  await client.deleteWorld("waited");
});

test("a part of the list of worlds", async () => {
  const { client, asked } = counting();
  const ids = ["listed-1", "listed-2", "listed-3"];
  await Promise.all(ids.map((id) => client.createWorld(id, 1, "plane", { lods: 1 })));
  const listed = async (after: string, limit: number) =>
    (await client.worlds({ after, limit })).map(({ id }) => id).filter((id) => id.startsWith("listed"));
  assert.deepEqual(await listed("listed-0", 2), ids.slice(0, 2));
  assert.deepEqual(await listed("listed-1", 1), ids.slice(1, 2));
  assert.equal(asked.filter(({ url }) => url.includes("?limit")).length, 2, "no more pages than are wanted");
  await Promise.all(ids.map((id) => client.deleteWorld(id)));
});

test("worlds, recipes and errors", async () => {
  const { client } = counting();
  assert.ok(await client.isReady());
  const bowl = { op: "max", a: { op: "y" }, b: { op: "subtract", a: 0, b: { op: "sphere", radius: 20 } } };
  const world = await client.createWorld("bowl", -7n, bowl, { voxelSize: 0.5, chunkCells: 16 });
  assert.deepEqual(
    [world.kind, world.seed, world.voxelSize, world.chunkCells, world.lods],
    ["world", -7n, 0.5, 16, 12],
  );
  assert.ok((await client.worlds()).some(({ id, epoch }) => id === "bowl" && epoch === world.epoch));
  assert.deepEqual((await client.recipe(world.recipe.digest)).expression, (await client.postRecipe(bowl)).expression);
  assert.ok((await client.recipes()).some(({ name }) => name === "planet"));
  await assert.rejects(
    client.createWorld("bowl", 8),
    (error) => error instanceof Conflict && error.problem === "world-exists",
  );
  await assert.rejects(client.world("nowhere"), NotFound);
  await assert.rejects(
    client.postRecipe({ op: "sphere", radius: -1 }),
    (error) => error instanceof BadRequest && error.values["path"] === "radius",
  );
  await assert.rejects(client.chunk(world, { lod: 40, x: 0, y: 0, z: 0 }), BadRequest);
  await client.deleteWorld("bowl");
  assert.throws(() => new Client("ftp://x"), RangeError);
  assert.throws(() => new Client(URL_GIVEN, { apiKey: "two words" }), RangeError);
});

test("a batch that breaks off is asked for again, without what came", async () => {
  let cuts = 3;
  const { client, asked } = counting({ coding: "identity", retry: { backoffSeconds: 0.01 } }, (url, init) =>
    init.method === "POST" && cuts-- > 0 ? globalThis.fetch(url, init).then((response) => cut(response, 90_000)) : null,
  );
  const world = await client.seed(43, "planet");
  const keys = KEYS.flatMap((key) => [key, { ...key, z: 1 }]);
  const meshes = await all(client.chunks(world, keys));
  assert.equal(new Set(meshes.map(({ key }) => JSON.stringify(key))).size, keys.length);
  assert.equal(meshes.length, keys.length);
  const sizes = asked.slice(1).map(({ init }) => JSON.parse(init.body as string).chunks.length);
  assert.equal(sizes.length, 4);
  assert.ok(
    sizes.every((size, at) => at === 0 || size < sizes[at - 1]),
    String(sizes),
  );
});

/** A response whose body ends after so many bytes. */
function cut(response: Response, bytes: number): Response {
  let left = bytes;
  const shorter = new TransformStream<Uint8Array, Uint8Array>({
    transform(piece, controller) {
      controller.enqueue(piece.subarray(0, Math.max(left, 0)));
      left -= piece.length;
      if (left <= 0) {
        controller.terminate();
      }
    },
  });
  return new Response(response.body!.pipeThrough(shorter), response);
}

test("a lost connection is asked for again, a limited number of times", async () => {
  let failures = 2;
  const lost = () => Promise.reject(new TypeError("fetch failed"));
  const { client, asked } = counting({ retry: { backoffSeconds: 0.01, attemptsMax: 3 } }, () =>
    failures-- > 0 ? lost() : null,
  );
  assert.equal((await client.seed(42)).seed, 42n);
  assert.equal(asked.length, 3);
  const never = counting({ retry: { backoffSeconds: 0.01, attemptsMax: 3 } }, lost);
  await assert.rejects(
    never.client.seed(42),
    (error) => error instanceof Unreachable && error.cause instanceof TypeError,
  );
  assert.equal(never.asked.length, 3);
});

test("503 and Retry-After are waited for; a page that is no answer is refused", async () => {
  let busy = 1;
  const started = performance.now();
  const { client } = counting({}, () =>
    busy-- > 0 ? Promise.resolve(new Response("", { status: 503, headers: { "retry-after": "1" } })) : null,
  );
  await client.seed(42);
  assert.ok(performance.now() - started > 950);
  const page = counting({ retry: { attemptsMax: 2, backoffSeconds: 0 } }, () =>
    Promise.resolve(new Response("<html>", { headers: { "content-type": "text/html" } })),
  );
  await assert.rejects(page.client.seed(42), BadAnswer);
});

test("a silent server is given up, and whoever aborts gets his own reason", async () => {
  const silent = (_: string, init: RequestInit) =>
    new Promise<Response>((_, reject) => init.signal!.addEventListener("abort", () => reject(init.signal!.reason)));
  const { client } = counting({ readSeconds: 0.05, retry: { attemptsMax: 2, backoffSeconds: 0 } }, silent);
  await assert.rejects(client.seed(42), /nothing came for 0.1 s|nothing came for 0.0/);
  const stop = new AbortController();
  setTimeout(() => stop.abort(new Error("not wanted any more")), 20);
  await assert.rejects(counting({}, silent).client.seed(42, "terrain", { signal: stop.signal }), /not wanted any more/);
});

test("whoever leaves a batch early cancels it", async () => {
  const signals: AbortSignal[] = [];
  const { client } = counting({ cacheBytes: 0 }, (_, init) => (signals.push(init.signal!), null));
  const world = await client.seed(44, "planet");
  for await (const mesh of client.chunks(world, KEYS)) {
    assert.ok(mesh.key);
    break;
  }
  assert.ok(signals.at(-1)!.aborted);
});

test("a seed that JavaScript has rounded is refused: it would be another world", async () => {
  const { client, asked } = counting();
  for (const seed of [2 ** 53, -(2 ** 53), 1.5, NaN, Infinity]) {
    await assert.rejects(client.seed(seed, "plane"), RangeError);
    await assert.rejects(client.createWorld("rounded", seed, "plane"), RangeError);
  }
  assert.equal(asked.length, 0);
  assert.equal((await client.seed(2n ** 63n - 1n, "plane")).seed, 2n ** 63n - 1n);
  assert.equal((await client.seed(-(2 ** 53) + 1, "plane")).seed, -(2n ** 53n) + 1n);
});
