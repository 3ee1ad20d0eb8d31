/** docs/level-of-detail.md: its example, and the cuts and swaps of the Python client for the same journeys. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { rungs } from "../src/ladder.js";
import { LevelOfDetail, type ChunkSet, type Selection, type ViewOptions } from "../src/levels.js";
import { chunkName, type FittedChunk, type Triple } from "../src/mesh.js";
import { redraws, swaps, swapsInParts } from "../src/swaps.js";
import { given, page, stated } from "./pages.js";

const VOXELS_MAX = 2 ** 40;
const WORLD = {
  low: [-VOXELS_MAX, -VOXELS_MAX, -VOXELS_MAX] as Triple,
  high: [VOXELS_MAX, VOXELS_MAX, VOXELS_MAX] as Triple,
};

type Row = [lod: number, x: number, y: number, z: number, coarser: number];

function rows(chunks: ChunkSet): Row[] {
  const found = Array.from(chunks.values(), ({ lod, x, y, z, coarser }): Row => [lod, x, y, z, coarser]);
  return sorted(found);
}

function sorted(rows: Row[]): Row[] {
  return rows.sort((one, other) => one.map((value, at) => value - other[at]!).find(Boolean) ?? 0);
}

test("the example of the page", () => {
  const says = page("level-of-detail.md");
  const view = stated(says, "view");
  const [low, high] = view.box;
  const levels = new LevelOfDetail(
    { ...WORLD, chunkCells: view.chunk_cells, lods: view.lods, geometricErrors: view.geometric_errors },
    {
      errorPixels: view.error_pixels,
      screenPixels: view.screen_pixels,
      fovDegrees: view.fov_degrees,
      aheadSeconds: view.ahead_seconds,
      reach: view.reach,
      chunksMax: view.chunks_max,
      box: { low, high },
    },
  );
  let selection: Selection | null = null;
  for (const { position, velocity, chunks } of stated(says, "frames")) {
    selection = levels.select(position, velocity, selection);
    assert.deepEqual(rows(selection.chunks), chunks);
  }
});

test("chunks that are still shown are the same objects, whatever comes and goes beside them", () => {
  const lods = 5;
  const levels = new LevelOfDetail({ ...WORLD, chunkCells: 32, lods, geometricErrors: null }, { reach: 2048 });
  let selection = levels.select([-40, 10, 0]);
  let [stayed, changed] = [0, 0];
  for (let x = -40; x < 400; x += 20) {
    const next = levels.select([x, 10, x / 2], [0, 0, 0], selection);
    for (const [name, chunk] of next.chunks) {
      const before = selection.chunks.get(name);
      assert.equal(chunkName(chunk), name);
      if (before !== undefined && chunk.lod < lods - 1) {
        assert.equal(before, chunk);
        stayed += 1;
      }
      changed += before === undefined ? 1 : 0;
    }
    selection = next;
  }
  assert.ok(stayed > 1000 && changed > 100);
});

interface Journey {
  readonly lods: number;
  readonly cells: number;
  readonly errors: number[] | null;
  readonly view: ViewOptions;
  readonly frames: {
    position: Triple;
    velocity: Triple;
    chunks: Row[];
    coarsened: number;
    swaps: Row[][];
    redraws: Row[][];
  }[];
  readonly ladder: { sharpness: number; rungs: [number, number[]][] };
  readonly stale: { lod: number; low: Triple; high: Triple };
}

test("the journeys of the Python client", () => {
  const journeys: Journey[] = JSON.parse(readFileSync(given("CHUNKSERVER_JOURNEYS"), "utf8"));
  let [leaves, coarsened, kept] = [0, 0, 0];
  for (const { lods, cells, errors, view, frames, stale, ladder } of journeys) {
    const off = errors ?? Array.from({ length: lods }, (_, lod) => 0.25 * 2 ** lod);
    const found = rungs(cells, off, ladder.sharpness, view.reach!);
    assert.deepEqual(
      found.map(({ reach, split }) => [reach, split]),
      ladder.rungs,
    );
    const levels = new LevelOfDetail({ ...WORLD, chunkCells: cells, lods, geometricErrors: errors }, view);
    let before = null as Selection | null;
    for (const frame of frames) {
      const selection: Selection = levels.select(frame.position, frame.velocity, before);
      assert.deepEqual(rows(selection.chunks), frame.chunks);
      assert.equal(selection.coarsened, frame.coarsened);
      const isSame: boolean = selection.chunks === before?.chunks;
      assert.equal(isSame, before !== null && rows(before.chunks).join(" ") === frame.chunks.join(" "));
      const groups: Row[][] =
        before === null
          ? []
          : swaps(before.chunks, selection.chunks).map(({ old, new: next }) => rows(new Map([...old, ...next])));
      assert.deepEqual(named(groups), named(frame.swaps));
      assert.deepEqual(named(redraws(selection.chunks, [stale]).map(rows)), named(frame.redraws));
      leaves += frame.chunks.length;
      coarsened += frame.coarsened ? 1 : 0;
      kept += isSame ? 1 : 0;
      before = selection;
    }
  }
  assert.ok(
    journeys.length >= 100 && leaves > 10_000 && coarsened > 20 && kept > 20,
    `${journeys.length} journeys, ${leaves} leaves, ${coarsened} coarsened, ${kept} kept`,
  );
});

/** Groups in whatever order. */
function named(groups: Row[][]): string[] {
  return groups.map((group) => sorted(group).join(" ")).sort();
}

