/** The stream of a world's edits: a `Session`, and its sockets one after the other. */

import type { CallOptions } from "./client.js";
import { pathOf, type WorldDescriptor } from "./descriptors.js";
import type { ChunkRange, Stroke } from "./edits.js";
import { EditLost, Problem, StreamEnded, Unavailable, Unreachable, problem } from "./errors.js";
import { VOXELS_MAX, type ChunkKey } from "./mesh.js";
import { pause, retryOf, type Retry } from "./retry.js";
import type { Refresh } from "./stream/chunks.js";
import { Inbox, type StreamEvent } from "./stream/inbox.js";
import { bytesOf, type Ack, type WireFrame } from "./stream/messages.js";
import type { Region } from "./stream/regions.js";
import { Session, type SessionEvent } from "./stream/session.js";
import { LEFT, OPEN_SECONDS, carry, type Carried } from "./stream/socket.js";

const EVERYWHERE: Region = { low: [-VOXELS_MAX, -VOXELS_MAX, -VOXELS_MAX], high: [VOXELS_MAX, VOXELS_MAX, VOXELS_MAX] };
/** To find out why a socket could not be opened. */
const WHY_SECONDS = 1;
/** And the HTTP status: the code of a connection that the server did not take. */
const REFUSED = 4000;
const NAME = /^[!-~]{1,128}$/;

/** What a stream needs of a client: `Client` and `WorkerClient` both have it. */
export interface StreamClient {
  readonly url: string;
  ticket(world: WorldDescriptor, options: CallOptions): Promise<string | null>;
  world(id: string, options: CallOptions): Promise<WorldDescriptor>;
  outdate(world: WorldDescriptor, stale: readonly ChunkRange[] | null, revision: bigint): void;
}

export interface StreamOptions {
  /** Where to look, up to 64; everywhere if none are given. Own edits may be anywhere. */
  readonly regions?: readonly Region[];
  /** How long to wait between connections, and for the first welcome: `secondsMax`. */
  readonly retry?: Partial<Retry>;
}

/** Whoever waits for the answer to an edit. */
interface Waiting {
  resolve(ack: Ack): void;
  reject(error: unknown): void;
}

/**
 * The stream of a world's edits.
 *
 * It connects again by itself, goes on where it was, and sends the edits again that were not answered. Its events are
 * taken by `for await`, or by `poll` once a frame. What it is told of is dropped from the client's cache.
 */
export class EditStream {
  private readonly session: Session;
  private readonly inbox = new Inbox();
  private readonly waiting = new Map<number, Waiting>();
  private readonly left = new AbortController();
  /** While there is a connection. */
  private send: ((frame: WireFrame) => void) | null = null;
  private ended: number | null = null;
  private failure: unknown = null;
  private wake: (() => void)[] = [];

  private constructor(
    private readonly client: StreamClient,
    private readonly world: WorldDescriptor,
    name: string,
    regions: readonly Region[],
    retry: Retry,
  ) {
    const clock = () => performance.now() / 1000;
    this.session = new Session({ client: name, regions, cells: world.chunkCells, retry, clock, random: Math.random });
  }

  /**
   * Connects, and resolves when the server has said welcome.
   *
   * @param name who edits: 1 to 128 visible ASCII characters. A later stream of the same name in the same world ends
   *     this one.
   * @throws {StreamEnded} if the server will not have us; `Unreachable` if it was away for the `secondsMax` of `retry`;
   *     and `Gone` if the descriptor is of another world, which had the same id
   */
  static async open(
    client: StreamClient,
    world: WorldDescriptor,
    name: string,
    options: StreamOptions = {},
  ): Promise<EditStream> {
    if (!NAME.test(name)) {
      throw new RangeError(`name is "${name}": a name has 1 to 128 visible ASCII characters`);
    }
    const retry = retryOf(options.retry);
    const stream = new EditStream(client, world, name, options.regions ?? [EVERYWHERE], retry);
    void stream.run();
    const timer = setTimeout(() => stream.end(LEFT, new Unreachable("no welcome")), 1000 * retry.secondsMax);
    try {
      while (stream.session.epoch === null) {
        stream.check();
        await stream.news();
      }
    } catch (error) {
      throw stream.ended === LEFT ? new Unreachable("no welcome", { cause: stream.failure }) : error;
    } finally {
      clearTimeout(timer);
    }
    if (stream.session.epoch !== world.epoch) {
      stream.close();
      const detail = `${world.id} has the epoch ${stream.session.epoch}, the descriptor ${world.epoch}`;
      throw problem(410, { title: "another world", detail });
    }
    return stream;
  }

