/** Where the sun is: always up where the viewer is, so that nobody digs in the dark. */

import { Vector3 } from "three";

/** The sun of a flat world, and of a planet as long as that is by day. */
const SUN = new Vector3(0.62, 0.52, 0.46).normalize();
/** Between the sun and straight up, near the ground and far from it. */
const [ANGLE_LEAST, ANGLE_MOST] = [0.45, 1.12];
const [ANGLE_LEAST_FAR, ANGLE_MOST_FAR] = [1.05, 1.25];

/**
 * Moves the sun as little as keeps it up, and at an angle that shows what is on the ground.
 *
 * @param sun its direction, changed in place; zero at first
 * @param height over the ground, in radii of a planet; 0 in a flat world
 */
export function sunFor(sun: Vector3, up: Vector3, height: number): Vector3 {
  if (sun.lengthSq() === 0) {
    sun.copy(SUN);
  }
  const far = Math.min(1, Math.max(0, height));
  const least = ANGLE_LEAST + (ANGLE_LEAST_FAR - ANGLE_LEAST) * far;
  const most = ANGLE_MOST + (ANGLE_MOST_FAR - ANGLE_MOST) * far;
  const angle = sun.angleTo(up);
  const wanted = Math.min(most, Math.max(least, angle));
  if (wanted === angle) {
    return sun;
  }
  const axis = new Vector3().crossVectors(up, sun);
  if (axis.lengthSq() < 1e-8) {
    axis.set(up.z, up.x, up.y).cross(up);
  }
  return sun.copy(up).applyAxisAngle(axis.normalize(), wanted).normalize();
}
