/** Flies and walks: a body of two balls that the ground pushes out, with weight if it walks. Metres and seconds. */

import type { Triple } from "chunkserver-client";

import type { Ground } from "./ground.js";
import type { Pose } from "./pose.js";
import { dot, lengthOf, plus, scaled, unit } from "./vectors.js";

const EYE = 1.65;
const RADIUS = 0.38;
/** Of the balls' middles, below the eye. */
const BALLS: readonly number[] = [EYE - RADIUS, 0.55];
const WALK_SPEED = 5.5;
const RUN_TIMES = 2.2;
const FLY_SPEED_MIN = 6;
const FLY_SPEED_MAX = 2e7;
const FAST_TIMES = 4;
/** Flying takes about that long to the ground. */
const FLY_SECONDS = 1.6;
const GRAVITY = 18;
const JUMP_SPEED = 7;
const FALL_SPEED_MAX = 60;
/** How soon a speed is taken on, per second. */
const GRIP = 10;
const GRIP_IN_AIR = 2.5;
const RISE_SPEED = 6;
const STEPS_MAX = 24;
const PUSHES_MAX = 4;
/** A slope that is stood on. */
const FLOOR = 0.55;
/** Seconds: a longer frame is several. */
const FRAME_MAX = 0.1;
/** How far below the ground is looked for. */
const SOUNDING = 3e7;

/** Where somebody wants to go: each from -1 to 1. */
export interface Wish {
  readonly onwards: number;
  readonly right: number;
  readonly up: number;
  readonly isFast: boolean;
}

export class Motion {
  isWalking = false;
  /** Metres above the ground, as far as it is known. */
  altitude = 100;
  private velocity: Triple = [0, 0, 0];
  /** Whether they have ground under their feet. */
  isStanding = false;

  constructor(
    private readonly pose: Pose,
    private readonly ground: Ground,
    private readonly voxelSize: number,
    /** How far from the origin of the shape one may get, in voxels. */
    private readonly reach: number,
  ) {}

  /** Voxels a second. */
  get voxelsPerSecond(): Triple {
    return scaled(this.velocity, 1 / this.voxelSize);
  }

  stop(): void {
    this.velocity = [0, 0, 0];
  }

  /** isThere: whether the ground around the viewer is drawn; else nobody falls. */
  move(wish: Wish, elapsed: number, isThere: boolean): void {
    const seconds = Math.min(elapsed, FRAME_MAX);
    const { pose } = this;
    const down = this.ground.ray(pose.position, scaled(pose.up, -1 / this.voxelSize), SOUNDING);
    const isInside = down !== null && dot(down.normal, pose.up) < -0.05 && down.along < 64;
    if (down !== null) {
      this.altitude = down.along;
    } else if (pose.shape.centre !== null) {
      const { centre, radius } = pose.shape;
      const height = lengthOf(pose.position.map((at, axis) => at - centre[axis]!) as unknown as Triple) - radius!;
      this.altitude = Math.max(height * this.voxelSize, 1);
    }
    if (this.isWalking) {
      this.walk(wish, seconds, isThere, isInside);
    } else {
      this.fly(wish, seconds);
    }
    this.travel(scaled(this.velocity, seconds));
  }

  private fly(wish: Wish, seconds: number): void {
    const { ahead, right, up } = this.pose;
    const direction = plus(plus(scaled(ahead, wish.onwards), right, wish.right), up, wish.up);
    const nominal = Math.max(FLY_SPEED_MIN, Math.min(this.altitude / FLY_SECONDS, FLY_SPEED_MAX));
    const speed = nominal * (wish.isFast ? FAST_TIMES : 1) * Math.min(lengthOf(direction), 1);
    this.approach(scaled(unit(direction), speed), GRIP * seconds);
    this.isStanding = false;
  }

  private walk(wish: Wish, seconds: number, isThere: boolean, isInside: boolean): void {
    const { onwards, right, up } = this.pose;
    const direction = plus(scaled(onwards, wish.onwards), right, wish.right);
    const speed = WALK_SPEED * (wish.isFast ? RUN_TIMES : 1) * Math.min(lengthOf(direction), 1);
    const rising = dot(this.velocity, up);
    const level = plus(this.velocity, up, -rising);
    const part = Math.min((this.isStanding ? GRIP : GRIP_IN_AIR) * seconds, 1);
    const target = scaled(unit(direction), speed);
    const moved = plus(scaled(level, 1 - part), target, part);
    let rise = Math.max(rising - GRAVITY * seconds, -FALL_SPEED_MAX);
    if (this.isStanding && wish.up > 0) {
      rise = JUMP_SPEED;
    }
    if (isInside) {
      rise = RISE_SPEED;
    } else if (!isThere) {
      rise = 0;
    }
    this.velocity = plus(moved, up, rise);
    this.isStanding = false;
  }

  private approach(target: Triple, part: number): void {
    const taken = Math.min(part, 1);
    this.velocity = plus(scaled(this.velocity, 1 - taken), target, taken);
  }

  /** Goes by so many metres, in steps that pass through no wall, and is pushed out of the ground. */
  private travel(way: Triple): void {
    const length = lengthOf(way);
    if (length === 0) {
      return;
    }
    const isNear = this.altitude < 64 || this.ground.clearance(this.pose.position) * this.voxelSize < length + 8;
    const steps = isNear ? Math.min(Math.ceil(length / (RADIUS * 0.8)), STEPS_MAX) : 1;
    for (let step = 0; step < steps; step++) {
      const from = this.pose.position;
      this.place(plus(from, way, 1 / steps / this.voxelSize));
      if (isNear) {
        this.pushOut();
      }
    }
  }

  private pushOut(): void {
    const { up } = this.pose;
    for (let push = 0; push < PUSHES_MAX; push++) {
      let isFree = true;
      for (const below of this.isWalking ? BALLS : [0]) {
        const middle = plus(this.pose.position, up, -below / this.voxelSize);
        const out = this.ground.push(middle, RADIUS / this.voxelSize);
        if (out !== null) {
          isFree = false;
          const away = unit(out, up);
          const into = Math.min(dot(this.velocity, away), 0);
          this.velocity = plus(this.velocity, away, -into);
          this.isStanding ||= dot(away, up) > FLOOR;
          this.place(plus(this.pose.position, out));
        }
      }
      if (isFree) {
        return;
      }
    }
  }

  private place(at: Triple): void {
    const { centre } = this.pose.shape;
    const middle = centre ?? ([0, 0, 0] as const);
    const away = at.map((place, axis) => place - middle[axis]!) as unknown as Triple;
    const distance = centre === null ? Math.max(...away.map(Math.abs)) : lengthOf(away);
    this.pose.position = distance > this.reach ? plus(middle, away, this.reach / distance) : at;
  }
}
