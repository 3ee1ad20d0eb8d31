/** Some chunks of a level, as one byte for each chunk of a box of them. */

import type { Triple } from "./mesh.js";

/** Which chunks an array is about, x slowest. */
export interface Frame {
  readonly lod: number;
  /** Of each chunk, in voxels. */
  readonly side: number;
  /** The first one, in chunks. */
  readonly low: Triple;
  /** How many, on each axis. */
  readonly shape: Triple;
}

/** A box in voxels, both ends included. */
export interface Box {
  readonly low: Triple;
  readonly high: Triple;
}

/** Which chunks of a frame are marked. */
export class Marks {
  constructor(
    readonly frame: Frame,
    readonly flags: Uint8Array,
    /** How many are marked. */
    readonly count: number,
  ) {}

  /** Whether a chunk is marked; one outside the frame is not. */
  has(x: number, y: number, z: number): boolean {
    const { low, shape } = this.frame;
    const i = x - low[0];
    const j = y - low[1];
    const k = z - low[2];
    const isInside = i >= 0 && i < shape[0] && j >= 0 && j < shape[1] && k >= 0 && k < shape[2];
    return isInside && this.flags[(i * shape[1] + j) * shape[2] + k] === 1;
  }

  /** Calls `visit` with each chunk that is marked. */
  forEach(visit: (x: number, y: number, z: number) => void): void {
    const { low, shape } = this.frame;
    let at = 0;
    for (let x = low[0]; x < low[0] + shape[0]; x++) {
      for (let y = low[1]; y < low[1] + shape[1]; y++) {
        for (let z = low[2]; z < low[2] + shape[2]; z++, at++) {
          if (this.flags[at]) {
            visit(x, y, z);
          }
        }
      }
    }
  }

  /** Whether the same chunks are marked, in whatever frame. */
  equals(other: Marks): boolean {
    let isSame = this.count === other.count;
    if (isSame) {
      this.forEach((x, y, z) => (isSame &&= other.has(x, y, z)));
    }
    return isSame;
  }
}

/** A frame with nothing marked in it, to write in. */
export function flagsOf({ shape }: Frame): Uint8Array {
  return new Uint8Array(shape[0] * shape[1] * shape[2]);
}

/** Whether a chunk has some of a box in it. side: of the chunk, in voxels. */
export function isInside(box: Box, side: number, x: number, y: number, z: number): boolean {
  return (
    x * side < box.high[0] &&
    (x + 1) * side > box.low[0] &&
    y * side < box.high[1] &&
    (y + 1) * side > box.low[1] &&
    z * side < box.high[2] &&
    (z + 1) * side > box.low[2]
  );
}

/** By place on an axis of a frame, the square of the gap between a chunk and the viewer; 0 where they meet. */
export function squaredGaps({ side, low, shape }: Frame, viewer: Box, axis: 0 | 1 | 2): Float64Array {
  const squares = new Float64Array(shape[axis]);
  for (let at = 0; at < squares.length; at++) {
    const start = (low[axis] + at) * side;
    const gap = Math.max(start - viewer.high[axis], viewer.low[axis] - (start + side), 0);
    squares[at] = gap * gap;
  }
  return squares;
}

/**
 * Marks in `flags`, of the level above, the parents of all chunks that are, or touch, one of `finer`.
 *
 * Along an axis, chunk i touches i - 1 and i + 1: its own parent, and the one beside that which is nearer.
 */
export function markParents(finer: Marks, frame: Frame, flags: Uint8Array): void {
  const [low, shape] = [frame.low, frame.shape];
  finer.forEach((x, y, z) => {
    for (let i = half(x - 1) - low[0]; i <= half(x + 1) - low[0]; i++) {
      for (let j = half(y - 1) - low[1]; j <= half(y + 1) - low[1]; j++) {
        for (let k = half(z - 1) - low[2]; k <= half(z + 1) - low[2]; k++) {
          if (i >= 0 && i < shape[0] && j >= 0 && j < shape[1] && k >= 0 && k < shape[2]) {
            flags[(i * shape[1] + j) * shape[2] + k] = 1;
          }
        }
      }
    }
  });
}

/** Chunk coordinates have more than 32 bits: no shifts. */
export function half(place: number): number {
  return Math.floor(place / 2);
}
