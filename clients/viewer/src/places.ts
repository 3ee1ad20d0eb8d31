/** Where chunks are: which of them are near, and which one a point is in. cells: of a chunk's side */

import type { ChunkSet, FittedChunk, Triple } from "chunkserver-client";

import type { Named } from "./fetching.js";

/** The nearest first, of two that are as near the coarser. */
export function byDistance(sets: readonly ChunkSet[], [x, y, z]: Triple, cells: number): Named[] {
  const gap = (at: number, low: number, side: number) => Math.max(low - at, at - low - side, 0);
  const rows: { named: Named; square: number; lod: number }[] = [];
  for (const set of sets) {
    set.forEach((chunk, name) => {
      const side = cells * 2 ** chunk.lod;
      const [dx, dy, dz] = [gap(x, chunk.x * side, side), gap(y, chunk.y * side, side), gap(z, chunk.z * side, side)];
      rows.push({ named: [name, chunk], square: dx * dx + dy * dy + dz * dz, lod: chunk.lod });
    });
  }
  rows.sort((one, other) => one.square - other.square || other.lod - one.lod);
  return rows.map(({ named }) => named);
}

/** Whether a point is in a chunk, in voxels. */
export function isIn(point: Triple, chunk: FittedChunk, cells: number): boolean {
  const side = cells * 2 ** chunk.lod;
  return (
    Math.floor(point[0] / side) === chunk.x &&
    Math.floor(point[1] / side) === chunk.y &&
    Math.floor(point[2] / side) === chunk.z
  );
}
