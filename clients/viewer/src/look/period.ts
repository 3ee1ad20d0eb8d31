/**
 * Where textures lie in the world. The scene's origin moves, its ground must not: every texture repeats after PERIOD
 * metres along each axis, so all that a shader needs of the origin is what is left of it modulo PERIOD.
 *
 * A texture is turned and scaled by an integer matrix ((a, b), (-b, a)) over PERIOD: then moving by PERIOD moves its
 * coordinates by integers, which a repeating texture does not notice. Its own period is PERIOD / sqrt(a^2 + b^2).
 */

/** Metres. */
export const PERIOD = 1024;

/** What turns and scales a texture: a, b. */
export type Turn = readonly [number, number];

/** Largest first, none of them parallel to another or to an axis: periods of 205, 41, 10.1 and 2.05 m. */
export const TURNS: readonly Turn[] = [
  [3, 4],
  [24, 7],
  [20, 99],
  [300, 400],
];

/** The length after which a turned texture repeats, in metres. */
export function periodOf([a, b]: Turn): number {
  return PERIOD / Math.hypot(a, b);
}

/**
 * What is left of a point modulo PERIOD, in metres, from 0 to PERIOD. Taken in float64, so that it is right for anchors
 * of 2^40 voxels.
 *
 * @param anchor voxels
 * @param voxelSize metres
 */
export function remainder(anchor: readonly [number, number, number], voxelSize: number): [number, number, number] {
  const [x, y, z] = anchor.map((voxels) => {
    const left = (voxels * voxelSize) % PERIOD;
    return left < 0 ? left + PERIOD : left;
  });
  return [x!, y!, z!];
}