test("swaps in parts are the same, and have other things done in between", () => {
  const world = { ...WORLD, chunkCells: 32, lods: 6, geometricErrors: null };
  const levels = new LevelOfDetail(world, { errorPixels: 2, reach: 8192 });
  const [drawn, wanted] = [levels.select([0, 0, 0]).chunks, levels.select([700, 90, -400]).chunks];
  const parts = swapsInParts(drawn, wanted);
  let count = 0;
  for (let part = parts.next(); ; part = parts.next(), count++) {
    if (part.done === true) {
      assert.deepEqual(part.value, swaps(drawn, wanted));
      break;
    }
  }
  assert.ok(count > 10, `${count} parts of ${drawn.size} and ${wanted.size} chunks`);
});

test("a swap has what goes and what comes", () => {
  const chunk = (lod: number, x: number, coarser = 0): FittedChunk => ({ lod, x, y: 0, z: 0, coarser });
  const set = (...chunks: FittedChunk[]): ChunkSet => new Map(chunks.map((each) => [chunkName(each), each]));
  const [swap, ...others] = swaps(set(chunk(1, 0), chunk(1, 5)), set(chunk(0, 0), chunk(0, 1), chunk(1, 5)));
  assert.deepEqual(
    [[...swap!.old.keys()], [...swap!.new.keys()].sort(), others],
    [["1/0/0/0/0"], ["0/0/0/0/0", "0/1/0/0/0"], []],
  );
});

for (const [what, wanted] of Object.entries({ "as it was": [1, 0], "with another mask": [1, 0, 2], finer: [0, 1] })) {
  test(`a chunk that is out of date goes under the name that it was given, when it is wanted ${what}`, () => {
    const [lod, x, coarser = 0] = wanted as [number, number, number?];
    const [old, fresh] = [
      { lod: 1, x: 0, y: 0, z: 0, coarser: 0 },
      { lod, x, y: 0, z: 0, coarser },
    ];
    const [swap, ...others] = swaps(new Map([["stale", old]]), new Map([[chunkName(fresh), fresh]]));
    assert.deepEqual([[...swap!.old], [...swap!.new], others], [[["stale", old]], [[chunkName(fresh), fresh]], []]);
  });
}

for (const [name, view] of Object.entries<ViewOptions>({
  errorPixels: { errorPixels: 0 },
  screenPixels: { screenPixels: NaN },
  fovDegrees: { fovDegrees: 180 },
  aheadSeconds: { aheadSeconds: -1 },
  chunksMax: { chunksMax: 63 },
  reach: { reach: 16 * 4096 + 1 },
  box: { box: { low: [0, 0, 0], high: [1, 0, 1] } },
})) {
  test(`a view with a bad ${name} is refused by name`, () => {
    assert.throws(
      () => new LevelOfDetail({ ...WORLD, chunkCells: 32, lods: 8, geometricErrors: null }, view),
      new RegExp(`^RangeError: ${name} is `),
    );
  });
}

test("a selection of another object, and what is no point, are refused", () => {
  const world = { ...WORLD, chunkCells: 32, lods: 3, geometricErrors: null };
  const [levels, other] = [new LevelOfDetail(world), new LevelOfDetail(world)];
  assert.throws(() => levels.select([0, 0, 0], [0, 0, 0], other.select([0, 0, 0])), RangeError);
  assert.throws(() => levels.select([0, NaN, 0]), /position is/);
  assert.equal(levels.select([2 ** 50, 0, 0]).chunks.size, 0);
});
