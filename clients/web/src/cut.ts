/**
 * A cut through the octree of a world, for one viewer: docs/level-of-detail.md.
 *
 * Upwards, from the finest level: who is near enough to be split, and whom the balance makes split for it. Downwards:
 * what that leaves, level by level.
 */

import { kept, type Rung } from "./ladder.js";
import { Leaves, type Leaf } from "./leaves.js";
import { Marks, flagsOf, half, isInside, markParents, squaredGaps, type Box, type Frame } from "./marks.js";
import type { Triple } from "./mesh.js";
import type { Parts } from "./parts.js";

/** Chunks around those that are near: two that the balance may split, and the ring around these. */
const MARGIN = 3;
/** Voxels by which a distance is mistrusted before it says that nothing has changed: more than float64 can be off. */
const ROUNDED = 2 ** -6;
/** By child, 4 x + 2 y + z: the faces that are its parent's, too. */
const OUTER_FACES: readonly number[] = [21, 37, 25, 41, 22, 38, 26, 42];

/** Somebody who is somewhere, and on the way to somewhere else. Voxels. */
export interface Viewer {
  readonly at: Triple;
  readonly ahead: Triple;
}

/** Who of a level is marked, for a viewer who asks for all within a distance. */
interface Level {
  readonly marks: Marks;
  readonly distance: number;
  readonly viewer: Viewer;
  /** How far the viewer may move, in voxels, before the marks change. */
  readonly slack: number;
}

/** The leaves of a level, and the marks that they follow from. */
interface Layer {
  readonly from: readonly (Marks | undefined)[];
  readonly leaves: readonly Leaf[];
}

/** What one viewer is shown. */
export interface Cut {
  /** Who of the last level is there. */
  readonly roots: Level;
  /** By LOD, who is split. */
  readonly split: readonly Level[];
  /** By LOD. Those that are the same as in the cut before are the same objects. */
  readonly layers: readonly Layer[];
}

/** All chunks of a world. */
export class Octree {
  private readonly top: number;

  /**
   * @param sides by LOD, in voxels
   * @param box in voxels; chunks have some of it in them
   */
  constructor(
    private readonly sides: readonly number[],
    private readonly box: Box,
  ) {
    this.top = sides.length - 1;
  }

  /** The cut for a viewer, which depends on the one before; null if it has more than `countMax` leaves. */
  *cut(rung: Rung, viewer: Viewer, before: Cut | null, countMax: number): Parts<Cut | null> {
    const roots = this.roots(rung.reach, viewer, before?.roots);
    const split: Level[] = [];
    let isSame = before?.roots.marks === roots.marks;
    for (const [lod, distance] of rung.split.entries()) {
      const was = before?.split[lod];
      const level =
        isSame && was !== undefined && holds(was, distance, viewer)
          ? was
          : this.split(lod, distance, viewer, roots.marks, split[lod - 1]?.marks, was);
      isSame = isSame && was?.marks === level.marks;
      split.push(level);
      if (level.marks.count > countMax) {
        return null; // each has a leaf of its own below it
      }
      yield;
    }
    const layers: Layer[] = [];
    for (const lod of split.keys()) {
      layers.push(this.layer(lod, roots.marks, split, before?.layers[lod]));
      yield;
    }
    const count = layers.reduce((sum, { leaves }) => sum + leaves.length, 0);
    return count > countMax ? null : { roots, split, layers };
  }

  /** Who of the last level is there. */
  private roots(reach: number, viewer: Viewer, before: Level | undefined): Level {
    if (before !== undefined && holds(before, reach, viewer)) {
      return before;
    }
    const frame = this.frame(this.top, reach, viewer);
    return this.level(frame, reach, viewer, before, flagsOf(frame), () => true);
  }

  /** Who of a level is split, being near or for the balance. finer: who is split in the level below. */
  private split(
    lod: number,
    distance: number,
    viewer: Viewer,
    roots: Marks,
    finer: Marks | undefined,
    before: Level | undefined,
  ): Level {
    const frame = this.frame(lod, distance, viewer);
    const flags = flagsOf(frame);
    if (finer === undefined || !distance) {
      return { marks: same(new Marks(frame, flags, 0), before), distance, viewer, slack: Infinity };
    }
    markParents(finer, frame, flags);
    const up = 2 ** (this.top - lod);
    const isBelowRoot = (x: number, y: number, z: number) =>
      roots.has(Math.floor(x / up), Math.floor(y / up), Math.floor(z / up));
    return this.level(frame, distance, viewer, before, flags, isBelowRoot);
  }

  /** Marks who is near, or was marked and is only a quarter further away; `flags` has whom the balance marks. */
  private level(
    frame: Frame,
    distance: number,
    viewer: Viewer,
    before: Level | undefined,
    flags: Uint8Array,
    exists: (x: number, y: number, z: number) => boolean,
  ): Level {
    const { side, low, shape } = frame;
    const keep = kept(distance);
    const [near, within] = [distance * distance, keep * keep];
    const box = boxOf(viewer, distance);
    const [gapsX, gapsY, gapsZ] = [squaredGaps(frame, box, 0), squaredGaps(frame, box, 1), squaredGaps(frame, box, 2)];
    let at = 0;
    let count = 0;
    let nearest = Infinity;
    let farthest = 0;
    for (let i = 0; i < shape[0]; i++) {
      const x = low[0] + i;
      for (let j = 0; j < shape[1]; j++) {
        const y = low[1] + j;
        const square = gapsX[i]! + gapsY[j]!;
        for (let k = 0; k < shape[2]; k++, at++) {
          const z = low[2] + k;
          const distant = square + gapsZ[k]!;
          const isWanted =
            flags[at] === 1 ||
            distant < near ||
            (distant < within && before !== undefined && before.marks.has(x, y, z));
          flags[at] = 0;
          if (!isWanted && distant >= nearest) {
            continue;
          }
          if (!isInside(this.box, side, x, y, z) || !exists(x, y, z)) {
            continue;
          }
          if (!isWanted) {
            nearest = distant;
            continue;
          }
          flags[at] = 1;
          count += 1;
          if (distant < within && distant > farthest) {
            farthest = distant;
          }
        }
      }
    }
    const slack = Math.min(Math.sqrt(nearest) - distance, keep - Math.sqrt(farthest), side);
    return { marks: same(new Marks(frame, flags, count), before), distance, viewer, slack };
  }

