/** The messages of docs/wire/edit_v1.md: those of the server are read, those of the client written. */

import { bytesOfBase64, readRanges, type ChunkRange, type Stroke } from "../edits.js";
import { BadAnswer, problem, type Problem } from "../errors.js";
import { Json } from "../json.js";
import { REVISION_MAX } from "../mesh.js";
import { jsonText } from "../questions.js";
import { written, type Region } from "./regions.js";

const FRAME_BYTES_MAX = 1 << 16;
const SEQ_MAX = Number.MAX_SAFE_INTEGER;
const [STATUS_MIN, STATUS_MAX] = [400, 599];

/** What goes over the wire: text or binary. */
export type WireFrame = string | Uint8Array<ArrayBuffer>;

/** The server knows who is there. */
export interface Welcome {
  readonly kind: "welcome";
  readonly epoch: string;
  readonly revision: bigint;
  readonly floor: bigint;
  readonly lastSeq: number | null;
  /** How many edits may wait for their answers. */
  readonly inflight: number;
}

/** An edit is durable. */
export interface Ack {
  readonly kind: "ack";
  readonly seq: number;
  readonly revision: bigint;
  readonly duplicate: boolean;
  /** The chunks that it may have changed; null if the server does not know any more. */
  readonly stale: readonly ChunkRange[] | null;
}

/** An edit was refused: nothing of it was written. */
export interface Nack {
  readonly kind: "nack";
  readonly seq: number;
  readonly problem: Problem;
}

/** Somebody else's edit. */
export interface Edit {
  readonly revision: bigint;
  /** null if they are too large for the stream; the log has them. */
  readonly strokes: readonly Stroke[] | null;
}

/** All edits of others in (after, revision] that are in the regions. */
export interface Edits {
  readonly kind: "edits";
  readonly after: bigint;
  readonly revision: bigint;
  readonly edits: readonly Edit[];
  /** The chunks that they may have changed. */
  readonly stale: readonly ChunkRange[];
}

/** Everything up to a revision was told. */
export interface Progress {
  readonly kind: "progress";
  readonly revision: bigint;
  /** How many requests for other regions are in force. */
  readonly asked: number;
}

/** Edits up to a revision were left out: these chunks may have changed. */
export interface Stale {
  readonly kind: "stale";
  readonly stale: readonly ChunkRange[];
  readonly revision: bigint;
}

/** Edits up to a revision were missed: every chunk may have changed. */
export interface Resync {
  readonly kind: "resync";
  readonly floor: bigint;
  readonly revision: bigint;
  readonly epoch: string;
}

export type Message = Welcome | Ack | Nack | Edits | Progress | Stale | Resync;

/** A message of the server; null if it is of a type that is not known here. @throws {BadAnswer} */
export function readMessage(frame: string | ArrayBuffer): Message | null {
  if (typeof frame !== "string") {
    throw new BadAnswer(`a binary frame of ${frame.byteLength} bytes: those come from clients only`);
  }
  const found = Json.parse(frame);
  const type = found.at("type").text();
  return Object.hasOwn(READERS, type) ? READERS[type]!(found) : null;
}

/** The message that opens a connection. */
export function hello(client: string, epoch: string | null, resume: bigint | null, regions: Iterable<Region>): string {
  return jsonText({ type: "hello", client, epoch, resume, regions: Array.from(regions, written) });
}

/**
 * The message of an edit: binary if a delta has its values as an `Int32Array`.
 *
 * @throws {RangeError} if it is too long for a frame, or has a number that is none
 */
export function edit(seq: number, strokes: readonly Stroke[]): WireFrame {
  const isBinary = strokes.some(({ values }) => values instanceof Int32Array);
  const frame = isBinary ? withValues(seq, strokes) : jsonText({ type: "edit", seq, strokes });
  const bytes = bytesOf(frame);
  if (bytes > FRAME_BYTES_MAX) {
    throw new RangeError(`the edit has ${bytes} bytes; on a stream it has at most ${FRAME_BYTES_MAX}`);
  }
  return frame;
}

/** The message that adds regions, or takes them away. */
export function regionsChanged(isAdded: boolean, regions: Iterable<Region>): string {
  return jsonText({ type: isAdded ? "subscribe" : "unsubscribe", regions: Array.from(regions, written) });
}

/** How long a frame is on the wire. */
export function bytesOf(frame: WireFrame): number {
  return typeof frame === "string" ? new TextEncoder().encode(frame).length : frame.length;
}

/** docs/wire/edit_v1.md, "Bulk deltas". */
function withValues(seq: number, strokes: readonly Stroke[]): Uint8Array<ArrayBuffer> {
  const bulk: Uint8Array[] = [];
  const rest = strokes.map(({ values, ...others }) => {
    if (values instanceof Int32Array) {
      bulk.push(new Uint8Array(values.buffer, values.byteOffset, values.byteLength));
    } else if (typeof values === "string") {
      bulk.push(bytesOfBase64(values));
    }
    return others;
  });
  const head = new TextEncoder().encode(jsonText({ type: "edit", seq, strokes: rest }));
  const start = Math.ceil((4 + head.length) / 4) * 4;
  const frame = new Uint8Array(start + bulk.reduce((sum, { length }) => sum + length, 0));
  new DataView(frame.buffer).setUint32(0, head.length, true);
  frame.set(head, 4);
  let at = start;
  for (const bytes of bulk) {
    frame.set(bytes, at);
    at += bytes.length;
  }
  return frame;
}

const READERS: Readonly<Record<string, (found: Json) => Message>> = {
  welcome: (found) => ({
    kind: "welcome",
    epoch: found.at("epoch").text(),
    revision: revision(found, "revision"),
    floor: revision(found, "floor"),
    lastSeq: found.get("last_seq")?.integer(0, SEQ_MAX) ?? null,
    inflight: found.at("limits").at("inflight").integer(1, SEQ_MAX),
  }),
  ack: (found) => {
    const stale = found.get("stale");
    return {
      kind: "ack",
      seq: seq(found),
      revision: revision(found, "revision"),
      duplicate: found.at("duplicate").boolean(),
      stale: stale === null ? null : readRanges(stale),
    };
  },
  nack: (found) => {
    const why = found.at("problem");
    return {
      kind: "nack",
      seq: seq(found),
      problem: problem(why.at("status").integer(STATUS_MIN, STATUS_MAX), why.members()),
    };
  },
  edits: (found) => ({
    kind: "edits",
    after: revision(found, "after"),
    revision: revision(found, "revision"),
    edits: found.at("edits").elements().map(readEdit),
    stale: readRanges(found.at("stale")),
  }),
  progress: (found) => ({
    kind: "progress",
    revision: revision(found, "revision"),
    asked: found.at("asked").integer(0, SEQ_MAX),
  }),
  stale: (found) => ({ kind: "stale", stale: readRanges(found.at("chunks")), revision: revision(found, "revision") }),
  resync: (found) => ({
    kind: "resync",
    floor: revision(found, "floor"),
    revision: revision(found, "revision"),
    epoch: found.at("epoch").text(),
  }),
};

function readEdit(found: Json): Edit {
  const strokes = found.get("strokes");
  return {
    revision: revision(found, "revision"),
    strokes: strokes?.elements().map((stroke) => stroke.members()) ?? null,
  };
}

function revision(found: Json, name: string): bigint {
  return found.at(name).decimal(0n, REVISION_MAX);
}

function seq(found: Json): number {
  return found.at("seq").integer(0, SEQ_MAX);
}
