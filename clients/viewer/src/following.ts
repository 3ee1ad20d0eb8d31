/** The edits of a world: one's own are sent, others' are heard of, and what they outdate is drawn anew. */

import { BadRequest, type AnyWorld, type ChunkClient, type Stroke, type WorldDescriptor } from "chunkserver-client";

import type { Terrain } from "./terrain.js";
import { digOut, dugOut } from "./world.js";

/** Between two looks at what others have done. */
const POLL_MS = 1500;

export class Following {
  /** The newest revision that is known, of a world that has any. */
  revision = 0n;
  private timer: ReturnType<typeof setTimeout> | null = null;
  private isStopped = false;
  private digging: Promise<WorldDescriptor> | null = null;

  constructor(
    private readonly client: ChunkClient,
    public world: AnyWorld,
    private readonly terrain: Terrain,
    private readonly failed: (error: unknown) => void,
  ) {
    this.revision = world.kind === "world" ? world.revision : 0n;
    this.later();
  }

  /** Changes the world; of a seed's, a world is made first. */
  async edit(strokes: readonly Stroke[]): Promise<void> {
    const world = await this.own();
    const { stale, revision } = await this.client.edit(world, strokes);
    this.terrain.outdate(stale, revision);
    if (revision === this.revision + 1n) {
      this.revision = revision;
    }
  }

  stop(): void {
    this.isStopped = true;
    if (this.timer !== null) {
      clearTimeout(this.timer);
    }
  }

  /** Goes on after a failure. */
  resume(): void {
    this.isStopped = false;
    this.later();
  }

  private async own(): Promise<WorldDescriptor> {
    if (this.world.kind === "world") {
      return this.world;
    }
    this.digging ??= digOut(this.client, this.world).finally(() => (this.digging = null));
    const world = await this.digging;
    this.adopt(world);
    return world;
  }

  /** A world has been made of the seed that is shown: all it lacks are its edits. */
  private adopt(world: WorldDescriptor): void {
    if (this.world.kind === "seed") {
      this.world = world;
      this.revision = 0n;
      this.terrain.setWorld(world);
    }
  }

  private later(): void {
    if (this.timer !== null) {
      clearTimeout(this.timer);
    }
    this.timer = setTimeout(() => void this.look(), POLL_MS);
  }

  private async look(): Promise<void> {
    try {
      if (!document.hidden) {
        await this.hear();
      }
    } catch (error) {
      if (!this.isStopped) {
        this.failed(error);
      }
      return;
    }
    if (!this.isStopped) {
      this.later();
    }
  }

  private async hear(): Promise<void> {
    if (this.world.kind === "seed") {
      const made = await dugOut(this.client, this.world);
      if (made === null) {
        return;
      }
      this.adopt(made);
    }
    const world = this.world as WorldDescriptor;
    try {
      for await (const edit of this.client.edits(world, this.revision)) {
        this.terrain.outdate(edit.stale, edit.revision);
        this.revision = edit.revision;
      }
    } catch (error) {
      if (!(error instanceof BadRequest)) {
        throw error;
      }
      const { revision } = await this.client.world(world.id); // the log no longer goes back that far
      this.terrain.outdate(null, 0n);
      this.revision = revision;
    }
  }
}