  /** Leaves, and forgets the edits that were not answered: await what `edit` returned for those that count. */
  close(): void {
    this.end(LEFT, null);
  }

  /** Everything up to this revision is known. */
  get revision(): bigint {
    return this.session.revision;
  }

  /** Of the world; a world that is deleted and created again, or put back, has another one. */
  get epoch(): string {
    return this.session.epoch ?? this.world.epoch;
  }

  /** Whether there is a connection, on which the server has said welcome. */
  get isLive(): boolean {
    return this.session.isLive;
  }

  /** How many edits wait for their answers. */
  get unanswered(): number {
    return this.session.unansweredCount;
  }

  /** Whether all chunks that are shown are as of everything that is known. */
  get areChunksCurrent(): boolean {
    return this.session.chunks.areCurrent;
  }

  /** The regions that are known to be in force. */
  get regions(): Region[] {
    return this.session.regions;
  }

  /**
   * Sends an edit, over this connection or a later one, until it is answered; it is written once.
   *
   * What is returned gives the `Ack` as soon as the edit is durable; it rejects with the `Problem` for which the edit
   * was refused, or `EditLost`. Who does not look need not.
   *
   * @throws {RangeError} for what is too long for a frame, and if 1,024 edits or 16 MiB wait for their answers;
   *     `StreamEnded`
   */
  edit(strokes: Iterable<Stroke>): Promise<Ack> {
    this.check();
    const seq = this.session.edit([...strokes]);
    const answer = new Promise<Ack>((resolve, reject) => this.waiting.set(seq, { resolve, reject }));
    answer.catch(() => {});
    this.flush();
    return answer;
  }

  /** Has these chunks kept up to date: a `Refresh` says when they are to be fetched, the first time too. */
  show(...keys: ChunkKey[]): void {
    keys.forEach((key) => this.session.chunks.add(key));
    this.tell();
  }

  /** Hears of these chunks no more. */
  hide(...keys: ChunkKey[]): void {
    keys.forEach((key) => this.session.chunks.remove(key));
  }

  /**
   * Tells that all chunks of a refresh have come and are shown.
   *
   * @param revision the lowest `World-Revision` of them, if that is known: what they have is not asked for again
   */
  shown(refresh: Refresh, revision: bigint = refresh.revision): void {
    this.session.chunks.done(refresh, revision);
    this.tell();
  }

  /** Tells that chunks of a refresh have not come: it comes once more. */
  failed(refresh: Refresh): void {
    this.session.chunks.failed(refresh);
    this.tell();
  }

  /**
   * Looks at these regions too. Chunks in them that are shown are fetched again when that is in force.
   *
   * @throws {RangeError} for what is no region, and for more than 64 of them, and changes nothing then
   */
  subscribe(...regions: Region[]): void {
    this.session.subscribe(...regions);
    this.flush();
  }

  /** Looks at these regions no more. */
  unsubscribe(...regions: Region[]): void {
    this.session.unsubscribe(...regions);
    this.flush();
  }

  /** All events that there are, without waiting: for a game that looks once a frame. @throws {StreamEnded} */
  poll(): StreamEvent[] {
    const found: StreamEvent[] = [];
    for (
      let event = this.inbox.take(this.session.chunks);
      event !== null;
      event = this.inbox.take(this.session.chunks)
    ) {
      found.push(event);
    }
    if (!found.length && this.ended !== LEFT) {
      this.check();
    }
    return found;
  }

  /** The events; it throws `StreamEnded` when the server has ended the stream for good, and stops when it is closed. */
  async *[Symbol.asyncIterator](): AsyncGenerator<StreamEvent, void, undefined> {
    for (;;) {
      const event = this.inbox.take(this.session.chunks);
      if (event !== null) {
        yield event;
      } else if (this.ended === LEFT) {
        return;
      } else {
        this.check();
        await this.news();
      }
    }
  }

