/** Edits that wait for their answers: sent in the order of their seqs, and sent again, unchanged, after a reconnect. */

import { bytesOf, type WireFrame } from "./messages.js";

const EDITS_MAX = 1024;
const BYTES_MAX = 16 << 20;

/** Frames by seq, each either sent on this connection or not yet. */
export class Unanswered {
  private readonly frames = new Map<number, WireFrame>();
  private unsent: number[] = [];
  private bytes = 0;

  /** How many wait. */
  get count(): number {
    return this.frames.size;
  }

  /** Whether an edit waits. */
  has(seq: number): boolean {
    return this.frames.has(seq);
  }

  /** Adds an edit with a higher seq than any before. @throws {RangeError} if too many wait */
  add(seq: number, frame: WireFrame): void {
    if (this.frames.size >= EDITS_MAX || this.bytes + bytesOf(frame) > BYTES_MAX) {
      throw new RangeError(`${this.frames.size} edits wait for their answers, which have ${this.bytes} bytes`);
    }
    this.frames.set(seq, frame);
    this.unsent.push(seq);
    this.bytes += bytesOf(frame);
  }

  /** What may be sent now, if so many edits may be without an answer on one connection. */
  toSend(inflightMax: number): WireFrame[] {
    const room = Math.max(inflightMax - this.frames.size + this.unsent.length, 0);
    return this.unsent.splice(0, room).map((seq) => this.frames.get(seq)!);
  }

  /** Forgets an edit. */
  answered(seq: number): void {
    this.bytes -= bytesOf(this.frames.get(seq)!);
    this.frames.delete(seq);
    this.unsent = this.unsent.filter((other) => other !== seq);
  }

  /** Has all of them sent again: there is another connection. */
  resend(): void {
    this.unsent = [...this.frames.keys()];
  }

  /** Forgets all of them; returns their seqs. */
  clear(): number[] {
    const seqs = [...this.frames.keys()];
    this.frames.clear();
    this.unsent = [];
    this.bytes = 0;
    return seqs;
  }
}
