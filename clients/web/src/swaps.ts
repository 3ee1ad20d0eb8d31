/** What to draw while chunks are still on their way: docs/level-of-detail.md, "While chunks load". */

import { isStale, type ChunkRange } from "./edits.js";
import type { ChunkSet } from "./levels.js";
import { chunkName, keyName, type ChunkKey, type FittedChunk } from "./mesh.js";

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
  const gone = changes(drawn, wanted);
  const come = changes(wanted, drawn);
  const keys = new Set([...gone.keys(), ...come.keys()]);
  return groups(keys, (key) => (gone.get(key) ?? come.get(key)!)[0]![1]).map((group) => ({
    old: new Map(group.flatMap((key) => gone.get(key) ?? [])),
    new: new Map(group.flatMap((key) => come.get(key) ?? [])),
  }));
}

/** What a set has and the other has not, by `keyName`. */
function changes(set: ChunkSet, other: ChunkSet): Map<string, [name: string, chunk: FittedChunk][]> {
  const found = new Map<string, [string, FittedChunk][]>();
  for (const entry of set) {
    if (!other.has(entry[0])) {
      const key = keyName(entry[1]);
      found.set(key, [...(found.get(key) ?? []), entry]);
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
  const changed = new Map<string, FittedChunk>();
  for (const chunk of drawn.values()) {
    if (isStale(chunk, stale)) {
      changed.set(keyName(chunk), chunk);
    }
  }
  return groups(changed.keys(), (key) => changed.get(key)!).map((keys) =>
    among(
      keys.map((key) => changed.get(key)!),
      drawn,
    ),
  );
}

function among(chunks: readonly FittedChunk[], set: ChunkSet): ChunkSet {
  return new Map(chunks.map((chunk) => [chunkName(chunk), chunk] as const).filter(([name]) => set.has(name)));
}

/** The keys in groups: those of different groups do not touch. */
function groups(names: Iterable<string>, keyOf: (name: string) => ChunkKey): string[][] {
  const leader = new Map(Array.from(names, (name) => [name, name]));
  const first = (name: string): string => {
    for (let up = leader.get(name)!; up !== name; up = leader.get(name)!) {
      leader.set(name, leader.get(up)!);
      name = leader.get(name)!;
    }
    return name;
  };
  const lods = [...new Set(Array.from(leader.keys(), (name) => keyOf(name).lod))].sort((one, other) => one - other);
  for (const name of leader.keys()) {
    for (const other of touched(keyOf(name), lods)) {
      if (leader.has(other)) {
        leader.set(first(other), first(name));
      }
    }
  }
  const found = new Map<string, string[]>();
  for (const name of leader.keys()) {
    const group = found.get(first(name));
    if (group === undefined) {
      found.set(first(name), [name]);
    } else {
      group.push(name);
    }
  }
  return [...found.values()];
}

/** The chunks of some levels, none finer, that a chunk touches or lies in. */
function* touched(key: ChunkKey, lods: readonly number[]): Generator<string> {
  for (const lod of lods) {
    if (lod < key.lod) {
      continue;
    }
    const wide = 2 ** (lod - key.lod);
    const [xs, ys, zs] = [key.x, key.y, key.z].map(
      (place) => new Set([-1, 0, 1].map((step) => Math.floor((place + step) / wide))),
    );
    for (const x of xs!) {
      for (const y of ys!) {
        for (const z of zs!) {
          yield keyName({ lod, x, y, z });
        }
      }
    }
  }
}
