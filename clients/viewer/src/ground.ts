/** What is drawn, to be met by rays and balls; places in voxels. */

import { cornerOf, sideOf, type ChunkMesh, type Triple } from "chunkserver-client";

import { Bins, type Met } from "./bins.js";
import { minus, scaled } from "./vectors.js";

const UNITS = 32768;
const LOW = 16384;

/** Where a ray meets the ground. along: in lengths of its direction. */
export interface Hit extends Met {
  readonly mesh: ChunkMesh;
}

interface Body {
  readonly mesh: ChunkMesh;
  /** Bounds of the triangles, in voxels. */
  readonly low: Triple;
  readonly high: Triple;
  /** Voxels a lattice unit. */
  readonly unit: number;
  bins: Bins | null;
}

export class Ground {
  private readonly bodies = new Map<ChunkMesh, Body>();

  add(mesh: ChunkMesh): void {
    const unit = sideOf(mesh) / UNITS;
    const corner = cornerOf(mesh);
    const place = (point: Triple) => corner.map((low, axis) => low + (point[axis]! - LOW) * unit) as unknown as Triple;
    this.bodies.set(mesh, { mesh, low: place(mesh.low), high: place(mesh.high), unit, bins: null });
  }

  remove(mesh: ChunkMesh): void {
    this.bodies.delete(mesh);
  }

  /** The first triangle along a ray, at most `longest` lengths of its direction away. */
  ray(origin: Triple, direction: Triple, longest: number): Hit | null {
    const entered: { body: Body; at: number }[] = [];
    for (const body of this.bodies.values()) {
      const at = entry(body, origin, direction, longest);
      if (at !== null) {
        entered.push({ body, at });
      }
    }
    entered.sort((one, other) => one.at - other.at);
    let best: Hit | null = null;
    for (const { body, at } of entered) {
      if (best !== null && at > best.along) {
        break;
      }
      const along = scaled(direction, 1 / body.unit);
      const met = binsOf(body).ray(onLattice(body, origin), along, 0, best?.along ?? longest);
      if (met !== null && met.along < (best?.along ?? Infinity)) {
        best = { ...met, mesh: body.mesh };
      }
    }
    return best;
  }

  /** How to move a ball, in voxels, out of what it reaches into furthest; null if it touches nothing. */
  push(centre: Triple, radius: number): Triple | null {
    let found: Triple | null = null;
    let deepest = 0;
    for (const body of this.bodies.values()) {
      if (isApart(body, centre, radius)) {
        continue;
      }
      const out = binsOf(body).push(onLattice(body, centre), radius / body.unit);
      if (out !== null) {
        const moved = scaled(out, body.unit);
        const depth = Math.hypot(...moved);
        if (depth > deepest) {
          [found, deepest] = [moved, depth];
        }
      }
    }
    return found;
  }

  /** A distance in voxels within which there is no ground; 0 within the bounds of a chunk. */
  clearance(point: Triple): number {
    let least = Infinity;
    const [x, y, z] = point;
    for (const { low, high } of this.bodies.values()) {
      const dx = Math.max(low[0] - x, x - high[0], 0);
      const dy = Math.max(low[1] - y, y - high[1], 0);
      const dz = Math.max(low[2] - z, z - high[2], 0);
      least = Math.min(least, dx * dx + dy * dy + dz * dz);
    }
    return Math.sqrt(least);
  }
}

function binsOf(body: Body): Bins {
  body.bins ??= new Bins(body.mesh);
  return body.bins;
}

function onLattice({ mesh, unit }: Body, point: Triple): Triple {
  const [x, y, z] = scaled(minus(point, cornerOf(mesh)), 1 / unit);
  return [x + LOW, y + LOW, z + LOW];
}

/** Whether a ball is outside a body's bounds. */
function isApart({ low, high }: Body, centre: Triple, radius: number): boolean {
  for (let axis = 0; axis < 3; axis++) {
    if (centre[axis]! + radius < low[axis]! || centre[axis]! - radius > high[axis]!) {
      return true;
    }
  }
  return false;
}

/** Where a ray enters a body's bounds; null if it does not. */
function entry({ low, high }: Body, origin: Triple, direction: Triple, longest: number): number | null {
  let enter = 0;
  let leave = longest;
  for (let axis = 0; axis < 3; axis++) {
    if (direction[axis] === 0) {
      if (origin[axis]! < low[axis]! || origin[axis]! > high[axis]!) {
        return null;
      }
      continue;
    }
    const one = (low[axis]! - origin[axis]!) / direction[axis]!;
    const other = (high[axis]! - origin[axis]!) / direction[axis]!;
    enter = Math.max(enter, Math.min(one, other));
    leave = Math.min(leave, Math.max(one, other));
  }
  return enter <= leave ? enter : null;
}
