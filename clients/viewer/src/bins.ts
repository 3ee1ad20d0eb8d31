/**
 * The triangles of a chunk in a grid of bins, so that rays and balls meet few of them.
 *
 * All of it is on the chunk's own lattice: whoever asks has brought ray or ball there. Made when first asked for.
 */

import type { ChunkMesh, Triple } from "chunkserver-client";

import { dot, minus, plus } from "./vectors.js";

const SIDE = 16;
/** Thinner boxes, of a plane say, have bins that wide in lattice units. */
const WIDTH_MIN = 64;

/** Where a ray meets a triangle: how far along, in lengths of its direction, and that triangle's normal. */
export interface Met {
  readonly along: number;
  readonly normal: Triple;
}

export class Bins {
  private readonly low: Triple;
  private readonly width: Triple;
  private readonly starts: Uint32Array;
  private readonly triangles: Uint32Array;

  constructor(private readonly mesh: ChunkMesh) {
    this.low = mesh.low;
    const wide = (axis: number) => Math.max((mesh.high[axis]! - mesh.low[axis]!) / SIDE, WIDTH_MIN);
    this.width = [wide(0), wide(1), wide(2)];
    const count = mesh.indices.length / 3;
    const spans = this.spans(count);
    this.starts = new Uint32Array(SIDE ** 3 + 1);
    inBins(spans, this.starts, null);
    for (let bin = 0; bin < SIDE ** 3; bin++) {
      this.starts[bin + 1]! += this.starts[bin]!;
    }
    this.triangles = new Uint32Array(this.starts[SIDE ** 3]!);
    inBins(spans, this.starts.slice(), this.triangles);
  }

  /** The first triangle that a ray meets between two places along it; null if there is none. */
  ray(origin: Triple, direction: Triple, from: number, to: number): Met | null {
    let [enter, leave] = [from, to];
    for (let axis = 0; axis < 3; axis++) {
      const [low, high] = [this.low[axis]!, this.low[axis]! + this.width[axis]! * SIDE];
      const [one, other] = [(low - origin[axis]!) / direction[axis]!, (high - origin[axis]!) / direction[axis]!];
      if (direction[axis] === 0) {
        if (origin[axis]! < low || origin[axis]! > high) {
          return null;
        }
      } else {
        enter = Math.max(enter, Math.min(one, other));
        leave = Math.min(leave, Math.max(one, other));
      }
    }
    if (enter > leave) {
      return null;
    }
    const at = plus(origin, direction, enter);
    const place = [0, 1, 2].map((axis) => this.binAlong(axis, at[axis]!)) as [number, number, number];
    const step = direction.map(Math.sign);
    const next = place.map((bin, axis) => this.crossing(axis, bin, origin, direction));
    for (;;) {
      const axis = next[0]! < next[1]! ? (next[0]! < next[2]! ? 0 : 2) : next[1]! < next[2]! ? 1 : 2;
      const found = this.nearest(place, origin, direction, from, Math.min(next[axis]!, leave));
      if (found !== null || next[axis]! > leave) {
        return found;
      }
      place[axis]! += step[axis]!;
      if (place[axis]! < 0 || place[axis]! >= SIDE) {
        return null;
      }
      next[axis] = this.crossing(axis, place[axis]!, origin, direction);
    }
  }

  /** How to move a ball so that it is out of the triangle into which it reaches furthest; null if it is in none. */
  push(centre: Triple, radius: number): Triple | null {
    const from = [0, 1, 2].map((axis) => this.binAlong(axis, centre[axis]! - radius));
    const to = [0, 1, 2].map((axis) => this.binAlong(axis, centre[axis]! + radius));
    let deepest = 0;
    let found: Triple | null = null;
    for (let z = from[2]!; z <= to[2]!; z++) {
      for (let y = from[1]!; y <= to[1]!; y++) {
        for (let x = from[0]!; x <= to[0]!; x++) {
          const bin = x + SIDE * (y + SIDE * z);
          for (let at = this.starts[bin]!; at < this.starts[bin + 1]!; at++) {
            const [a, b, c] = this.corners(this.triangles[at]!);
            const away = minus(centre, nearestOf(a!, b!, c!, centre));
            const distance = Math.sqrt(dot(away, away));
            const depth = radius - distance;
            if (depth > deepest && distance > 0 && dot(away, normalOf(a!, b!, c!)) > 0) {
              deepest = depth;
              const times = depth / distance;
              found = [away[0] * times, away[1] * times, away[2] * times];
            }
          }
        }
      }
    }
    return found;
  }

  /** How far along a ray leaves a bin on an axis. */
  private crossing(axis: number, bin: number, origin: Triple, direction: Triple): number {
    const side = direction[axis]! > 0 ? bin + 1 : bin;
    return direction[axis] === 0
      ? Infinity
      : (this.low[axis]! + side * this.width[axis]! - origin[axis]!) / direction[axis]!;
  }

  private nearest(place: Triple, origin: Triple, direction: Triple, from: number, to: number): Met | null {
    const bin = place[0] + SIDE * (place[1] + SIDE * place[2]);
    let best: Met | null = null;
    for (let at = this.starts[bin]!; at < this.starts[bin + 1]!; at++) {
      const [a, b, c] = this.corners(this.triangles[at]!);
      const along = meets(origin, direction, a!, b!, c!);
      if (along !== null && along >= from && along <= to * (1 + 1e-9) && along < (best?.along ?? Infinity)) {
        best = { along, normal: normalOf(a!, b!, c!) };
      }
    }
    return best;
  }

