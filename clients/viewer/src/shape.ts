/** What a recipe's expression says of the form of its world: where up is, and how large it is. */

import type { Triple } from "chunkserver-client";

/** A ball around `centre`, or a world without end in which +y is up. Voxels. */
export interface Shape {
  readonly centre: Triple | null;
  readonly radius: number | null;
}

export const FLAT: Shape = { centre: null, radius: null };

/** A ball stays one under these, whatever is cut out of it or added to it; it is their first operand. */
const KEEPS_BALL = new Set(["add", "subtract", "max", "min", "smooth_max", "smooth_min", "detail", "warp"]);
const DEPTH_MAX = 256;

export function shapeOf(expression: Readonly<Record<string, unknown>>): Shape {
  let node: unknown = expression;
  for (let depth = 0; depth < DEPTH_MAX && typeof node === "object" && node !== null; depth++) {
    const { op, a, center, radius } = node as Record<string, unknown>;
    if (op === "sphere" && typeof radius === "number" && Array.isArray(center)) {
      const [x, y, z] = center as number[];
      return { centre: [x ?? 0, y ?? 0, z ?? 0], radius };
    }
    if (!KEEPS_BALL.has(String(op))) {
      break;
    }
    node = a;
  }
  return FLAT;
}

/** The direction away from the ground at a point, a unit vector. */
export function upAt(shape: Shape, point: Triple): Triple {
  if (shape.centre === null) {
    return [0, 1, 0];
  }
  const [x, y, z] = [0, 1, 2].map((axis) => point[axis]! - shape.centre![axis]!) as [number, number, number];
  const length = Math.hypot(x, y, z);
  return length > 0 ? [x / length, y / length, z / length] : [0, 1, 0];
}
