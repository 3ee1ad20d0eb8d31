/** From where a world is seen first, in voxels: what shows each built-in recipe well, and any other from above. */

import type { Triple } from "chunkserver-client";

import type { Shape } from "./shape.js";
import { minus, plus } from "./vectors.js";

export interface Start {
  readonly position: Triple;
  readonly ahead: Triple;
}

/** Eye and target. */
const BY_RECIPE: Readonly<Record<string, readonly [Triple, Triple]>> = {
  terrain: [
    [240, 26, -100],
    [200, 14, -130],
  ],
  hills: [
    [0, 50, 0],
    [100, 37, 60],
  ],
  islands: [
    [0, 60, -260],
    [160, 12, 100],
  ],
  canyon: [
    [140, 40, 120],
    [235, -40, -110],
  ],
  "floating-islands": [
    [-20, 70, -330],
    [80, 10, 0],
  ],
  arches: [
    [0, 50, -150],
    [100, 20, 100],
  ],
  city: [
    [44, 150, -330],
    [110, 60, 0],
  ],
  spires: [
    [0, 90, -150],
    [100, 60, 100],
  ],
  // in the largest cave nearby; of another seed, the viewer is put into one
  caves: [
    [-16, -28, -4],
    [-40, -32, -40],
  ],
  ring: [
    [0, 420, 900],
    [0, -20, -100],
  ],
  plane: [
    [0, 12, 0],
    [0, 8, -40],
  ],
};
const ABOVE: readonly [Triple, Triple] = [
  [0, 90, 0],
  [100, 40, -100],
];
/** Of a ball, in radii from its centre. */
const ORBIT: Triple = [0.9, 1.3, 2.6];
/** The same for balls that have a better side: land and sea, day and night. */
const ORBITS: Readonly<Record<string, Triple>> = { continents: [-1.615, 0.636, 1.272] };

export function startOf(recipe: string, { centre, radius }: Shape): Start {
  if (centre !== null && radius !== null) {
    const position = plus(centre, ORBITS[recipe] ?? ORBIT, radius);
    return { position, ahead: minus(centre, position) };
  }
  const [eye, target] = BY_RECIPE[recipe] ?? ABOVE;
  return { position: eye, ahead: minus(target, eye) };
}
