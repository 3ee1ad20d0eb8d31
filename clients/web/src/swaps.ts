/** What to draw while chunks are still on their way: docs/level-of-detail.md, "While chunks load". */

import { isStale, type ChunkRange } from "./edits.js";
import { KeyTable } from "./key_table.js";
import type { ChunkSet } from "./levels.js";
import type { FittedChunk } from "./mesh.js";

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
  const [gone, come] = [missing(drawn, wanted), missing(wanted, drawn)];
  const table = new KeyTable(gone.length + come.length);
  const numbers = [...gone, ...come].map(([, chunk]) => table.add(chunk));
  const found: { old: Map<string, FittedChunk>; new: Map<string, FittedChunk> }[] = [];
  const groupOf = groups(table);
  for (const [at, number] of numbers.entries()) {
    const swap = (found[groupOf[number]!] ??= { old: new Map(), new: new Map() });
    const [name, chunk] = at < gone.length ? gone[at]! : come[at - gone.length]!;
    (at < gone.length ? swap.old : swap.new).set(name, chunk);
  }
  return found;
}

/** What a set has and the other has not. */
function missing(set: ChunkSet, other: ChunkSet): (readonly [name: string, chunk: FittedChunk])[] {
  const found: (readonly [string, FittedChunk])[] = [];
  for (const entry of set) {
    if (!other.has(entry[0])) {
      found.push(entry);
    }
  }
  return found;
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
  const table = new KeyTable(changed.length);
  const numbers = changed.map(([, chunk]) => table.add(chunk));
  const found: Map<string, FittedChunk>[] = [];
  const groupOf = groups(table);
  for (const [at, number] of numbers.entries()) {
    (found[groupOf[number]!] ??= new Map()).set(...changed[at]!);
  }
  return found;
}

/** By the number of a key, the number of its group: those of different groups do not touch. */
function groups(table: KeyTable): Int32Array {
  const { keys } = table;
  const leader = Int32Array.from(keys, (_, number) => number);
  const first = (number: number): number => {
    while (leader[number] !== number) {
      leader[number] = leader[leader[number]!]!;
      number = leader[number]!;
    }
    return number;
  };
  const lods = [...new Set(keys.map(({ lod }) => lod))];
  for (const [number, { lod: finer, x, y, z }] of keys.entries()) {
    for (const lod of lods) {
      if (lod < finer) {
        continue;
      }
      // the chunks of a level, none finer, that this one touches or lies in
      const wide = 2 ** (lod - finer);
      const [x1, y1, z1] = [Math.floor((x + 1) / wide), Math.floor((y + 1) / wide), Math.floor((z + 1) / wide)];
      for (let i = Math.floor((x - 1) / wide); i <= x1; i++) {
        for (let j = Math.floor((y - 1) / wide); j <= y1; j++) {
          for (let k = Math.floor((z - 1) / wide); k <= z1; k++) {
            const other = table.find(lod, i, j, k);
            if (other >= 0) {
              leader[first(other)] = first(number);
            }
          }
        }
      }
    }
  }
  const numberOf = new Map<number, number>();
  return leader.map((_, number) => {
    const group = numberOf.get(first(number)) ?? numberOf.size;
    numberOf.set(first(number), group);
    return group;
  });
}
