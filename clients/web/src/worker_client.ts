/** A client in a worker: what is fetched is decoded there, and comes over as it is, without a copy. */

import type { BatchOptions } from "./batch.js";
import type { CallOptions, Client, ClientOptions, ListOptions, WorldOptions } from "./client.js";
import type { AnyWorld, WorldDescriptor } from "./descriptors.js";
import type { ChunkRange, LoggedEdit, Stroke } from "./edits.js";
import { ClientError, Unreachable, WorkerFailed } from "./errors.js";
import type { ChunkKey, ChunkMesh } from "./mesh.js";
import type { ChunkOptions, RecipeTree } from "./questions.js";
import { ITEMS_AHEAD, unpacked, type Asked, type CallName, type Port, type Told } from "./remote.js";

/** What a client can do, in whatever thread it is. */
export type ChunkClient = { readonly [Name in keyof Client]: Client[Name] };

/** Items that were taken are told of in so many at a time, for each message takes its time. */
const TAKEN_TOLD = ITEMS_AHEAD / 4;

type Result<Name extends CallName> = Awaited<ReturnType<Client[Name]>>;

/** Whoever waits for what the worker tells of one call. */
interface Waiting {
  told(told: Told): void;
  failed(error: unknown): void;
}

/** The same as `Client`, but that the work is done in a worker. */
export class WorkerClient implements ChunkClient {
  /** Of the server, without a slash at the end. */
  readonly url: string;
  private readonly port: Port;
  private readonly waiting = new Map<number, Waiting>();
  private last = 0;
  /** Why no call is answered any more. */
  private failure: ClientError | null = null;

  /**
   * @param url of the server; a worker knows no relative ones
   * @param worker what runs the module `chunkserver-client/worker`. Left out, a worker is started from the file beside
   *     this one, which bundlers that know `new Worker(new URL(..., import.meta.url))` find.
   */
  constructor(url: string, options: ClientOptions = {}, worker?: Port) {
    this.url = url.replace(/\/+$/, "");
    this.port = worker ?? new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    this.port.addEventListener("message", ({ data }) => this.waiting.get((data as Told).id)?.told(data as Told));
    this.port.addEventListener("error", (event) => this.lost((event as Partial<ErrorEvent>).message));
    this.port.addEventListener("messageerror", () => this.lost("a message could not be read"));
    this.tell({ make: [url, options] });
  }

  /** Ends the worker. What is under way fails, and so does what is asked from then on. */
  close(): void {
    this.end(new Unreachable("the client is closed"));
  }

  seed(seed: number | bigint, recipe?: string, options: CallOptions = {}) {
    return this.ask("seed", [seed, recipe], options);
  }

  world(id: string, options: CallOptions = {}) {
    return this.ask("world", [id], options);
  }

  worlds(options: ListOptions = {}) {
    return this.ask("worlds", [], options);
  }

  createWorld(id: string, seed: number | bigint, recipe?: string | RecipeTree, options: WorldOptions = {}) {
    return this.ask("createWorld", [id, seed, recipe], options);
  }

  deleteWorld(id: string) {
    return this.ask("deleteWorld", [id]);
  }

  recipes(options: CallOptions = {}) {
    return this.ask("recipes", [], options);
  }

  recipe(name: string, options: CallOptions = {}) {
    return this.ask("recipe", [name], options);
  }

  postRecipe(recipe: RecipeTree, options: CallOptions = {}) {
    return this.ask("postRecipe", [recipe], options);
  }

  chunk(world: AnyWorld, key: ChunkKey, options: ChunkOptions & CallOptions = {}) {
    return this.ask("chunk", [world, key], options);
  }

  chunkHead(world: AnyWorld, key: ChunkKey, options: ChunkOptions & CallOptions = {}) {
    return this.ask("chunkHead", [world, key], options);
  }

  chunks(world: AnyWorld, chunks: Iterable<ChunkKey & { readonly coarser?: number }>, options: BatchOptions = {}) {
    return this.iterate<ChunkMesh>("chunks", [world, [...chunks]], options);
  }

  edit(world: WorldDescriptor, strokes: Iterable<Stroke>, key: string | null = null) {
    return this.ask("edit", [world, [...strokes], key]);
  }

