/**
 * The mesh of one chunk, and where it is: in exact integers first, in metres when somebody asks.
 *
 * A chunk's own lattice has 32768 units a side; its low face is at 16384. `latticePositions` puts the vertices on one
 * lattice for the whole world, that of LOD 0, where the same point has the same integers whichever chunk, LOD or format
 * it came in.
 */

import { BadChunk } from "./errors.js";

/** x, y, z. */
export type Triple = readonly [number, number, number];
export type Content = "air" | "rock" | "surface";
export type Profile = "std" | "f32";

/** In the order of their numbers in files. */
export const CONTENTS: readonly Content[] = ["air", "rock", "surface"];
/** Lattice units from a chunk's low face to its high face. */
export const UNITS_PER_SIDE = 32768;
/** Where the low face is on the chunk's own lattice. */
export const POSITION_LOW = 16384;
export const POSITION_MAX = 65535;
export const CELLS_BUILT: readonly number[] = [16, 32, 64];
export const LOD_MAX = 20;
export const COARSER_MAX = 63;
export const REVISION_MAX = (1n << 63n) - 1n;
export const VOXEL_SIZE_MIN = 2 ** -20;
export const VOXEL_SIZE_MAX = 2 ** 20;
/** Corners of chunks lie within so many voxels of the origin, on each axis. */
export const VOXELS_MAX = 2 ** 40;
export const VERTICES_MAX = 1 << 24;
export const INDICES_MAX = 3 << 25;

/** Which chunk: its level of detail, 0 the finest, and its coordinates in chunks of that level. */
export interface ChunkKey {
  readonly lod: number;
  readonly x: number;
  readonly y: number;
  readonly z: number;
}

/** A chunk, and which of its faces have to fit a coarser one: -x 1, +x 2, -y 4, +y 8, -z 16, +z 32. */
export interface FittedChunk extends ChunkKey {
  readonly coarser: number;
}

/** Which chunk of which grid. */
export interface Place {
  readonly key: ChunkKey;
  /** Cells a side: 16, 32 or 64. */
  readonly cells: number;
  /** Metres. */
  readonly voxelSize: number;
}

/** The mesh of one chunk. Its arrays are views into the bytes that it was decoded from: nothing is copied. */
export interface ChunkMesh extends Place {
  /** Of the chunk's own last edit; 0 is pristine. */
  readonly revision: bigint;
  /** "air" and "rock" are empty chunks, which have neither vertices nor triangles. */
  readonly content: Content;
  /** Mask of the faces that fit a neighbour one LOD coarser: -x 1, +x 2, -y 4, +y 8, -z 16, +z 32. */
  readonly coarser: number;
  /** Metres by which the surface may be off; null if the file does not say. */
  readonly geometricError: number | null;
  /** Which types positions and normals have. A GLB is "std". */
  readonly profile: Profile;
  /** Bounds of the vertices on the chunk's own lattice, whatever the profile; zeros in an empty chunk. */
  readonly low: Triple;
  readonly high: Triple;
  readonly vertexCount: number;
  /** Numbers a vertex has in `positions` and in `normals`: 4 in "std", the fourth being padding, 3 in "f32". */
  readonly components: 3 | 4;
  /** "std": units of the chunk's own lattice. "f32": metres from its low corner. */
  readonly positions: Uint16Array | Float32Array;
  /** Into the air. "std": a component is 127 times that of the unit vector. */
  readonly normals: Int8Array | Float32Array;
  /** Three a triangle, counter-clockwise seen from the air. Every index is below `vertexCount`. */
  readonly indices: Uint16Array | Uint32Array;
}

/** The name of a key, the same for equal ones: "lod/x/y/z". */
export function keyName({ lod, x, y, z }: ChunkKey): string {
  return `${lod}/${x}/${y}/${z}`;
}

/** The name of a chunk with its mask: "lod/x/y/z/coarser". */
export function chunkName({ lod, x, y, z, coarser }: FittedChunk): string {
  return `${lod}/${x}/${y}/${z}/${coarser}`;
}

/** Voxels along a side. */
export function sideOf({ key, cells }: Place): number {
  return cells * 2 ** key.lod;
}

/** Metres per unit of the chunk's own lattice: the voxel size times a power of two, so it is exact. */
export function unitOf(place: Place): number {
  return (place.voxelSize * sideOf(place)) / UNITS_PER_SIDE;
}

/** Voxels from the world's origin to the low corner. */
export function cornerOf(place: Place): Triple {
  const side = sideOf(place);
  return [place.key.x * side, place.key.y * side, place.key.z * side];
}