  private corners(triangle: number): Triple[] {
    const { indices, positions, components } = this.mesh;
    return [0, 1, 2].map((corner) => {
      const at = indices[3 * triangle + corner]! * components;
      return [positions[at]!, positions[at + 1]!, positions[at + 2]!] as const;
    });
  }

  /** By triangle, the bins of its bounds: low x, y, z, then high x, y, z, four bits each from the lowest on. */
  private spans(count: number): Uint32Array {
    const { indices, positions, components } = this.mesh;
    const spans = new Uint32Array(count);
    const last = SIDE - 1;
    for (let axis = 0; axis < 3; axis++) {
      const low = this.low[axis]!;
      const width = this.width[axis]!;
      for (let triangle = 0; triangle < count; triangle++) {
        const a = positions[indices[3 * triangle]! * components + axis]!;
        const b = positions[indices[3 * triangle + 1]! * components + axis]!;
        const c = positions[indices[3 * triangle + 2]! * components + axis]!;
        const from = Math.floor((Math.min(a, b, c) - low) / width);
        const to = Math.floor((Math.max(a, b, c) - low) / width);
        spans[triangle]! |= Math.max(0, Math.min(last, from)) << (4 * axis);
        spans[triangle]! |= Math.max(0, Math.min(last, to)) << (4 * axis + 12);
      }
    }
    return spans;
  }

  private binAlong(axis: number, at: number): number {
    return Math.max(0, Math.min(SIDE - 1, Math.floor((at - this.low[axis]!) / this.width[axis]!)));
  }
}

/**
 * Goes through the bins of all triangles. triangles: takes each triangle where `at` says for its bin; if it is null, they
 * are counted in `at`, each one place behind its bin.
 */
function inBins(spans: Uint32Array, at: Uint32Array, triangles: Uint32Array | null): void {
  for (let triangle = 0; triangle < spans.length; triangle++) {
    const span = spans[triangle]!;
    const x1 = (span >> 12) & 15;
    const y1 = (span >> 16) & 15;
    const z1 = (span >> 20) & 15;
    for (let z = (span >> 8) & 15; z <= z1; z++) {
      for (let y = (span >> 4) & 15; y <= y1; y++) {
        for (let x = span & 15; x <= x1; x++) {
          const bin = x + SIDE * (y + SIDE * z);
          if (triangles === null) {
            at[bin + 1]! += 1;
          } else {
            triangles[at[bin]!++] = triangle;
          }
        }
      }
    }
  }
}

function normalOf(a: Triple, b: Triple, c: Triple): Triple {
  const [u, v] = [minus(b, a), minus(c, a)];
  const normal: Triple = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const length = Math.sqrt(dot(normal, normal)) || 1;
  return [normal[0] / length, normal[1] / length, normal[2] / length];
}

/** How far along a ray meets a triangle, from either side (Möller and Trumbore 1997). */
function meets(origin: Triple, direction: Triple, a: Triple, b: Triple, c: Triple): number | null {
  const [u, v] = [minus(b, a), minus(c, a)];
  const p: Triple = [
    direction[1] * v[2] - direction[2] * v[1],
    direction[2] * v[0] - direction[0] * v[2],
    direction[0] * v[1] - direction[1] * v[0],
  ];
  const size = dot(u, p);
  if (size === 0) {
    return null;
  }
  const t = minus(origin, a);
  const first = dot(t, p) / size;
  if (first < 0 || first > 1) {
    return null;
  }
  const q: Triple = [t[1] * u[2] - t[2] * u[1], t[2] * u[0] - t[0] * u[2], t[0] * u[1] - t[1] * u[0]];
  const second = dot(direction, q) / size;
  return second < 0 || first + second > 1 ? null : dot(v, q) / size;
}

/** The point of a triangle nearest to another (Ericson, Real-Time Collision Detection, 5.1.5). */
function nearestOf(a: Triple, b: Triple, c: Triple, point: Triple): Triple {
  const [ab, ac, ap] = [minus(b, a), minus(c, a), minus(point, a)];
  const [d1, d2] = [dot(ab, ap), dot(ac, ap)];
  if (d1 <= 0 && d2 <= 0) {
    return a;
  }
  const bp = minus(point, b);
  const [d3, d4] = [dot(ab, bp), dot(ac, bp)];
  if (d3 >= 0 && d4 <= d3) {
    return b;
  }
  const vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) {
    return plus(a, ab, d1 / (d1 - d3));
  }
  const cp = minus(point, c);
  const [d5, d6] = [dot(ab, cp), dot(ac, cp)];
  if (d6 >= 0 && d5 <= d6) {
    return c;
  }
  const vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) {
    return plus(a, ac, d2 / (d2 - d6));
  }
  const va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    return plus(b, minus(c, b), (d4 - d3) / (d4 - d3 + (d5 - d6)));
  }
  const whole = va + vb + vc;
  return plus(plus(a, ab, vb / whole), ac, vc / whole);
}
