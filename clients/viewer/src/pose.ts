/** Where the viewer is and where they look: a place in voxels, a heading along the ground and an angle above it. */

import type { Triple } from "chunkserver-client";

import { upAt, type Shape } from "./shape.js";
import { across, cross, dot, plus, scaled, turned, unit } from "./vectors.js";

const PITCH_MAX = (89 / 180) * Math.PI;

export class Pose {
  /** A unit vector along the ground. */
  private heading: Triple = [0, 0, -1];
  private pitch = 0;

  constructor(
    readonly shape: Shape,
    private at: Triple,
    ahead: Triple,
  ) {
    this.lookAlong(ahead);
  }

  get position(): Triple {
    return this.at;
  }

  /** Moves; the angle to the ground stays, wherever the ground is. */
  set position(at: Triple) {
    this.at = at;
    this.heading = across(this.heading, this.up);
  }

  get up(): Triple {
    return upAt(this.shape, this.at);
  }

  /** Along the ground, straight on. */
  get onwards(): Triple {
    return this.heading;
  }

  get right(): Triple {
    return cross(this.heading, this.up);
  }

  /** The direction of view. */
  get ahead(): Triple {
    return unit(plus(scaled(this.heading, Math.cos(this.pitch)), this.up, Math.sin(this.pitch)));
  }

  lookAlong(ahead: Triple): void {
    const direction = unit(ahead);
    const rise = dot(direction, this.up);
    this.pitch = Math.max(-PITCH_MAX, Math.min(PITCH_MAX, Math.asin(Math.max(-1, Math.min(1, rise)))));
    this.heading = across(Math.abs(rise) > 0.9999 ? this.heading : direction, this.up);
  }

  /** Turns to the right and upwards, in radians. */
  turn(right: number, upwards: number): void {
    this.heading = across(turned(this.heading, this.up, -right), this.up);
    this.pitch = Math.max(-PITCH_MAX, Math.min(PITCH_MAX, this.pitch + upwards));
  }
}
