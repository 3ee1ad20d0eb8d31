/**
 * A session of one player in one world, as a state machine: it lasts over any number of connections.
 *
 *     waiting -- connected --> opening -- welcome --> live -- lost --> waiting ...          any of them --> ended
 *
 * It knows no socket and no clock. Whoever has the socket connects when `connectAt` has come, hands over what it reads,
 * sends what `outgoing` returns, and closes the socket when `isBroken`. docs/wire/edit_v1.md is the protocol.
 */

import type { Stroke } from "../edits.js";
import { BadAnswer } from "../errors.js";
import { backoff, type Retry } from "../retry.js";
import { Chunks } from "./chunks.js";
import * as messages from "./messages.js";
import type { Message, Progress, Welcome, WireFrame } from "./messages.js";
import { holds, regionsOf, type Region, type Regions } from "./regions.js";
import { Unanswered } from "./unanswered.js";

/** The server says something at least once a second: a connection that is silent for so long is dead. */
const SILENCE_SECONDS = 5;
/** Codes after which another connection would end in the same way. */
const FINAL_CODES: ReadonlySet<number> = new Set([1009, 4400, 4401, 4403, 4404, 4409, 4412, 4422]);

/** Another world has this id, or its history was replaced: nothing that was known of it holds. */
export interface StartOver {
  readonly kind: "start over";
  readonly epoch: string;
  readonly revision: bigint;
  /** Seqs of the edits that nobody answers any more. */
  readonly lost: readonly number[];
}

/** The session is over: the server closed the connection with a code that says so. lost: seqs without an answer. */
export interface Ended {
  readonly kind: "ended";
  readonly code: number;
  readonly lost: readonly number[];
}

export type SessionEvent = Message | StartOver | Ended;

/** What makes a session. */
export interface SessionOptions {
  /** Who this is: 1 to 128 visible ASCII characters, which nobody else in the world has. */
  readonly client: string;
  /** Where it looks. */
  readonly regions: readonly Region[];
  /** Of a chunk's side. */
  readonly cells: number;
  /** How long to wait between connections: `backoffSeconds` and `backoffSecondsMax`. */
  readonly retry: Retry;
  /** Seconds. */
  readonly clock: () => number;
  /** From 0 to 1. */
  readonly random: () => number;
}

export class Session {
  /** Of the world; null before the first welcome. */
  epoch: string | null = null;
  /** Everything up to it is known. */
  revision = 0n;
  /** What the game has, and what of it is out of date. */
  readonly chunks = new Chunks();
  /** When to connect; null if there is a connection, or the session is over. */
  connectAt: number | null;

  private state: "waiting" | "opening" | "live" | "ended" = "waiting";
  private wanted: Map<string, Region>;
  /** What the server was told to look at on this connection. */
  private told: Regions;
  private readonly inForce: Set<string>;
  /** By request that is under way, the names of the regions that it adds. */
  private asked: string[][] = [];
  /** How many requests of this connection are in force; -1 if not even its hello is. */
  private obeyed = 0;
  private readonly unanswered = new Unanswered();
  private ready: WireFrame[] = [];
  private seq = 0;
  private inflightMax = 0;
  private failures = 0;
  private heardAt: number;
  private isRefused = false;

  constructor(private readonly options: SessionOptions) {
    this.wanted = regionsOf(...options.regions);
    this.told = new Map(this.wanted);
    this.inForce = new Set(this.wanted.keys());
    this.connectAt = this.heardAt = options.clock();
  }

  /** Whether the server has welcomed this connection. */
  get isLive(): boolean {
    return this.state === "live";
  }

  /** Whether the connection is of no use any more: close it, and call `lost`. */
  get isBroken(): boolean {
    const isConnected = this.state === "opening" || this.state === "live";
    return this.isRefused || (isConnected && this.options.clock() - this.heardAt > SILENCE_SECONDS);
  }

  /** The regions that are known to be in force. */
  get regions(): Region[] {
    return [...this.wanted].filter(([name]) => this.inForce.has(name)).map(([, region]) => region);
  }

  /** Whether every region that was asked for is in force. */
  get areRegionsInForce(): boolean {
    const isTold = this.wanted.size === this.told.size && [...this.wanted.keys()].every((name) => this.told.has(name));
    return this.isLive && !this.asked.length && isTold;
  }

  /** How many edits wait for their answers. */
  get unansweredCount(): number {
    return this.unanswered.count;
  }

  /**
   * Has an edit sent, and sent again until it is answered; returns its seq, which the answer has.
   *
   * @throws {RangeError} before the first welcome, after the end, for what is too long for a frame, if too many wait
   */
  edit(strokes: readonly Stroke[]): number {
    if (this.epoch === null || this.state === "ended") {
      throw new RangeError(`the session is ${this.state}: edits come after the first welcome`);
    }
    this.unanswered.add(this.seq + 1, messages.edit(this.seq + 1, strokes));
    this.seq += 1;
    return this.seq;
  }

  /**
   * Looks at these regions too. Chunks in them that the game has are fetched again when that is in force.
   *
   * What changes while there is no connection is in the next hello; what changes while the server has not obeyed yet is
   * asked for at once when it has. So two requests are under way at most, however often a game looks elsewhere.
   *
   * @throws {RangeError} for what is no region, and for more than 64 of them, and changes nothing then
   */
  subscribe(...regions: Region[]): void {
    this.wanted = regionsOf(...this.wanted.values(), ...regions);
  }

  /** Looks at these regions no more. */
  unsubscribe(...regions: Region[]): void {
    for (const name of regionsOf(...regions).keys()) {
      this.wanted.delete(name);
    }
  }

