/** What to draw while chunks are still on their way: docs/level-of-detail.md, "While chunks load". */

import { isStale, type ChunkRange } from "./edits.js";
import { KeyTable } from "./key_table.js";
import type { ChunkSet } from "./levels.js";
import type { ChunkKey, FittedChunk } from "./mesh.js";
import { inOne, type Parts } from "./parts.js";

/** Keys of a part: each takes a microsecond or two. */
const PART_KEYS = 128;

/** Chunks that take the place of others, all at once. */
export interface Swap {
  readonly old: ChunkSet;
  readonly new: ChunkSet;
}

/**
 * The steps from what is drawn to what is wanted: the smallest that leave no hole, in any order.
 *
 * Each is done when all chunks of `new` have come. Both sets are selections, or what steps have made of one. A chunk
 * that is out of date has another name in `drawn` than its `chunkName`: so it counts as changed, and is among the old
 * under that name.
 */
export function swaps(drawn: ChunkSet, wanted: ChunkSet): Swap[] {
  return inOne(swapsInParts(drawn, wanted));
}

/**
 * The same as `swaps`, but in parts of a fraction of a millisecond: for a thread that has other things to do in between.
 * Both sets have to stay as they are until then.
 */
export function* swapsInParts(drawn: ChunkSet, wanted: ChunkSet): Parts<Swap[]> {
  const gone = missing(drawn, wanted);
  yield;
  const come = missing(wanted, drawn);
  yield;
  const groupOf = yield* groups([...gone.chunks, ...come.chunks]);
  const found: { old: Map<string, FittedChunk>; new: Map<string, FittedChunk> }[] = [];
  let at = 0;
  for (const { names, chunks } of [gone, come]) {
    const side = names === gone.names ? "old" : "new";
    for (let each = 0; each < names.length; each++) {
      const swap = (found[groupOf[at++]!] ??= { old: new Map(), new: new Map() });
      swap[side].set(names[each]!, chunks[each]!);
    }
    yield;
  }
  return found;
}

/** What a set has and the other has not. */
function missing(set: ChunkSet, other: ChunkSet): { names: string[]; chunks: FittedChunk[] } {
  const names: string[] = [];
  const chunks: FittedChunk[] = [];
  set.forEach((chunk, name) => {
    if (!other.has(name)) {
      names.push(name);
      chunks.push(chunk);
    }
  });
  return { names, chunks };
}

/**
 * Which of the chunks that are drawn an edit may have changed, in groups that do not touch each other.
 *
 * Fetch a group with `minRevision`, and draw all of it anew at once: then borders fit at all times.
 *
 * @param drawn a selection
 * @param stale of the edit
 */
export function redraws(drawn: ChunkSet, stale: readonly ChunkRange[]): ChunkSet[] {
  const changed = [...drawn].filter(([, chunk]) => isStale(chunk, stale));
  const found: Map<string, FittedChunk>[] = [];
  const groupOf = inOne(groups(changed.map(([, chunk]) => chunk)));
  for (const [at, named] of changed.entries()) {
    (found[groupOf[at]!] ??= new Map()).set(...named);
  }
  return found;
}

/** By the place of each chunk, the number of its group: those of different groups do not touch. */
function* groups(chunks: readonly ChunkKey[]): Parts<Int32Array> {
  const table = new KeyTable(chunks.length);
  const found = new Int32Array(chunks.length);
  const lods: number[] = [];
  for (let at = 0; at < chunks.length; at++) {
    const chunk = chunks[at]!;
    found[at] = table.add(chunk);
    if (!lods.includes(chunk.lod)) {
      lods.push(chunk.lod);
    }
  }
  yield;
  const { keys } = table;
  const leader = new Int32Array(keys.length);
  for (let number = 0; number < keys.length; number++) {
    leader[number] = number;
  }
  for (let number = 0; number < keys.length; number++) {
    const key = keys[number]!;
    joinBeside(table, leader, number, key);
    for (const lod of lods) {
      if (lod > key.lod) {
        joinAbove(table, leader, number, key, lod);
      }
    }
    if (number % PART_KEYS === PART_KEYS - 1) {
      yield;
    }
  }
  const groupOf = new Int32Array(keys.length).fill(-1);
  let count = 0;
  for (let at = 0; at < found.length; at++) {
    const leading = first(leader, found[at]!);
    if (groupOf[leading] === -1) {
      groupOf[leading] = count++;
    }
    found[at] = groupOf[leading]!;
  }
  return found;
}

/** Joins a key with those of its level that it touches: half of them, since each of two finds the other. */
function joinBeside(table: KeyTable, leader: Int32Array, number: number, { lod, x, y, z }: ChunkKey): void {
  for (let i = 0; i <= 1; i++) {
    for (let j = i === 0 ? 0 : -1; j <= 1; j++) {
      for (let k = i === 0 && j === 0 ? 1 : -1; k <= 1; k++) {
        join(leader, number, table.find(lod, x + i, y + j, z + k));
      }
    }
  }
}

/** Joins a key with those of a coarser level that it touches, or lies in. */
function joinAbove(table: KeyTable, leader: Int32Array, number: number, key: ChunkKey, lod: number): void {
  const wide = 2 ** (lod - key.lod);
  const x1 = Math.floor((key.x + 1) / wide);
  const y1 = Math.floor((key.y + 1) / wide);
  const z1 = Math.floor((key.z + 1) / wide);
  for (let i = Math.floor((key.x - 1) / wide); i <= x1; i++) {
    for (let j = Math.floor((key.y - 1) / wide); j <= y1; j++) {
      for (let k = Math.floor((key.z - 1) / wide); k <= z1; k++) {
        join(leader, number, table.find(lod, i, j, k));
      }
    }
  }
}

/** Makes one group of two. other: -1 is nobody */
function join(leader: Int32Array, number: number, other: number): void {
  if (other >= 0) {
    leader[first(leader, other)] = first(leader, number);
  }
}

/** Who stands for the group that a key is in. */
function first(leader: Int32Array, number: number): number {
  while (leader[number] !== number) {
    leader[number] = leader[leader[number]!]!;
    number = leader[number]!;
  }
  return number;
}