/** The square of the distance from a point to the nearest of the chunk, in voxels. */
export function squaredDistance(place: Place, viewer: Triple): number {
  const side = sideOf(place);
  const gaps = cornerOf(place).map((low, axis) => Math.max(low - viewer[axis]!, viewer[axis]! - low - side, 0));
  return gaps.reduce((sum, gap) => sum + gap * gap, 0);
}

/** @throws {BadChunk} which names the value, if there can be no such chunk. */
export function checkPlace(place: Place): void {
  const { key, cells, voxelSize } = place;
  if (!CELLS_BUILT.includes(cells)) {
    throw new BadChunk(`cells is ${cells}: there are ${CELLS_BUILT.join(", ")}`);
  }
  if (!(key.lod >= 0 && key.lod <= LOD_MAX)) {
    throw new BadChunk(`lod is ${key.lod}: there are 0 to ${LOD_MAX}`);
  }
  if (!(voxelSize >= VOXEL_SIZE_MIN && voxelSize <= VOXEL_SIZE_MAX)) {
    throw new BadChunk(`voxel size is ${voxelSize}: it is 2^-20 to 2^20 metres`);
  }
  const most = VOXELS_MAX - sideOf(place);
  if (!cornerOf(place).every((low) => low >= -VOXELS_MAX && low <= most)) {
    throw new BadChunk(`${keyName(key)} lies more than ${VOXELS_MAX} voxels from the origin`);
  }
}

/** The mesh of a chunk that is all air or all rock. */
export function emptyMesh(
  place: Place,
  told: Pick<ChunkMesh, "content" | "revision" | "coarser" | "geometricError">,
): ChunkMesh {
  return {
    ...place,
    ...told,
    profile: "std",
    low: [0, 0, 0],
    high: [0, 0, 0],
    vertexCount: 0,
    components: 4,
    positions: new Uint16Array(0),
    normals: new Int8Array(0),
    indices: new Uint16Array(0),
  };
}

/**
 * x, y, z of each vertex on the world's lattice, 32768 / cells units a voxel. Exact.
 *
 * Equal points have equal integers, from whichever chunk and LOD of a world: weld by equality. A float of profile "f32"
 * is one rounding away from an integer times the unit, and the nearest integer is the one that was meant.
 */
export function latticePositions(mesh: ChunkMesh): Float64Array {
  return onLattice(mesh, [0, 0, 0], 1);
}

/**
 * x, y, z of each vertex, metres from an integer point in voxels that the caller chooses.
 *
 * The difference is taken in integers; times the voxel size it is rounded once, or not at all if that is a power of
 * two. So vertices that are equal stay equal, and for an origin nearby the numbers are small enough for float32.
 *
 * @throws {RangeError} if `origin` lies outside the world.
 */
export function positionsInMetres(mesh: ChunkMesh, origin: Triple = [0, 0, 0]): Float64Array {
  if (origin.length !== 3 || !origin.every((voxel) => Number.isInteger(voxel) && Math.abs(voxel) <= VOXELS_MAX)) {
    throw new RangeError(`origin is ${origin}: three integers, within ${VOXELS_MAX} voxels of zero`);
  }
  return onLattice(mesh, origin, (mesh.voxelSize * mesh.cells) / UNITS_PER_SIDE);
}

function onLattice(mesh: ChunkMesh, origin: Triple, unit: number): Float64Array {
  const { key, cells, components, positions, vertexCount } = mesh;
  const step = 2 ** key.lod;
  const places = [key.x, key.y, key.z];
  const low = places.map(
    (place, axis) => (place * UNITS_PER_SIDE - POSITION_LOW) * step - origin[axis]! * (UNITS_PER_SIDE / cells),
  );
  const own = mesh.profile === "f32" ? unitOf(mesh) : 0;
  const found = new Float64Array(3 * vertexCount);
  for (let vertex = 0; vertex < vertexCount; vertex++) {
    for (let axis = 0; axis < 3; axis++) {
      const stored = positions[vertex * components + axis]!;
      const position = own ? Math.round(stored / own) + POSITION_LOW : stored;
      found[3 * vertex + axis] = (position * step + low[axis]!) * unit;
    }
  }
  return found;
}

/** @throws {BadChunk} if an index names no vertex. */
export function checkIndices(indices: Uint16Array | Uint32Array, vertices: number): void {
  let highest = -1;
  for (let at = 0; at < indices.length; at++) {
    const index = indices[at]!;
    highest = index > highest ? index : highest;
  }
  if (highest >= vertices) {
    throw new BadChunk(`an index is ${highest}: there are ${vertices} vertices`);
  }
}

/** @throws {BadChunk} if the bounds are the wrong way round. */
export function checkBounds(low: Triple, high: Triple): void {
  if (low.some((least, axis) => least > high[axis]!)) {
    throw new BadChunk(`low is ${low}, above high, ${high}`);
  }
}