  /** A frame around all that a level can have marked for a viewer. */
  private frame(lod: number, distance: number, viewer: Viewer): Frame {
    const side = this.sides[lod]!;
    const near = boxOf(viewer, distance);
    const low: number[] = [];
    const shape: number[] = [];
    for (let axis = 0; axis < 3; axis++) {
      const first = Math.max(
        Math.floor((near.low[axis]! - kept(distance)) / side) - MARGIN,
        Math.floor(this.box.low[axis]! / side) - 1,
      );
      const end =
        Math.min(
          Math.floor((near.high[axis]! + kept(distance)) / side) + MARGIN,
          Math.ceil(this.box.high[axis]! / side),
        ) + 1;
      low.push(first);
      shape.push(Math.max(end - first, 0));
    }
    return { lod, side, low: [low[0]!, low[1]!, low[2]!], shape: [shape[0]!, shape[1]!, shape[2]!] };
  }

  /** The leaves of a level: there, and not split. The layer before, if it follows from the same marks. */
  private layer(lod: number, roots: Marks, split: readonly Level[], before: Layer | undefined): Layer {
    const [here, above, higher] = [split[lod]!.marks, split[lod + 1]?.marks, split[lod + 2]?.marks];
    const from = [here, above ?? roots, higher ?? roots];
    if (before !== undefined && before.from.every((marks, at) => marks === from[at])) {
      return before;
    }
    const side = this.sides[lod]!;
    const leaves = new Leaves(lod, above === undefined ? [] : (before?.leaves ?? []));
    if (above === undefined) {
      roots.forEach((x, y, z) => {
        if (!here.has(x, y, z)) {
          leaves.add(x, y, z, 0);
        }
      });
      return { from, leaves: leaves.all };
    }
    // A chunk of the level above is a leaf if it is there, which its own parent's split makes it, and not split.
    const isLeafAbove = (x: number, y: number, z: number): boolean => {
      const isThere =
        higher === undefined
          ? roots.has(x, y, z)
          : higher.has(half(x), half(y), half(z)) && isInside(this.box, 2 * side, x, y, z);
      return isThere && !above.has(x, y, z);
    };
    above.forEach((px, py, pz) => {
      // Children have outer faces on one side each: the parent beside that is the same for four of them.
      const beside =
        (isLeafAbove(px - 1, py, pz) ? 1 : 0) |
        (isLeafAbove(px + 1, py, pz) ? 2 : 0) |
        (isLeafAbove(px, py - 1, pz) ? 4 : 0) |
        (isLeafAbove(px, py + 1, pz) ? 8 : 0) |
        (isLeafAbove(px, py, pz - 1) ? 16 : 0) |
        (isLeafAbove(px, py, pz + 1) ? 32 : 0);
      for (let child = 0; child < 8; child++) {
        const x = 2 * px + (child >> 2);
        const y = 2 * py + ((child >> 1) & 1);
        const z = 2 * pz + (child & 1);
        if (!here.has(x, y, z) && isInside(this.box, side, x, y, z)) {
          leaves.add(x, y, z, beside & OUTER_FACES[child]!);
        }
      }
    });
    return { from, leaves: leaves.all };
  }
}

/** Whether nothing can have changed. */
function holds(level: Level, distance: number, viewer: Viewer): boolean {
  return (
    distance === level.distance &&
    (moved(viewer, level.viewer) === 0 || moved(viewer, level.viewer) + ROUNDED < level.slack)
  );
}

/** By how much no distance to these two can differ more. */
function moved(viewer: Viewer, other: Viewer): number {
  const axes = [0, 1, 2] as const;
  return Math.hypot(
    ...axes.map(
      (axis) => Math.abs(viewer.at[axis] - other.at[axis]) + Math.abs(viewer.ahead[axis] - other.ahead[axis]),
    ),
  );
}

/** The box between where a viewer is and where he will be; no further ahead than `aheadMax`, on each axis. */
function boxOf({ at, ahead }: Viewer, aheadMax: number): Box {
  const ends = [0, 1, 2].map((axis) => at[axis]! + Math.max(-aheadMax, Math.min(ahead[axis]!, aheadMax)));
  const pick = (choose: (a: number, b: number) => number): Triple => [
    choose(at[0], ends[0]!),
    choose(at[1], ends[1]!),
    choose(at[2], ends[2]!),
  ];
  return { low: pick(Math.min), high: pick(Math.max) };
}

/** The marks of before, if they are the same. */
function same(marks: Marks, before: Level | undefined): Marks {
  return before !== undefined && before.marks.equals(marks) ? before.marks : marks;
}
