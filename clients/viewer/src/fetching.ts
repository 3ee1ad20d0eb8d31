/** Chunks on their way: a few small batches at a time, the most wanted first, none for longer than it is wanted. */

import {
  chunkName,
  type AnyWorld,
  type ChunkClient,
  type ChunkMesh,
  type FittedChunk,
  type Triple,
} from "chunkserver-client";

/** Batches at a time: the server answers one while the other's chunks come over. */
const BATCHES_MAX = 2;
/** Chunks of a batch: few, so that what is wanted now does not wait behind what was wanted before. */
const BATCH_CHUNKS = 48;
/** A batch ends early when less than that part of what is left of it is wanted. */
const WANTED_LEAST = 0.5;

/** A chunk and its `chunkName`. */
export type Named = readonly [name: string, chunk: FittedChunk];

interface Batch {
  readonly left: Map<string, FittedChunk>;
  readonly cancel: AbortController;
}

/** What becomes of chunks. */
export interface Arrivals {
  arrived(mesh: ChunkMesh): void;
  failed(error: unknown): void;
}

export class Fetching {
  /** Milliseconds during which something was on its way, and how many chunks came: for the panel. */
  busyMs = 0;
  arrived = 0;
  private readonly batches = new Set<Batch>();
  private queue: Named[] = [];
  private busySince = 0;
  /** Of the world: the server answers from there on. */
  private minRevision = 0n;

  constructor(
    private readonly client: ChunkClient,
    private world: AnyWorld,
    private readonly arrivals: Arrivals,
  ) {}

  get underWay(): number {
    let count = 0;
    for (const batch of this.batches) {
      count += batch.left.size;
    }
    return count;
  }

  setWorld(world: AnyWorld): void {
    this.world = world;
  }

  /** No chunk comes any more that was built before this revision. It is the caller who drops what is under way. */
  expect(revision: bigint): void {
    this.minRevision = revision > this.minRevision ? revision : this.minRevision;
  }

  /** Asks for these chunks and no others, the first ones first. viewer: in voxels */
  want(chunks: readonly Named[], viewer: Triple): void {
    const wanted = new Map(chunks);
    for (const batch of this.batches) {
      const still = [...batch.left.keys()].filter((name) => wanted.has(name));
      if (still.length < WANTED_LEAST * batch.left.size) {
        this.end(batch);
      } else {
        still.forEach((name) => wanted.delete(name));
      }
    }
    this.queue = [...wanted];
    this.begin(viewer);
  }

  /** Ends all batches. */
  stop(): void {
    this.queue = [];
    [...this.batches].forEach((batch) => this.end(batch));
  }

  /** Ends the batches in which there is such a chunk: it would come as it was. Returns whether there were any. */
  drop(isOld: (chunk: FittedChunk) => boolean): boolean {
    const old = [...this.batches].filter(({ left }) => [...left.values()].some(isOld));
    old.forEach((batch) => this.end(batch));
    return old.length > 0;
  }

  private end(batch: Batch): void {
    this.batches.delete(batch);
    batch.cancel.abort();
    this.rest();
  }

  private begin(viewer: Triple): void {
    while (this.batches.size < BATCHES_MAX && this.queue.length > 0) {
      const chunks = this.queue.splice(0, BATCH_CHUNKS);
      const batch = { left: new Map(chunks), cancel: new AbortController() };
      this.busySince = this.batches.size === 0 ? performance.now() : this.busySince;
      this.batches.add(batch);
      void this.run(batch, viewer);
    }
  }

  private async run(batch: Batch, viewer: Triple): Promise<void> {
    const { signal } = batch.cancel;
    const { minRevision } = this;
    const since = this.world.kind === "world" && minRevision > 0n ? { minRevision } : {};
    try {
      for await (const mesh of this.client.chunks(this.world, batch.left.values(), { viewer, signal, ...since })) {
        if (signal.aborted) {
          return;
        }
        batch.left.delete(chunkName({ ...mesh.key, coarser: mesh.coarser }));
        this.arrived += 1;
        this.arrivals.arrived(mesh);
      }
    } catch (error) {
      if (signal.aborted) {
        return;
      }
      this.stop();
      this.arrivals.failed(error);
      return;
    }
    this.batches.delete(batch);
    this.rest();
    this.begin(viewer);
  }

  private rest(): void {
    if (this.batches.size === 0) {
      this.busyMs += performance.now() - this.busySince;
    }
  }
}
