/** Which world is on the screen, and which one takes its place as soon as there is something to see of it. */

import { CLOCK, type Clock } from "./clock.js";

/** The picture of the world before stays for so long at most. Milliseconds. */
export const KEPT_MS_MAX = 4_000;

/** A world that can be shown. */
export interface Shown<Self> {
  /** Whether there is enough of it to be looked at. */
  readonly isPresentable: boolean;
  /** Whether nothing is fetched or heard any more. */
  readonly isRetired: boolean;
  /** Once a frame while another one is on the screen. leader: who is where the viewer is; null if that is another place */
  prepare(leader: Self | null): void;
  /** Fetches nothing more and hears nothing more, but stays as it is. */
  retire(): void;
  dispose(): void;
}

export class Showing<World extends Shown<World>> {
  /** On the screen. */
  current: World | null = null;
  private coming: {
    readonly world: World;
    readonly since: number;
    readonly keepsPlace: boolean;
    arrived(before: World | null): void;
  } | null = null;

  constructor(private readonly clock: Pick<Clock, "now"> = CLOCK) {}

  /** The one that was begun last. */
  get newest(): World | null {
    return this.coming?.world ?? this.current;
  }

  /** The one on the screen, and the one that takes its place. */
  get all(): World[] {
    return [this.current, this.coming?.world ?? null].filter((world) => world !== null);
  }

  get isChanging(): boolean {
    return this.coming !== null;
  }

  /**
   * Has another world shown: at once if there is none.
   *
   * @param keepsPlace whether the viewer stays where they are
   * @param arrived called when it takes the place of the one before, which is disposed of then
   */
  begin(world: World, keepsPlace: boolean, arrived: (before: World | null) => void): void {
    this.coming?.world.dispose();
    this.coming = { world, since: this.clock.now(), keepsPlace, arrived };
    if (this.current === null) {
      this.swap();
    } else {
      this.current.retire();
    }
  }

  /** Once a frame, before anything is drawn: what is drawn then is one of both worlds. */
  update(): void {
    if (this.coming === null) {
      return;
    }
    const { world, since, keepsPlace } = this.coming;
    world.prepare(keepsPlace ? this.current : null);
    const isDue = !world.isRetired && this.clock.now() - since > KEPT_MS_MAX; // of one that is retired nothing comes
    if (world.isPresentable || isDue) {
      this.swap();
    }
  }

  private swap(): void {
    const { world, arrived } = this.coming!;
    this.coming = null;
    const before = this.current;
    this.current = world;
    arrived(before);
    before?.dispose();
  }
}
