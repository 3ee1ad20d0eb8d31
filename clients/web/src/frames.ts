/** The batch stream, version 1, from bytes as they come to frames: docs/wire/batch-v1.md. */

import { CODINGS, type Coding } from "./coding.js";
import { BadAnswer } from "./errors.js";
import { CONTENTS, REVISION_MAX, type Content } from "./mesh.js";

export const BATCH_MEDIA_TYPE = "application/vnd.chunkserver.batch";

const MAGIC = 0x424e4843; // "CHNB"
const VERSION = 1;
const STREAM_HEADER_BYTES = 16;
const FRAME_HEADER_BYTES_MIN = 64;
const FRAME_HEADER_BYTES_MAX = 1 << 10;
const TAG_BYTES = 32;
const END = 0xffffffff;
const ALIGNMENT = 16;

/** One chunk of a batch. */
export interface Frame {
  /** Which of the request's chunks. */
  readonly index: number;
  /** What a request for it alone would have had. */
  readonly status: number;
  /** null if it is not told. */
  readonly content: Content | null;
  /** Of `body`. */
  readonly coding: Coding;
  /** Of the chunk's own last edit. */
  readonly revision: bigint;
  /** Without quotes; "" if there is none. */
  readonly tag: string;
  /** In a buffer of its own. */
  readonly body: Uint8Array<ArrayBuffer>;
}

/**
 * Takes the stream in pieces of any size and gives its frames. After the end frame, `isDone` is true.
 *
 * It throws `BadAnswer` for a stream that is none; at most one frame is held.
 */
export class FrameReader {
  isDone = false;
  private readonly held = new Pieces();
  private frameHeaderBytes = 0;
  private count = 0;

  /** @param bytesMax of the body of a frame */
  constructor(private readonly bytesMax: number) {}

  /** The frames that `piece` completes. */
  *feed(piece: Uint8Array): Generator<Frame> {
    this.held.push(piece);
    if (!this.frameHeaderBytes && this.held.length >= STREAM_HEADER_BYTES) {
      this.readStreamHeader();
    }
    while (this.frameHeaderBytes && !this.isDone) {
      const frame = this.next();
      if (frame === null) {
        return;
      }
      yield frame;
    }
  }

  private readStreamHeader(): void {
    const view = viewOf(this.held.peek(STREAM_HEADER_BYTES));
    const [magic, version, headerBytes] = [view.getUint32(0, true), view.getUint16(4, true), view.getUint16(6, true)];
    if (magic !== MAGIC || version !== VERSION) {
      throw new BadAnswer(
        `a batch begins with 0x${magic.toString(16)} ${version}: expected 0x${MAGIC.toString(16)} ${VERSION}`,
      );
    }
    const fits = headerBytes >= FRAME_HEADER_BYTES_MIN && headerBytes <= FRAME_HEADER_BYTES_MAX;
    if (!fits || headerBytes % ALIGNMENT) {
      throw new BadAnswer(`frame_header_bytes is ${headerBytes}`);
    }
    this.frameHeaderBytes = headerBytes;
    this.held.drop(STREAM_HEADER_BYTES);
  }

  /** The next frame; null if it is not all there yet, or if the stream is done. */
  private next(): Frame | null {
    if (this.held.length < FRAME_HEADER_BYTES_MIN) {
      return null;
    }
    const header = this.held.peek(FRAME_HEADER_BYTES_MIN);
    const view = viewOf(header);
    const [bodyBytes, index] = [view.getUint32(0, true), view.getUint32(4, true)];
    if (bodyBytes > this.bytesMax) {
      throw new BadAnswer(`a frame of ${bodyBytes} bytes: at most ${this.bytesMax}`);
    }
    const end = this.frameHeaderBytes + Math.ceil(bodyBytes / ALIGNMENT) * ALIGNMENT;
    if (this.held.length < end) {
      return null;
    }
    const body = this.held.peek(end).slice(this.frameHeaderBytes, this.frameHeaderBytes + bodyBytes);
    this.held.drop(end);
    if (index === END) {
      this.finish(view.getUint32(12, true));
      return null;
    }
    this.count += 1;
    return readFrame(view, header, index, body);
  }

  private finish(count: number): void {
    if (count !== this.count || this.held.length) {
      throw new BadAnswer(`the end frame counts ${count} frames, ${this.count} came; ${this.held.length} bytes follow`);
    }
    this.isDone = true;
  }
}

function readFrame(view: DataView, header: Uint8Array, index: number, body: Uint8Array<ArrayBuffer>): Frame {
  const content = view.getUint8(10);
  const coding = CODINGS[view.getUint8(11)];
  const revision = view.getBigUint64(16, true);
  const tag = String.fromCharCode(...header.subarray(24, 24 + TAG_BYTES)).replace(/\0+$/, "");
  if (content > CONTENTS.length || coding === undefined || revision > REVISION_MAX || /[^!-~]/.test(tag)) {
    throw new BadAnswer(`frame ${index} has content ${content}, coding ${view.getUint8(11)}, revision ${revision}`);
  }
  return {
    index,
    status: view.getUint16(8, true),
    content: content ? CONTENTS[content - 1]! : null,
    coding,
    revision,
    tag,
    body,
  };
}

/** Bytes that came in pieces. */
class Pieces {
  length = 0;
  private readonly pieces: Uint8Array[] = [];

  push(piece: Uint8Array): void {
    if (piece.length) {
      this.pieces.push(piece);
      this.length += piece.length;
    }
  }

  /** The first `count` bytes, which are there: in one piece, that may be shared. */
  peek(count: number): Uint8Array<ArrayBuffer> {
    if (!this.pieces[0] || this.pieces[0].length < count) {
      const whole = new Uint8Array(this.length);
      let at = 0;
      for (const piece of this.pieces.splice(0)) {
        whole.set(piece, at);
        at += piece.length;
      }
      this.pieces.push(whole);
    }
    return this.pieces[0]!.subarray(0, count) as Uint8Array<ArrayBuffer>;
  }

  /** Forgets the first `count` bytes, which are in the first piece. */
  drop(count: number): void {
    this.length -= count;
    this.pieces[0] = this.pieces[0]!.subarray(count);
    if (!this.pieces[0].length) {
      this.pieces.shift();
    }
  }
}

function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}
