/** Which chunks that a game has are out of date, what to fetch for them, and what to show together. */

import { isStale, type ChunkRange } from "../edits.js";
import { keyName, type ChunkKey } from "../mesh.js";

/** Chunks to be fetched with `minRevision`, and to be shown all at once: what one edit has cut fits. */
export interface Refresh {
  readonly kind: "refresh";
  readonly keys: readonly ChunkKey[];
  readonly revision: bigint;
}

/** Chunks by their `keyName`, that are fetched together. */
interface Group {
  readonly keys: Map<string, ChunkKey>;
  readonly revision: bigint;
}

/** The revision of a chunk that was not fetched yet. */
const NEVER = -1n;

/**
 * The chunks that a game wants, and as of which revision of the world it has them.
 *
 *     add --> waiting -- take --> fetching -- done --> up to date -- changed --> waiting
 */
export class Chunks {
  private readonly held = new Map<string, { readonly key: ChunkKey; revision: bigint }>();
  private readonly waiting = new Map<string, Group>();
  private readonly fetching = new Map<string, Refresh>();

  /** Whether there is nothing to fetch, and nothing is fetched. */
  get areCurrent(): boolean {
    return !this.waiting.size && !this.fetching.size;
  }

  /** Wants a chunk from now on. Nothing that changes it is missed, also while it is fetched for the first time. */
  add({ lod, x, y, z }: ChunkKey): void {
    const key = { lod, x, y, z };
    const name = keyName(key);
    if (!this.held.has(name)) {
      this.held.set(name, { key, revision: NEVER });
      this.wait(new Map([[name, key]]), 0n);
    }
  }

  /** Wants a chunk no more. */
  remove(key: ChunkKey): void {
    this.held.delete(keyName(key));
    this.narrow(keyName(key));
  }

  /** Notes that chunks may have changed at a revision. */
  changed(ranges: readonly ChunkRange[], revision: bigint): void {
    const found = new Set<string>();
    for (const range of ranges) {
      for (const name of this.among(range)) {
        found.add(name);
      }
    }
    this.outdateAll(found, revision);
  }

  /** Notes that the chunks for which this holds may have changed at a revision. */
  outdate(isOutdated: (key: ChunkKey) => boolean, revision: bigint): void {
    const found = [...this.held].filter(([, { key }]) => isOutdated(key)).map(([name]) => name);
    this.outdateAll(new Set(found), revision);
  }

  /** What to fetch now. What changes while it is fetched is returned again when it is `done`. */
  take(): Refresh[] {
    const groups = [...new Set(this.waiting.values())];
    const ready = groups.filter(({ keys }) => ![...keys.keys()].some((name) => this.fetching.has(name)));
    return ready.map(({ keys, revision }) => {
      const refresh: Refresh = { kind: "refresh", keys: [...keys.values()], revision };
      for (const name of keys.keys()) {
        this.waiting.delete(name);
        this.fetching.set(name, refresh);
      }
      return refresh;
    });
  }

  /** Notes that all chunks of a refresh have come and are shown. revision: the lowest `World-Revision` of them. */
  done(refresh: Refresh, revision: bigint): void {
    for (const name of this.ended(refresh)) {
      const held = this.held.get(name);
      if (held !== undefined) {
        held.revision = held.revision > revision ? held.revision : revision;
        const waiting = this.waiting.get(name);
        if (waiting !== undefined && waiting.revision <= held.revision) {
          this.narrow(name);
        }
      }
    }
  }

  /** Notes that chunks of a refresh have not come: `take` returns them again. */
  failed(refresh: Refresh): void {
    this.outdateAll(this.ended(refresh), refresh.revision);
  }

  /** Forgets all chunks. */
  clear(): void {
    this.held.clear();
    this.waiting.clear();
    this.fetching.clear();
  }

  /** The chunks of a range that are held. Few of many are looked up, and not looked for. */
  private *among(range: ChunkRange): Generator<string> {
    const { lod, low, high } = range;
    const count = low.reduce((product, first, axis) => product * (high[axis]! - first + 1), 1);
    if (count > this.held.size) {
      for (const [name, { key }] of this.held) {
        if (isStale(key, [range])) {
          yield name;
        }
      }
      return;
    }
    for (let x = low[0]; x <= high[0]; x++) {
      for (let y = low[1]; y <= high[1]; y++) {
        for (let z = low[2]; z <= high[2]; z++) {
          const name = keyName({ lod, x, y, z });
          if (this.held.has(name)) {
            yield name;
          }
        }
      }
    }
  }

  private outdateAll(found: Set<string>, revision: bigint): void {
    const keys = new Map<string, ChunkKey>();
    for (const name of found) {
      const held = this.held.get(name);
      if (held !== undefined && held.revision < revision) {
        keys.set(name, held.key);
      }
    }
    for (const other of new Set([...keys.keys()].map((name) => this.waiting.get(name)))) {
      if (other !== undefined) {
        other.keys.forEach((key, name) => keys.set(name, key));
        revision = revision > other.revision ? revision : other.revision;
      }
    }
    this.wait(keys, revision);
  }

  /** The chunks that were fetched for this; none if all was forgotten meanwhile. */
  private ended(refresh: Refresh): Set<string> {
    const names = refresh.keys.map(keyName).filter((name) => this.fetching.get(name) === refresh);
    names.forEach((name) => this.fetching.delete(name));
    return new Set(names);
  }

  private wait(keys: Map<string, ChunkKey>, revision: bigint): void {
    const group = { keys, revision };
    for (const name of keys.keys()) {
      this.waiting.set(name, group);
    }
  }

  private narrow(name: string): void {
    this.waiting.get(name)?.keys.delete(name);
    this.waiting.delete(name);
  }
}
