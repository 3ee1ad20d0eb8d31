/** Vectors of three numbers, in float64: places in voxels are too large for the vectors of a renderer. */

import type { Triple } from "chunkserver-client";

export function plus(a: Triple, b: Triple, times = 1): Triple {
  return [a[0] + b[0] * times, a[1] + b[1] * times, a[2] + b[2] * times];
}

export function minus(a: Triple, b: Triple): Triple {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

export function scaled(a: Triple, times: number): Triple {
  return [a[0] * times, a[1] * times, a[2] * times];
}

export function dot(a: Triple, b: Triple): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function cross(a: Triple, b: Triple): Triple {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

export function lengthOf(a: Triple): number {
  return Math.hypot(a[0], a[1], a[2]);
}

/** The unit vector; `otherwise` for one without a direction. */
export function unit(a: Triple, otherwise: Triple = [0, 0, -1]): Triple {
  const length = lengthOf(a);
  return length > 1e-12 ? scaled(a, 1 / length) : otherwise;
}

/** Turned by an angle around a unit vector, in radians (Rodrigues). */
export function turned(a: Triple, axis: Triple, angle: number): Triple {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return plus(plus(scaled(a, cos), cross(axis, a), sin), axis, dot(axis, a) * (1 - cos));
}

/** What is left of a vector across a unit vector, as a unit vector. */
export function across(a: Triple, axis: Triple): Triple {
  const other: Triple = Math.abs(axis[2]) < 0.9 ? [0, 0, -1] : [1, 0, 0];
  return unit(plus(a, axis, -dot(a, axis)), unit(plus(other, axis, -dot(other, axis))));
}
