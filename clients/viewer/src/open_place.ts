/** Where somebody is put who would begin in rock: nothing is seen from there but the insides of caves, inside out. */

import type { Triple } from "chunkserver-client";

import type { Ground } from "./ground.js";
import { dot, plus, scaled, unit } from "./vectors.js";

/** Voxels: how far the open is looked for, and how far into it one is put at most. */
const REACH = 512;
const STEP_IN = 8;
/** Voxels behind a surface that are behind it for sure. */
const THROUGH = 0.1;
const SIDES = [-1, 0, 1] as const;
const WAYS: readonly Triple[] = SIDES.flatMap((x) => SIDES.flatMap((y) => SIDES.map((z): Triple => [x, y, z])))
  .filter((way) => dot(way, way) > 0)
  .map((way) => unit(way));

/** A place in the open behind the nearest surface, in voxels; null if `from` is in the open, or none is near. */
export function openPlace(ground: Ground, from: Triple, up: Triple): Triple | null {
  if (!isInRock(ground, from, up)) {
    return null;
  }
  const hits = WAYS.map((way) => ({ way, hit: ground.ray(from, way, REACH) }))
    .filter(({ hit }) => hit !== null)
    .sort((one, other) => one.hit!.along - other.hit!.along);
  const { way, hit } = hits[0]!;
  const behind = plus(from, way, hit!.along + THROUGH);
  const room = ground.ray(behind, way, 2 * STEP_IN)?.along ?? 2 * STEP_IN;
  return plus(behind, scaled(way, room / 2));
}

/** The first surface on any way tells on which side of it one is; that below is met where the ground has no end. */
function isInRock(ground: Ground, from: Triple, up: Triple): boolean {
  for (const way of [scaled(up, -1), ...WAYS]) {
    const hit = ground.ray(from, way, REACH);
    if (hit !== null) {
      return dot(hit.normal, way) > 0;
    }
  }
  return false;
}
