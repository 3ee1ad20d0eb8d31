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

/** Largest first: periods of 1024, 205, 41, 10.1 and 2.05 m, none of them parallel to another. */
export const TURNS: readonly Turn[] = [
  [0, 1],
  [3, 4],
  [24, 7],
  [20, 99],
  [400, 300],
];

/** The length after which a turned texture repeats, in metres. */
export function periodOf([a, b]: Turn): number {
  return PERIOD / Math.hypot(a, b);
}

/**
 * What is left of a point modulo a period, in metres, from 0 to the period. Taken in float64, so that it is right for anchors
 * of 2^40 voxels.
 *
 * @param anchor voxels
 * @param voxelSize metres
 * @param period metres
 */
export function remainder(
  anchor: readonly [number, number, number],
  voxelSize: number,
  period = PERIOD,
): [number, number, number] {
  const [x, y, z] = anchor.map((voxels) => {
    const left = (voxels * voxelSize) % period;
    return left < 0 ? left + period : left;
  });
  return [x!, y!, z!];
}
