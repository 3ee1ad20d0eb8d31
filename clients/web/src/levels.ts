/**
 * Which chunks to show a viewer, and how each has to fit its neighbours: docs/level-of-detail.md.
 *
 *     const levels = new LevelOfDetail(world);
 *     let selection = levels.select(position);
 *     for await (const mesh of client.chunks(world, selection.chunks.values(), { viewer: position })) { ... }
 *     selection = levels.select(position, velocity, selection);
 */

import { Octree, type Cut, type Viewer } from "./cut.js";
import type { Descriptor } from "./descriptors.js";
import { WIDTHS_MAX, roomy, rungs, type Rung } from "./ladder.js";
import type { Box } from "./marks.js";
import type { FittedChunk, Triple } from "./mesh.js";
import { inOne, type Parts } from "./parts.js";

/** How far a surface may be off, in cells, where the descriptor does not say. */
const ERROR_OF_A_CELL = 0.25;
/** Chunks of LOD 0 that are within reach at least, where nobody says. */
const REACH_CHUNKS_MIN = 8;
const CHUNKS_MAX = 16384;
/** More than the last rung of the ladder can have. */
const CHUNKS_LEAST = 64;
/** Voxels. Nothing is within reach of who is further out. */
const VIEWER_MAX = 2 ** 42;

/** Chunks by their `chunkName`. */
export type ChunkSet = ReadonlyMap<string, FittedChunk>;

/** What to show. */
export interface Selection {
  /** They fill what is within reach and do not overlap. The same object as long as nothing changes. */
  readonly chunks: ChunkSet;
  /** How much had to be given up to have `chunksMax` chunks at most; 0 is nothing. */
  readonly coarsened: number;
}

/** The client's choice. */
export interface ViewOptions {
  /** How far the surface may seem to be off before a chunk is split; 4. It merges again at four fifths. */
  readonly errorPixels?: number;
  /** Height of the picture; 1080. */
  readonly screenPixels?: number;
  /** Its vertical angle; 60. */
  readonly fovDegrees?: number;
  /** How much of the viewer's way is looked ahead; 1. */
  readonly aheadSeconds?: number;
  /**
   * Chunks of the last level are shown if they are nearer, in voxels. By default the width of one, and at least 8
   * chunks of LOD 0; at most 16 of the last level.
   */
  readonly reach?: number;
  /** Where there is anything, in voxels. Chunks that have none of it in them are left out. */
  readonly box?: Box;
  /** At least 64, 16384 by default; what is given up for it first is seen least. */
  readonly chunksMax?: number;
}

/**
 * Cuts the octree of a world so that nothing that is seen is off by more than some pixels.
 *
 * Chunks that touch, also at an edge or a corner, differ by one level at most.
 */
export class LevelOfDetail {
  private readonly octree: Octree;
  private readonly rungs: readonly Rung[];
  private readonly aheadSeconds: number;
  private readonly chunksMax: number;
  private readonly cuts = new WeakMap<Selection, Cut>();

  /** @throws {RangeError} which names the value, for what makes no view */
  constructor(
    world: Pick<Descriptor, "chunkCells" | "lods" | "low" | "high" | "geometricErrors">,
    options: ViewOptions = {},
  ) {
    const { errorPixels = 4, screenPixels = 1080, fovDegrees = 60, aheadSeconds = 1, chunksMax = CHUNKS_MAX } = options;
    const sides = Array.from({ length: world.lods }, (_, lod) => world.chunkCells * 2 ** lod);
    const widest = sides.at(-1)!;
    const reach = options.reach ?? Math.max(widest, REACH_CHUNKS_MIN * world.chunkCells);
    check(errorPixels > 0 && errorPixels < Infinity, "errorPixels", errorPixels, "a positive number");
    check(screenPixels > 0 && screenPixels < Infinity, "screenPixels", screenPixels, "a positive number");
    check(fovDegrees > 0 && fovDegrees < 180, "fovDegrees", fovDegrees, "between 0 and 180");
    check(aheadSeconds >= 0 && aheadSeconds < Infinity, "aheadSeconds", aheadSeconds, "not negative");
    check(chunksMax >= CHUNKS_LEAST, "chunksMax", chunksMax, `at least ${CHUNKS_LEAST}`);
    const isReach = Number.isInteger(reach) && reach > 0 && reach <= WIDTHS_MAX * widest;
    check(isReach, "reach", reach, `1 to ${WIDTHS_MAX * widest} whole voxels`);
    this.octree = new Octree(sides, boxOf(world, options.box ?? world, widest));
    this.aheadSeconds = aheadSeconds;
    this.chunksMax = chunksMax;
    const errors = world.geometricErrors ?? sides.map((_, lod) => ERROR_OF_A_CELL * 2 ** lod);
    const sharpness = screenPixels / (2 * Math.tan((fovDegrees * (Math.PI / 180)) / 2)) / errorPixels;
    this.rungs = rungs(world.chunkCells, errors, sharpness, reach);
  }

