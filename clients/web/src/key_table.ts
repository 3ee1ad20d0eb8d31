/** Chunks by their keys, without a name for each: looking one up allocates nothing. */

import type { ChunkKey } from "./mesh.js";

/** Odd, and far apart: what is one chunk on is somewhere else in the table. */
const [MIX_X, MIX_Y, MIX_Z, MIX_LOD] = [0x9e3779b1, 0x85ebca6b, 0xc2b2ae35, 0x27d4eb2f];
/** Places in the table for each key that it has room for, at least: most that is looked for is not there. */
const ROOM = 4;
const EMPTY = -1;

/** A set of keys, each with the number of its place in it. */
export class KeyTable {
  /** In the order in which they were added. */
  readonly keys: ChunkKey[] = [];
  private readonly table: Int32Array;

  /** @param keysMax so many are added at most */
  constructor(keysMax: number) {
    this.table = new Int32Array(2 ** Math.ceil(Math.log2(ROOM * keysMax + 1))).fill(EMPTY);
  }

  /** The number of a key; one that is new becomes the last. */
  add(key: ChunkKey): number {
    const at = this.placeOf(key.lod, key.x, key.y, key.z);
    if (this.table[at] === EMPTY) {
      this.table[at] = this.keys.push(key) - 1;
    }
    return this.table[at]!;
  }

  /** The number of a key, or -1 if it was not added. */
  find(lod: number, x: number, y: number, z: number): number {
    return this.table[this.placeOf(lod, x, y, z)]!;
  }

  /** Where a key is in the table, or would be: the first free place behind its own. */
  private placeOf(lod: number, x: number, y: number, z: number): number {
    const last = this.table.length - 1;
    const mixed = Math.imul(x, MIX_X) ^ Math.imul(y, MIX_Y) ^ Math.imul(z, MIX_Z) ^ Math.imul(lod, MIX_LOD);
    for (let at = (mixed ^ (mixed >>> 15)) & last; ; at = (at + 1) & last) {
      const number = this.table[at]!;
      if (number === EMPTY || isAt(this.keys[number]!, lod, x, y, z)) {
        return at;
      }
    }
  }
}

function isAt(key: ChunkKey, lod: number, x: number, y: number, z: number): boolean {
  return key.x === x && key.y === y && key.z === z && key.lod === lod;
}
