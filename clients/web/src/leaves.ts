/** The leaves of one level. Those of the cut before are taken over with their names, which take longer than all else. */

import { half } from "./marks.js";
import { chunkName, type FittedChunk } from "./mesh.js";

/** A chunk and its `chunkName`. */
export type Leaf = readonly [name: string, chunk: FittedChunk];

/** Leaves are added in one order, by which those of before are found: by their parents, x first, and then by x, y, z. */
export class Leaves {
  readonly all: Leaf[] = [];
  /** The first of before that may come yet. */
  private at = 0;

  constructor(
    private readonly lod: number,
    private readonly before: readonly Leaf[],
  ) {}

  add(x: number, y: number, z: number, coarser: number): void {
    const { before } = this;
    let order = 1;
    while (this.at < before.length && (order = compare(before[this.at]![1], x, y, z)) < 0) {
      this.at += 1;
    }
    const same = order === 0 ? before[this.at++]! : null;
    if (same !== null && same[1].coarser === coarser) {
      this.all.push(same);
    } else {
      const chunk = { lod: this.lod, x, y, z, coarser };
      this.all.push([chunkName(chunk), chunk]);
    }
  }
}

/** Below 0 if the chunk is before that place, 0 if it is there. */
function compare(chunk: FittedChunk, x: number, y: number, z: number): number {
  return (
    half(chunk.x) - half(x) ||
    half(chunk.y) - half(y) ||
    half(chunk.z) - half(z) ||
    chunk.x - x ||
    chunk.y - y ||
    chunk.z - z
  );
}
