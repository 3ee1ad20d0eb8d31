/** Edits: what the server says of one that was written, and of those in its log; docs/api.md, "Edits". */

import type { Json } from "./json.js";
import { CELLS_BUILT, LOD_MAX, REVISION_MAX, VOXELS_MAX, type ChunkKey, type Triple } from "./mesh.js";

/**
 * As docs/edits/strokes.md has them: `{ op: "carve", shape: "sphere", center: [0, 0, 0], radius: 6 }`.
 *
 * The `values` of a delta may be an `Int32Array`, x fastest, then z, then y.
 */
export type Stroke = Readonly<Record<string, unknown>>;

const PLACE_MAX = VOXELS_MAX / Math.min(...CELLS_BUILT);

/** Chunks of a level from `low` to `high`, both included: x, y, z. */
export interface ChunkRange {
  readonly lod: number;
  readonly low: Triple;
  readonly high: Triple;
}

/** An edit that is durable. */
export interface WrittenEdit {
  /** Of the world with this edit. */
  readonly revision: bigint;
  /** It had been written before, under the same key; this is its first answer. */
  readonly duplicate: boolean;
  /** The chunks that it may have changed. */
  readonly stale: readonly ChunkRange[];
}

/** An edit of a world's log. */
export interface LoggedEdit {
  readonly revision: bigint;
  /** As they were sent, defaults written out. */
  readonly strokes: readonly Stroke[];
  readonly stale: readonly ChunkRange[];
}

/** Whether a chunk is in any of these ranges. */
export function isStale(key: ChunkKey, stale: Iterable<ChunkRange>): boolean {
  const place: Triple = [key.x, key.y, key.z];
  for (const { lod, low, high } of stale) {
    if (lod === key.lod && place.every((at, axis) => low[axis]! <= at && at <= high[axis]!)) {
      return true;
    }
  }
  return false;
}

export function readWritten(json: Json): WrittenEdit {
  const revision = json.at("revision").decimal(1n, REVISION_MAX);
  return { revision, duplicate: json.at("duplicate").boolean(), stale: readRanges(json.at("stale")) };
}

/**
 * A part of a log, and the world's revision.
 *
 * @throws {BadAnswer} if it does not go on behind `after`
 */
export function readLog(json: Json, after: bigint): { edits: LoggedEdit[]; revision: bigint } {
  const revision = json.at("revision").decimal(0n, REVISION_MAX);
  const edits = json
    .at("edits")
    .elements()
    .map((row, at) => {
      const number = after + BigInt(at) + 1n;
      const strokes = row
        .at("strokes")
        .elements()
        .map((stroke) => stroke.members());
      return { revision: row.at("revision").decimal(number, number), strokes, stale: readRanges(row.at("stale")) };
    });
  if (!edits.length && revision > after) {
    json.at("edits").refuse(`edits from ${after + 1n} to ${revision}`);
  }
  return { edits, revision };
}

export function readRanges(json: Json): ChunkRange[] {
  return json.elements().map((row) => {
    const [low, high] = [place(row.at("min")), place(row.at("max"))];
    if (low.some((first, axis) => first > high[axis]!)) {
      row.refuse("a range with its low end first");
    }
    return { lod: row.at("lod").integer(0, LOD_MAX), low, high };
  });
}

function place(json: Json): Triple {
  const values = json.elements().map((value) => value.integer(-PLACE_MAX, PLACE_MAX));
  return values.length === 3 ? [values[0]!, values[1]!, values[2]!] : json.refuse("three integers");
}

export function base64Of(values: Int32Array): string {
  const bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
}

export function bytesOfBase64(text: string): Uint8Array {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}