  edits(world: WorldDescriptor, after?: bigint, limit?: number) {
    return this.iterate<LoggedEdit>("edits", [world, after, limit], {});
  }

  ticket(world: WorldDescriptor, options: CallOptions = {}) {
    return this.ask("ticket", [world], options);
  }

  isReady() {
    return this.ask("isReady", []);
  }

  waitUntilReady(seconds?: number, options: CallOptions = {}) {
    return this.ask("waitUntilReady", [seconds], options);
  }

  traffic() {
    return this.ask("traffic", []);
  }

  outdate(world: WorldDescriptor, stale: readonly ChunkRange[] | null, revision: bigint): void {
    this.ask("outdate", [world, stale, revision]).catch(() => {}); // without a worker there is no cache either
  }

  /** One call that has one answer. */
  private async ask<Name extends CallName>(
    call: Name,
    args: readonly unknown[],
    options: object = {},
  ): Promise<Result<Name>> {
    const { signal, ...rest } = options as CallOptions;
    this.check(signal);
    const id = ++this.last;
    const stop = () => {
      this.tell({ id, cancel: true });
      this.waiting.get(id)?.failed(signal?.reason);
    };
    try {
      return await new Promise<Result<Name>>((resolve, failed) => {
        const told = (message: Told) =>
          "value" in message ? resolve(message.value as Result<Name>) : failed(errorOf(message));
        this.waiting.set(id, { told, failed });
        signal?.addEventListener("abort", stop, { once: true });
        this.tell({ id, call, args: [...args, rest] });
      });
    } finally {
      signal?.removeEventListener("abort", stop);
      this.waiting.delete(id);
    }
  }

  /** One call that has many answers; whoever leaves it early cancels it. */
  private async *iterate<Item>(
    call: "chunks" | "edits",
    args: readonly unknown[],
    options: CallOptions,
  ): AsyncGenerator<Item, void, undefined> {
    const { signal, ...rest } = options;
    this.check(signal);
    const id = ++this.last;
    const arrived: (Exclude<Told, { items: unknown }> | { item: unknown })[] = [];
    let wake = () => {};
    let failure: { readonly error: unknown } | null = null;
    const told = (message: Told) => {
      if ("items" in message) {
        message.items.forEach((item) => arrived.push({ item }));
      } else {
        arrived.push(message);
      }
      wake();
    };
    const failed = (error: unknown) => {
      failure = { error };
      wake();
    };
    const stop = () => failed(signal?.reason);
    this.waiting.set(id, { told, failed });
    signal?.addEventListener("abort", stop, { once: true });
    this.tell({ id, call, args: [...args, rest] });
    let isOver = false;
    let taken = 0;
    try {
      for (;;) {
        const message = arrived.shift();
        const broken = failure as { readonly error: unknown } | null;
        if (broken !== null) {
          throw broken.error;
        }
        if (message === undefined) {
          await new Promise<void>((resolve) => (wake = resolve));
        } else if ("item" in message) {
          taken += 1;
          if (taken === TAKEN_TOLD) {
            this.tell({ id, taken });
            taken = 0;
          }
          yield message.item as Item;
        } else {
          isOver = true;
          if ("error" in message) {
            throw errorOf(message);
          }
          return;
        }
      }
    } finally {
      signal?.removeEventListener("abort", stop);
      this.waiting.delete(id);
      if (!isOver) {
        this.tell({ id, cancel: true });
      }
    }
  }

  private tell(asked: Asked): void {
    this.port.postMessage(asked, []);
  }

  private check(signal: AbortSignal | undefined): void {
    signal?.throwIfAborted();
    if (this.failure !== null) {
      throw this.failure;
    }
  }

  /** The worker is of no use any more. why: "" or nothing for one that could not be loaded */
  private lost(why: string | undefined): void {
    this.end(new WorkerFailed(`the worker has failed: ${why || "it could not be loaded"}`));
  }

  private end(error: ClientError): void {
    this.failure ??= error;
    if ("terminate" in this.port) {
      (this.port as Worker).terminate();
    }
    for (const each of [...this.waiting.values()]) {
      each.failed(this.failure);
    }
  }
}

function errorOf(told: Told): unknown {
  return unpacked("error" in told ? told.error : told);
}