  /** Begins on a new connection. */
  connected(): void {
    this.connectAt = null;
    this.heardAt = this.options.clock();
    this.isRefused = false;
    this.state = "opening";
    const resume = this.epoch === null ? null : this.revision;
    this.ready = [messages.hello(this.options.client, this.epoch, resume, this.wanted.values())];
    this.told = new Map(this.wanted);
    this.asked = [[...this.told.keys()].filter((name) => !this.inForce.has(name))];
    this.obeyed = -1;
    for (const name of this.inForce) {
      if (!this.told.has(name)) {
        this.inForce.delete(name);
      }
    }
  }

  /** Takes a frame; returns what the game should know. What cannot be breaks the connection. */
  received(frame: string | ArrayBuffer): SessionEvent[] {
    this.heardAt = this.options.clock();
    try {
      const message = messages.readMessage(frame);
      if (message === null || this.isRefused) {
        return [];
      }
      const events = this.take(message);
      this.failures = message.kind === "welcome" ? this.failures : 0;
      return events;
    } catch (error) {
      if (!(error instanceof BadAnswer)) {
        throw error;
      }
      this.isRefused = true;
      return [];
    }
  }

  /**
   * Notes that the connection is closed, or could not be made.
   *
   * @param code of the closing frame, if there was one; 4000 + the HTTP status if the upgrade was answered otherwise
   */
  lost(code: number | null = null): SessionEvent[] {
    if (code !== null && FINAL_CODES.has(code)) {
      this.state = "ended";
      this.connectAt = null;
      return [{ kind: "ended", code, lost: this.unanswered.clear() }];
    }
    this.connectAt = this.options.clock() + backoff(this.options.retry, this.failures, this.options.random);
    this.failures += 1;
    this.state = "waiting";
    this.ready = [];
    return [];
  }

  /** What to send now, in order: text as strings, binary as bytes. */
  outgoing(): WireFrame[] {
    const frames = this.ready;
    this.ready = [];
    return this.isLive ? [...frames, ...this.asks(), ...this.unanswered.toSend(this.inflightMax)] : frames;
  }

  /** The requests for other regions, if those before are in force. First what goes: there is room then. */
  private asks(): string[] {
    if (this.asked.length) {
      return [];
    }
    const gone = [...this.told].filter(([name]) => !this.wanted.has(name));
    const added = [...this.wanted].filter(([name]) => !this.told.has(name));
    this.told = new Map(this.wanted);
    gone.forEach(([name]) => this.inForce.delete(name));
    const requests = [
      { isAdded: false, regions: gone },
      { isAdded: true, regions: added },
    ].filter(({ regions }) => regions.length);
    this.asked = requests.map(({ isAdded, regions }) => (isAdded ? regions.map(([name]) => name) : []));
    return requests.map(({ isAdded, regions }) =>
      messages.regionsChanged(
        isAdded,
        regions.map(([, region]) => region),
      ),
    );
  }

  private take(message: Message): SessionEvent[] {
    if ((message.kind === "welcome") === this.isLive) {
      throw new BadAnswer(`${message.kind} came, and the session is ${this.state}`);
    }
    switch (message.kind) {
      case "welcome":
        return this.welcomed(message);
      case "progress":
        return this.progressed(message);
      case "ack":
      case "nack":
        if (!this.unanswered.has(message.seq)) {
          return [];
        }
        this.unanswered.answered(message.seq);
        if (message.kind === "ack") {
          this.chunks.changed(message.stale ?? [], message.revision);
        }
        return [message];
      case "edits":
        this.advance(message.revision, message.after);
        this.chunks.changed(message.stale, message.revision);
        return [message];
      case "stale":
        this.advance(message.revision);
        this.chunks.changed(message.stale, message.revision);
        return [message];
      case "resync":
        this.advance(message.revision);
        this.chunks.outdate(() => true, message.revision);
        return [message];
    }
  }

  private welcomed(welcome: Welcome): SessionEvent[] {
    const { epoch, revision, lastSeq, inflight } = welcome;
    let events: SessionEvent[] = [welcome];
    if (epoch !== this.epoch) {
      if (this.epoch !== null) {
        events = [{ kind: "start over", epoch, revision, lost: this.unanswered.clear() }, welcome];
        this.chunks.clear();
      }
      this.epoch = epoch;
      this.revision = revision;
      this.chunks.outdate(() => true, revision);
    }
    this.seq = Math.max(this.seq, lastSeq ?? 0);
    this.state = "live";
    this.inflightMax = inflight;
    this.unanswered.resend();
    this.obey(0);
    return events;
  }

  private progressed(message: Progress): SessionEvent[] {
    const isNews = message.revision > this.revision || message.asked > this.obeyed;
    this.advance(message.revision);
    this.obey(message.asked);
    return isNews ? [message] : [];
  }

  /** Goes on to a revision. @throws {BadAnswer} if what lies between was not told */
  private advance(revision: bigint, after: bigint | null = null): void {
    if (revision < this.revision || (after !== null && after !== this.revision)) {
      throw new BadAnswer(`edits of (${after}, ${revision}] came, and everything up to ${this.revision} is known`);
    }
    this.revision = revision;
  }

  /** Notes how many requests for regions are in force. Until then edits there may have been missed. */
  private obey(asked: number): void {
    const count = asked - this.obeyed;
    if (!(count >= 0 && count <= this.asked.length)) {
      throw new BadAnswer(`${asked} requests for regions are in force; there were ${this.obeyed + this.asked.length}`);
    }
    const names = this.asked.splice(0, count).flat();
    this.obeyed = asked;
    names.forEach((name) => this.inForce.add(name));
    const regions = names.map((name) => this.told.get(name)!);
    if (regions.length) {
      this.chunks.outdate((key) => regions.some((region) => holds(region, key, this.options.cells)), this.revision);
    }
  }
}
