/** The edits of a world: one's own are sent, others' are heard of, and what they outdate is drawn anew. */

import {
  BadRequest,
  EditStream,
  StreamEnded,
  Unreachable,
  type AnyWorld,
  type ChunkClient,
  type LoggedEdit,
  type Stroke,
  type WorldDescriptor,
  type WrittenEdit,
} from "chunkserver-client";

import { CLOCK, pauseOf, type Clock, type Pauses } from "./clock.js";
import { verdictOn } from "./failures.js";
import { untilKnown } from "./sending.js";
import type { Terrain } from "./terrain.js";
import { digOut, dugOut } from "./world.js";
import type { Troubles } from "./worlds.js";

/** Between two looks whether somebody has dug: in the seed that is shown, or in a world of which no stream tells. */
const LOOK_MS = 1500;
const OPEN_SECONDS = 5;
/** Between two attempts of a stream to connect. */
const CONNECT_SECONDS_MAX = 4;
/** A stream that is silent for longer is opened anew. */
const SILENT_MS = 1500;
/** Between two attempts to open a stream, the first of which comes at once. */
const STREAMS: Pauses = { first: 1_000, most: 60_000 };
/** So long it may take until others are heard, where they dig so fast that nothing would ever be drawn. */
const HELD_MS_MAX = 2_000;
/** Edits that are read one by one; who has missed more draws everything anew. */
const MISSED_MAX = 1000n;
/** A stream that has lasted so long is a good one. */
const LASTING_MS = 60_000;

export interface Surroundings {
  readonly clock: Clock;
  /** Whether nobody looks. */
  isHidden(): boolean;
  open: typeof EditStream.open;
}

const HERE: Surroundings = { clock: CLOCK, isHidden: () => document.hidden, open: EditStream.open };

export class Following {
  /** Everything up to it is drawn, or is to be. */
  private heard: bigint;
  private newest = 0n;
  /** Revisions of own edits, of which nobody has told yet. */
  private readonly own = new Set<bigint>();
  private stream: EditStream | null = null;
  private isOpening = false;
  private openedAt = Infinity;
  private openAt = -Infinity;
  private liveAt = 0;
  private polledAt = -Infinity;
  /** Streams in a row that did not last. */
  private failures = 0;
  /** The last of them. */
  private why: unknown = null;
  private isLate = false;
  private digging: Promise<WorldDescriptor> | null = null;
  private delayed = 0;
  private cancelLook = () => {};
  private looks = 0;
  /** Until it is resumed. */
  private isStopped = false;
  private readonly left = new AbortController();

  constructor(
    private readonly client: ChunkClient,
    public world: AnyWorld,
    private readonly terrain: Pick<Terrain, "outdate" | "setWorld" | "isStarved">,
    private readonly reports: Omit<Troubles, "chunksFailed">,
    private readonly around: Surroundings = HERE,
  ) {
    this.heard = world.kind === "world" ? world.revision : 0n;
    void this.look();
  }

  /** The newest revision that is known; 0 of a seed. */
  get revision(): bigint {
    return this.newest > this.heard ? this.newest : this.heard;
  }

  /** Whether others are heard as soon as they dig. */
  get isLive(): boolean {
    return this.stream?.isLive === true;
  }

  /**
   * Changes the world; of a seed's, a world is made first. Resolves when that is durable: it is sent until that is known.
   *
   * @throws {EditFailed}
   */
  async edit(strokes: readonly Stroke[]): Promise<void> {
    const key = randomName();
    const { clock } = this.around;
    let isDelayed = false;
    const delayed = (error: unknown) => {
      this.delayed += isDelayed ? 0 : 1;
      isDelayed = true;
      this.reports.delayed(error);
    };
    try {
      const send = async () => this.client.edit(await this.ownWorld(), strokes, key);
      this.wrote(await untilKnown(send, { clock, left: this.left.signal, delayed }));
    } finally {
      this.delayed -= isDelayed ? 1 : 0;
      if (isDelayed && this.delayed === 0) {
        this.reports.delayed(null);
      }
    }
  }

  /** Once a frame: takes what others have done. */
  update(): void {
    const { stream } = this;
    if (stream === null || this.isStopped) {
      return;
    }
    const now = this.around.clock.now();
    try {
      if (!this.terrain.isStarved || now - this.polledAt > HELD_MS_MAX) {
        this.polledAt = now;
        this.poll(stream);
      }
      this.liveAt = stream.isLive ? now : this.liveAt;
      if (now - this.liveAt > SILENT_MS) {
        throw new Unreachable("the stream of edits is silent");
      }
    } catch (error) {
      this.lost(error);
    }
  }

  /** Ends it. Edits that are on their way fail. */
  stop(): void {
    this.isStopped = true;
    this.cancelLook();
    this.left.abort();
    this.stream?.close();
    this.stream = null;
  }

  /** Goes on after a failure. */
  resume(): void {
    if (!this.left.signal.aborted) {
      this.isStopped = false;
      this.openAt = this.liveAt = this.around.clock.now();
      void this.look();
    }
  }