  private check(): void {
    if (this.ended !== null) {
      throw new StreamEnded(this.ended, { cause: this.failure });
    }
  }

  private news(): Promise<void> {
    return new Promise((resolve) => this.wake.push(resolve));
  }

  private tell(): void {
    for (const wake of this.wake.splice(0)) {
      wake();
    }
  }

  /** Connects, again and again. */
  private async run(): Promise<void> {
    const { session, left } = this;
    try {
      while (this.ended === null && session.connectAt !== null) {
        await pause(Math.max(0, session.connectAt - performance.now() / 1000), left.signal);
        this.note(session.lost(await this.connection()));
      }
    } catch (error) {
      this.end(this.ended ?? 1011, error);
    }
  }

  /** Is connected once. Returns the code with which that ended, null without one. */
  private async connection(): Promise<number | null> {
    try {
      const ticket = await this.client.ticket(this.world, within(OPEN_SECONDS));
      const query = ticket === null ? "" : `?ticket=${encodeURIComponent(ticket)}`;
      const url = new URL(`${this.client.url}${pathOf(this.world)}/stream${query}`);
      url.protocol = url.protocol.replace("http", "ws");
      this.left.signal.throwIfAborted();
      const { code, isOpened } = await carry(url, this.carried(), this.left.signal);
      this.send = null;
      if (isOpened) {
        this.failure = null;
        return code;
      }
      // A browser does not say why it was refused: this may.
      await this.client.world(this.world.id, within(WHY_SECONDS));
      return null;
    } catch (error) {
      this.failure = error;
      return error instanceof Problem && !(error instanceof Unavailable) ? REFUSED + error.status : null;
    }
  }

  /** What the socket is told, and what it tells. */
  private carried(): Carried {
    const { session } = this;
    return {
      get isBroken() {
        return session.isBroken;
      },
      opened: (send) => {
        this.send = send;
        session.connected();
        this.flush();
      },
      received: (frame) => {
        this.note(session.received(frame), typeof frame === "string" ? bytesOf(frame) : frame.byteLength);
        this.flush();
      },
    };
  }

  /** Sends what there is to send. */
  private flush(): void {
    if (this.send !== null) {
      this.session.outgoing().forEach(this.send);
    }
  }

  /** Tells the game, those who wait for answers, and the client's cache. */
  private note(events: readonly SessionEvent[], size = 0): void {
    for (const event of events) {
      this.settle(event);
      if (event.kind === "ended") {
        this.end(event.code, this.failure);
      } else if (event.kind !== "welcome") {
        this.inbox.put(event, size, this.session.revision);
      }
    }
    this.tell();
  }

  private settle(event: SessionEvent): void {
    switch (event.kind) {
      case "ack":
        this.client.outdate(this.world, event.stale, event.revision);
        this.answered(event.seq, ({ resolve }) => resolve(event));
        break;
      case "nack":
        this.answered(event.seq, ({ reject }) => reject(event.problem));
        break;
      case "edits":
      case "stale":
        this.client.outdate(this.world, event.stale, event.revision);
        break;
      case "resync":
        this.client.outdate(this.world, null, event.revision);
        break;
      case "start over":
        this.client.outdate(this.world, null, event.revision);
        for (const seq of event.lost) {
          this.answered(seq, ({ reject }) => reject(new EditLost(seq, "the world has begun anew")));
        }
        break;
      case "welcome":
      case "progress":
      case "ended":
        break;
    }
  }

  private answered(seq: number, settle: (waiting: Waiting) => void): void {
    const waiting = this.waiting.get(seq);
    this.waiting.delete(seq);
    if (waiting !== undefined) {
      settle(waiting);
    }
  }

  /** Is over, if it is not yet. */
  private end(code: number, failure: unknown): void {
    if (this.ended === null) {
      this.ended = code;
      this.failure = failure ?? this.failure;
      this.left.abort(new StreamEnded(code));
      for (const seq of [...this.waiting.keys()]) {
        this.answered(seq, ({ reject }) => reject(new EditLost(seq, new StreamEnded(code).message)));
      }
    }
    this.tell();
  }
}

function within(seconds: number): CallOptions {
  return { signal: AbortSignal.timeout(1000 * seconds) };
}