  /**
   * What to show to a viewer. If that is the same as before, so is the object in `chunks`.
   *
   * @param position x, y, z in voxels
   * @param velocity voxels a second
   * @param previous what this object has returned for the frame before; whatever was split then merges later
   * @throws {RangeError} for what is no finite point, and for a selection of another object
   */
  select(position: Triple, velocity: Triple = [0, 0, 0], previous: Selection | null = null): Selection {
    return inOne(this.selectInParts(position, velocity, previous));
  }

  /** The same as `select`, in parts. */
  *selectInParts(position: Triple, velocity: Triple = [0, 0, 0], previous: Selection | null = null): Parts<Selection> {
    const before = previous === null ? null : this.cuts.get(previous);
    if (before === undefined) {
      throw new RangeError("previous is a selection of another LevelOfDetail");
    }
    const [vx, vy, vz] = velocity;
    const seconds = this.aheadSeconds;
    const viewer = {
      at: voxels("position", position),
      ahead: voxels("velocity", [vx * seconds, vy * seconds, vz * seconds]),
    };
    const [coarsened, cut] = yield* this.finest(viewer, before, previous?.coarsened ?? 0);
    const isSame =
      previous !== null && before !== null && cut.layers.every((layer, lod) => layer === before.layers[lod]);
    const selection = { chunks: isSame ? previous.chunks : yield* chunksOf(cut), coarsened };
    this.cuts.set(selection, cut);
    return selection;
  }

  /** The finest cut that is not too large, and its rung. A finer one than before needs room to spare. */
  private *finest(viewer: Viewer, before: Cut | null, rung: number): Parts<[number, Cut]> {
    let number = rung;
    while (
      number > 0 &&
      (yield* this.octree.cut(roomy(this.rungs[number - 1]!), viewer, null, this.chunksMax)) !== null
    ) {
      number -= 1;
    }
    for (; ; number++) {
      const cut = yield* this.octree.cut(this.rungs[number]!, viewer, before, this.chunksMax);
      if (cut !== null) {
        return [number, cut];
      }
    }
  }
}

function* chunksOf({ layers }: Cut): Parts<ChunkSet> {
  const chunks = new Map<string, FittedChunk>();
  for (const { leaves } of layers) {
    for (const leaf of leaves) {
      chunks.set(leaf[0], leaf[1]);
    }
    yield;
  }
  return chunks;
}

function voxels(name: string, point: Triple): Triple {
  check(point.length === 3 && point.every(Number.isFinite), name, point, "three finite numbers");
  const [x, y, z] = point.map((place) => Math.floor(Math.max(-VIEWER_MAX, Math.min(place, VIEWER_MAX))));
  return [x!, y!, z!];
}

/** The part of a box that chunks of the last level can hold. widest: their width. */
function boxOf(world: Box, box: Box, widest: number): Box {
  const { low, high } = box;
  check(
    low.length === 3 && high.length === 3 && low.every((least, axis) => least < high[axis]!),
    "box",
    `${low} to ${high}`,
    "low < high",
  );
  const from = low.map((place, axis) => Math.max(Math.trunc(place), Math.ceil(world.low[axis]! / widest) * widest));
  const to = high.map((place, axis) => Math.min(Math.trunc(place), Math.floor(world.high[axis]! / widest) * widest));
  return { low: [from[0]!, from[1]!, from[2]!], high: [to[0]!, to[1]!, to[2]!] };
}

function check(holds: boolean, name: string, value: unknown, expected: string): void {
  if (!holds) {
    throw new RangeError(`${name} is ${value}: expected ${expected}`);
  }
}
