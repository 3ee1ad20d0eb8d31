/** Where a session looks. */

import { LOD_MAX, VOXELS_MAX, type ChunkKey, type Triple } from "../mesh.js";

/**
 * A box of voxels from `low` to `high`, both included: x, y, z.
 *
 * Edits that may change a chunk of level `lod` (20 if left out), or of a finer one, that meets the box are in the
 * region.
 */
export interface Region {
  readonly low: Triple;
  readonly high: Triple;
  readonly lod?: number;
}

/** Regions by what they are. */
export type Regions = ReadonlyMap<string, Region>;

/** Of a connection. */
const REGIONS_MAX = 64;

/** @throws {RangeError} for what is no region, and for more of them than a connection may have */
export function regionsOf(...regions: readonly Region[]): Map<string, Region> {
  const found = new Map(regions.map((region) => [JSON.stringify(written(region)), region]));
  if (found.size > REGIONS_MAX) {
    throw new RangeError(`${found.size} regions: a session looks at ${REGIONS_MAX} at most`);
  }
  return found;
}

/** A region as JSON's values. @throws {RangeError} which names it, if it is none */
export function written({ low, high, lod = LOD_MAX }: Region): { min: Triple; max: Triple; lod: number } {
  const isVoxel = (place: number) => Number.isInteger(place) && Math.abs(place) <= VOXELS_MAX;
  const isBox = low.length === 3 && high.length === 3 && [...low, ...high].every(isVoxel);
  const isRegion = isBox && low.every((first, axis) => first <= high[axis]!) && lod >= 0 && lod <= LOD_MAX;
  if (!isRegion || !Number.isInteger(lod)) {
    const told = JSON.stringify({ low, high, lod });
    throw new RangeError(`${told}: low is nowhere above high, both whole and within 2^40, and lod is 0 to ${LOD_MAX}`);
  }
  return { min: low, max: high, lod };
}

/** Whether a region tells of edits in a chunk. cells: of a chunk's side. */
export function holds({ low, high, lod = LOD_MAX }: Region, key: ChunkKey, cells: number): boolean {
  const side = cells * 2 ** key.lod;
  const places = [key.x, key.y, key.z];
  return (
    key.lod <= lod && places.every((place, axis) => place * side <= high[axis]! && low[axis]! <= (place + 1) * side)
  );
}