  private poll(stream: EditStream): void {
    for (const event of stream.poll()) {
      if (event.kind === "edits") {
        if (event.edits.filter(({ revision }) => !this.own.delete(revision)).length) {
          this.terrain.outdate(event.stale, event.revision);
        }
      } else if (event.kind === "stale") {
        this.terrain.outdate(event.stale, event.revision);
      } else if (event.kind === "resync" || event.kind === "skipped") {
        this.terrain.outdate(null, event.revision);
      } else if (event.kind === "start over") {
        throw new StreamEnded(4404);
      }
    }
    this.hear(stream.revision);
  }

  private hear(revision: bigint): void {
    this.heard = revision > this.heard ? revision : this.heard;
    for (const each of this.own) {
      if (each <= this.heard) {
        this.own.delete(each);
      }
    }
  }

  private wrote({ revision, stale }: WrittenEdit): void {
    if (revision > this.heard) {
      this.own.add(revision);
      this.newest = revision > this.newest ? revision : this.newest;
      this.terrain.outdate(stale, revision);
    }
  }

  private fail(error: unknown): void {
    if (!this.isStopped) {
      this.isStopped = true;
      this.cancelLook();
      this.reports.failed(error);
    }
  }

  private async ownWorld(): Promise<WorldDescriptor> {
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
      void this.look();
    }
  }

  /** Asks what there is to hear, as long as no stream tells; again and again. */
  private async look(): Promise<void> {
    this.cancelLook();
    const number = ++this.looks;
    try {
      if (!this.around.isHidden()) {
        await this.ask();
      }
    } catch (error) {
      this.fail(error);
    }
    if (!this.isStopped && number === this.looks) {
      this.cancelLook = this.around.clock.after(LOOK_MS, () => void this.look());
    }
  }

  private async ask(): Promise<void> {
    const { world, client } = this;
    if (world.kind === "seed") {
      const made = await dugOut(client, world);
      if (made !== null) {
        this.adopt(made);
      }
    } else if (this.stream === null) {
      const isFirst = this.failures === 0 && !this.isOpening;
      if (!this.isOpening && this.around.clock.now() >= this.openAt) {
        void this.open(world);
      }
      if (isFirst) {
        return;
      }
      const { epoch, revision } = await client.world(world.id);
      if (epoch !== world.epoch) {
        throw new StreamEnded(4404);
      }
      if (revision > this.heard) {
        await this.catchUp(world, revision);
      }
      if (this.failures > 1 && !this.isLate && this.stream === null) {
        this.isLate = true;
        this.reports.late(this.why);
      }
    }
  }

  /** The stream tells what comes; the log has what was before, if the chunks that are drawn are from even earlier. */
  private async open(world: WorldDescriptor): Promise<void> {
    const { clock, open } = this.around;
    let stream: EditStream | null = null;
    this.isOpening = true;
    try {
      const retry = { secondsMax: OPEN_SECONDS, backoffSecondsMax: CONNECT_SECONDS_MAX };
      stream = await open(this.client, world, randomName(), { retry });
      await this.catchUp(world, stream.revision);
      if (this.left.signal.aborted) {
        stream.close();
        return;
      }
      this.stream = stream;
      this.openedAt = this.liveAt = clock.now();
      if (this.isLate) {
        this.isLate = false;
        this.reports.late(null);
      }
    } catch (error) {
      stream?.close();
      this.lost(error);
    } finally {
      this.isOpening = false;
    }
  }

  /** There is no stream: another one is opened sooner or later, and until then the log is read. */
  private lost(error: unknown): void {
    this.stream?.close();
    this.stream = null;
    if (this.isStopped) {
      return; // whoever resumes it opens another one
    }
    const { remedy } = verdictOn(error);
    if (remedy !== "wait" && remedy !== "retry") {
      this.fail(error);
      return;
    }
    const now = this.around.clock.now();
    this.failures = now - this.openedAt > LASTING_MS ? 1 : this.failures + 1;
    this.openedAt = Infinity;
    this.openAt = this.failures === 1 ? now : now + pauseOf(STREAMS, this.failures - 2);
    this.why = error;
    void this.look();
  }

  /** Hears of everything up to a revision of the world, at least. */
  private async catchUp(world: WorldDescriptor, revision: bigint): Promise<void> {
    if (revision - this.heard > MISSED_MAX) {
      this.missed(revision);
      return;
    }
    try {
      for await (const edit of this.client.edits(world, this.heard)) {
        this.take(edit);
      }
    } catch (error) {
      if (!(error instanceof BadRequest)) {
        throw error;
      }
      this.missed(revision); // the log no longer goes back that far
    }
  }

  /** Nobody says what was changed up to a revision: anything may have been. */
  private missed(revision: bigint): void {
    if (revision > this.heard) {
      this.terrain.outdate(null, revision);
      this.hear(revision);
    }
  }

  private take({ revision, stale }: LoggedEdit): void {
    if (revision > this.heard && !this.own.delete(revision)) {
      this.terrain.outdate(stale, revision);
    }
    this.hear(revision);
  }
}

/** Of this page among those who listen; of an edit among all. */
function randomName(): string {
  return `viewer-${Array.from(crypto.getRandomValues(new Uint32Array(4)), (part) => part.toString(36)).join("-")}`;
}
