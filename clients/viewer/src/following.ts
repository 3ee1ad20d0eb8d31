/** The edits of a world: one's own are sent, others' are heard of, and what they outdate is drawn anew. */

import {
  BadRequest,
  EditStream,
  StreamEnded,
  Unreachable,
  type AnyWorld,
  type Stroke,
  type WorkerClient,
  type WorldDescriptor,
} from "chunkserver-client";

import type { Terrain } from "./terrain.js";
import { digOut, dugOut } from "./world.js";

/** Between two looks whether somebody has dug in the seed that is shown, or whether there is a stream again. */
const LOOK_MS = 1500;
const OPEN_SECONDS = 10;
/** A stream that is silent for longer says that the server is away. */
const SILENT_MS = 1500;

export class Following {
  /** The newest revision that is known; 0 of a seed. */
  revision = 0n;
  private stream: EditStream | null = null;
  private opening: Promise<EditStream> | null = null;
  private digging: Promise<WorldDescriptor> | null = null;
  private timer: ReturnType<typeof setTimeout> | undefined;
  /** Until it is resumed. */
  private isStopped = false;
  private isClosed = false;
  private liveAt = performance.now();

  /** failed: told when others cannot be heard; `resume` tries again. */
  constructor(
    private readonly client: WorkerClient,
    public world: AnyWorld,
    private readonly terrain: Terrain,
    private readonly failed: (error: unknown) => void,
  ) {
    this.revision = world.kind === "world" ? world.revision : 0n;
    void this.look();
  }

  /** Changes the world; of a seed's, a world is made first. Resolves when that is durable. */
  async edit(strokes: readonly Stroke[]): Promise<void> {
    const world = await this.own();
    const stream = await this.streamOf(world).catch(() => null);
    const { stale, revision } = await (stream?.edit(strokes) ?? this.client.edit(world, strokes));
    this.terrain.outdate(stale);
    if (stream !== null) {
      this.known(revision); // without a stream there may be edits before it that nobody has told of
    }
  }

  /** Once a frame: takes what others have done. */
  update(): void {
    const { stream } = this;
    if (stream === null || this.isStopped) {
      return;
    }
    try {
      for (const event of stream.poll()) {
        if (event.kind === "edits" || event.kind === "stale") {
          this.terrain.outdate(event.stale);
        } else if (event.kind === "resync" || event.kind === "skipped") {
          this.terrain.outdate(null);
        } else if (event.kind === "start over") {
          throw new StreamEnded(4404);
        }
      }
      this.known(stream.revision);
    } catch (error) {
      this.fail(error);
      return;
    }
    const now = performance.now();
    this.liveAt = stream.isLive ? now : this.liveAt;
    if (now - this.liveAt > SILENT_MS) {
      this.fail(new Unreachable("the stream of edits is silent"));
    }
  }

  stop(): void {
    this.isStopped = this.isClosed = true;
    clearTimeout(this.timer);
    this.stream?.close();
  }

  /** Goes on after a failure. */
  resume(): void {
    this.isStopped = false;
    this.liveAt = performance.now();
    void this.look();
  }

  private known(revision: bigint): void {
    this.revision = revision > this.revision ? revision : this.revision;
  }

  private fail(error: unknown): void {
    if (!this.isStopped) {
      this.isStopped = true;
      clearTimeout(this.timer);
      this.failed(error);
    }
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
      this.terrain.setWorld(world);
    }
  }

  private async look(): Promise<void> {
    clearTimeout(this.timer);
    try {
      if (this.world.kind === "seed" && !document.hidden) {
        const made = await dugOut(this.client, this.world);
        if (made !== null) {
          this.adopt(made);
        }
      }
      if (this.world.kind === "world" && this.stream === null) {
        await this.streamOf(this.world);
      }
    } catch (error) {
      this.fail(error);
    }
    if (!this.isStopped && this.stream === null) {
      this.timer = setTimeout(() => void this.look(), LOOK_MS);
    }
  }

  private async streamOf(world: WorldDescriptor): Promise<EditStream> {
    this.opening ??= this.open(world).catch((error: unknown) => {
      this.opening = null;
      throw error;
    });
    return this.opening;
  }

  /** The stream tells what comes; the log has what was before, if the chunks that are drawn are from even earlier. */
  private async open(world: WorldDescriptor): Promise<EditStream> {
    const retry = { secondsMax: OPEN_SECONDS, backoffSecondsMax: 1 };
    const stream = await EditStream.open(this.client, world, randomName(), { retry });
    try {
      await this.catchUp(world);
    } catch (error) {
      stream.close();
      throw error;
    }
    if (this.isClosed) {
      stream.close();
    }
    this.liveAt = performance.now();
    this.stream = stream;
    return stream;
  }

  private async catchUp(world: WorldDescriptor): Promise<void> {
    try {
      for await (const edit of this.client.edits(world, this.revision)) {
        this.terrain.outdate(edit.stale);
        this.known(edit.revision);
      }
    } catch (error) {
      if (!(error instanceof BadRequest)) {
        throw error;
      }
      this.terrain.outdate(null); // the log no longer goes back that far
    }
  }
}

/** Of this page, among those who edit. */
function randomName(): string {
  return `viewer-${Array.from(crypto.getRandomValues(new Uint32Array(4)), (part) => part.toString(36)).join("-")}`;
}
