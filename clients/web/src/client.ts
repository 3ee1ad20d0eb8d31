/** The client of one server, in whatever thread it is made. `worker_client.ts` has the same in a worker. */

import { headOfChunk, meshOf, numberOf } from "./answers.js";
import { BATCH_CHUNKS_MAX, Batch, type BatchOptions } from "./batch.js";
import { AnswerCache } from "./cache.js";
import { CODINGS, type Coding } from "./coding.js";
import {
  placeIn,
  readListedWorld,
  readRecipe,
  readSeed,
  readWorld,
  type AnyWorld,
  type ChunkHead,
  type ListedWorld,
  type Recipe,
  type SeedDescriptor,
  type WorldDescriptor,
} from "./descriptors.js";
import {
  isStale,
  readLog,
  readWritten,
  type ChunkRange,
  type LoggedEdit,
  type Stroke,
  type WrittenEdit,
} from "./edits.js";
import { BadAnswer, Unavailable, Unreachable } from "./errors.js";
import { Exchange, checked, jsonOf, type Traffic } from "./exchange.js";
import type { Json } from "./json.js";
import { chunkName, squaredDistance, type ChunkKey, type ChunkMesh, type FittedChunk } from "./mesh.js";
import {
  chunkAsked,
  chunkRequest,
  editRequest,
  fitted,
  got,
  posted,
  type ChunkOptions,
  type RecipeTree,
  type Request,
} from "./questions.js";
import { retryOf, type Retry } from "./retry.js";

const CACHE_BYTES = 1 << 26;
/** A server waits up to 30 s before it gives a chunk up. */
const READ_SECONDS = 40;
/** The first start of a version compiles its kernels. */
const READY_SECONDS = 120;
const READY_POLL_SECONDS_MAX = 1;
const WORLDS_PER_PAGE = 1000;
/** Of the list of worlds: a million. A server that goes on for ever is not believed. */
const PAGES_MAX = 1000;
const EDITS_PER_PAGE = 1000;
const API_KEY = /^[!-~]+$/;

/** What makes a client; all of it can be sent to a worker. */
export interface ClientOptions {
  /** Sent as `Authorization: Bearer`. */
  readonly apiKey?: string;
  /** How patient it is. */
  readonly retry?: Partial<Retry>;
  /** Of answers that are kept in memory; 0 keeps none. */
  readonly cacheBytes?: number;
  /** How chunks of a batch travel. */
  readonly coding?: Coding;
  /** For an answer's head, and for each piece of its body. */
  readonly readSeconds?: number;
}

/** A new world; what is left out is the server's default. */
export interface WorldOptions {
  /** Metres. */
  readonly voxelSize?: number;
  readonly lods?: number;
  /** 16, 32 or 64. */
  readonly chunkCells?: number;
}

/** What may be said of any call. */
export interface CallOptions {
  readonly signal?: AbortSignal;
}

/** Which part of a list; all of it by default. */
export interface ListOptions extends CallOptions {
  /** What comes behind this id, which need not be there. */
  readonly after?: string;
  /** At most so many. */
  readonly limit?: number;
}

/**
 * A client of one server.
 *
 * Every method throws `Problem` for an answer that is an error, `BadAnswer` for one that is not what the documents say,
 * and `Unreachable` if none came: `errors.ts` draws the tree.
 */
export class Client {
  /** Of the server, without a slash at the end. */
  readonly url: string;
  private readonly exchange: Exchange;
  private readonly coding: Coding;

  /**
   * @param url of the server: `http://127.0.0.1:8000`, or `location.origin`. A path, of a proxy, stays in front.
   * @param fetch another one than the platform's
   */
  constructor(
    url: string,
    options: ClientOptions = {},
    fetch: typeof globalThis.fetch = (input, init) => globalThis.fetch(input, init),
  ) {
    const { apiKey, retry, cacheBytes = CACHE_BYTES, coding = "zstd", readSeconds = READ_SECONDS } = options;
    if (!/^https?:\/\//.test(url)) {
      throw new RangeError(`url is "${url}": expected http://... or https://...`);
    }
    if (apiKey !== undefined && !API_KEY.test(apiKey)) {
      throw new RangeError("apiKey has to be visible ASCII characters: no blank, no line break, and not nothing");
    }
    if (!CODINGS.includes(coding)) {
      throw new RangeError(`coding is "${coding}": there are ${CODINGS.join(", ")}`);
    }
    const headers = apiKey === undefined ? {} : { authorization: `Bearer ${apiKey}` };
    this.url = url.replace(/\/+$/, "");
    this.coding = coding;
    this.exchange = new Exchange(this.url, headers, retryOf(retry), new AnswerCache(cacheBytes), readSeconds, fetch);
  }

  /** The pristine world of a seed: it needs no creation, and is the same for everybody. From 2^53 on it is a bigint. */
  async seed(seed: number | bigint, recipe = "terrain", { signal }: CallOptions = {}): Promise<SeedDescriptor> {
    return this.json(got(["v1", "seeds", seedAsked(seed)], { recipe }), readSeed, signal);
  }

  /** A world, as it is by now. @throws {NotFound} and `Conflict` if another generator has created it */
  world(id: string, { signal }: CallOptions = {}): Promise<WorldDescriptor> {
    return this.json(got(["v1", "worlds", id]), readWorld, signal);
  }

  /** All worlds, by id, or a part of them. */
  async worlds({ after, limit = Infinity, signal }: ListOptions = {}): Promise<ListedWorld[]> {
    const found: ListedWorld[] = [];
    let page: Record<string, string> = after === undefined ? {} : { after };
    for (let pages = 0; pages < PAGES_MAX; pages++) {
      const count = Math.min(WORLDS_PER_PAGE, limit - found.length);
      const json = await this.json(got(["v1", "worlds"], { limit: String(count), ...page }), (whole) => whole, signal);
      found.push(...json.at("worlds").elements().map(readListedWorld));
      const next = json.get("next");
      if (next === null || found.length >= limit) {
        return found;
      }
      page = { after: next.text() };
    }
    throw new BadAnswer(`the list of worlds has more than ${PAGES_MAX} pages`);
  }

  /** Creates a world; the same one once more changes nothing. @throws {Conflict} if another one has the id */
  async createWorld(
    id: string,
    seed: number | bigint,
    recipe: string | RecipeTree = "terrain",
    options: WorldOptions = {},
  ): Promise<WorldDescriptor> {
    const { voxelSize: voxel_size, lods, chunkCells: chunk_cells } = options;
    return this.json(
      posted("/v1/worlds", { id, seed: seedAsked(seed), recipe, voxel_size, lods, chunk_cells }),
      readWorld,
      undefined,
      200,
      201,
    );
  }

  /** Deletes a world, for good. It alone is not asked for again when the connection is lost. @throws {NotFound} */
  async deleteWorld(id: string): Promise<void> {
    const request: Request = { ...got(["v1", "worlds", id]), method: "DELETE", repeatable: false };
    await this.exchange.ask(request, (answer) => void checked(answer, 204));
  }

  /** The built-in recipes, without their expressions. */
  recipes({ signal }: CallOptions = {}): Promise<Recipe[]> {
    return this.json(got(["v1", "recipes"], {}, true), (json) => json.at("recipes").elements().map(readRecipe), signal);
  }

  /** The built-in recipe of a name, or any of a digest. @throws {NotFound} */
  recipe(name: string, { signal }: CallOptions = {}): Promise<Recipe> {
    return this.json(got(["v1", "recipes", name], {}, true), readRecipe, signal);
  }

  /**
   * Makes a recipe known to the server; its digest names it from then on. Posting it again does no harm.
   *
   * @throws {BadRequest} whose `values` have the `path` to the bad node
   */
  postRecipe(recipe: RecipeTree, { signal }: CallOptions = {}): Promise<Recipe> {
    return this.json(posted("/v1/recipes", recipe), readRecipe, signal, 200, 201);
  }

  /**
   * The mesh of a chunk; an empty one is a mesh without vertices, whose `content` is "air" or "rock".
   *
   * @throws {Gone} when the server has got another generator; then the descriptor has to be read again
   */
  chunk(world: AnyWorld, key: ChunkKey, options: ChunkOptions & CallOptions = {}): Promise<ChunkMesh> {
    const parse = (answer: Parameters<typeof meshOf>[0]) => meshOf(answer, placeIn(world, key), options.coarser ?? 0);
    return this.exchange.ask(chunkRequest(world, key, options), parse, options.signal);
  }

  /** What the server says of a chunk, without the chunk. It builds it all the same. */
  chunkHead(world: AnyWorld, key: ChunkKey, options: ChunkOptions & CallOptions = {}): Promise<ChunkHead> {
    return this.exchange.ask(chunkRequest(world, key, options, "HEAD"), headOfChunk, options.signal);
  }

  /**
   * Yields the mesh of each of many chunks, in the order in which they get ready.
   *
   * What a stream that breaks off has left out is asked for again, for as long as `Retry` allows without any gain. A
   * chunk that fails for a reason of its own does not stop the others: that error is thrown at the end.
   *
   * @param chunks each with a mask of its own, or with that of the options. One that comes twice is yielded once. Up to
   *     1,024 are one request, more are several.
   */
  async *chunks(
    world: AnyWorld,
    chunks: Iterable<ChunkKey & { readonly coarser?: number }>,
    options: BatchOptions = {},
  ): AsyncGenerator<ChunkMesh, void, undefined> {
    const found = new Map<string, FittedChunk>();
    for (const chunk of chunks) {
      const asked = fitted(chunk, options);
      found.set(chunkName(asked), asked);
    }
    const asked = [...found.values()];
    const { viewer } = options;
    if (viewer !== undefined && asked.length > BATCH_CHUNKS_MAX) {
      const distances = new Map(asked.map((chunk) => [chunk, squaredDistance(placeIn(world, chunk), viewer)]));
      asked.sort((one, other) => distances.get(one)! - distances.get(other)! || other.lod - one.lod);
    }
    for (let start = 0; start < asked.length; start += BATCH_CHUNKS_MAX) {
      yield* new Batch(
        this.exchange,
        world,
        asked.slice(start, start + BATCH_CHUNKS_MAX),
        options,
        this.coding,
      ).meshes();
    }
  }

  /**
   * Changes a world; resolves when that is durable: every chunk that is asked for from then on has it.
   *
   * What the edit made stale is dropped from the cache.
   *
   * @param strokes applied in their order, as one: docs/edits/strokes.md
   * @param key another name of this edit, 1 to 128 visible ASCII characters: who sends the edit again with the same key
   *     gets the first answer, and nothing is written twice. One is made up if none is given.
   * @throws {BadRequest} whose `values` have the `path` to the bad stroke: then nothing is written
   */
  async edit(world: WorldDescriptor, strokes: Iterable<Stroke>, key: string | null = null): Promise<WrittenEdit> {
    const written = await this.json(editRequest(world, strokes, key), readWritten);
    this.outdate(world, written.stale, written.revision);
    return written;
  }

  /** Yields the edits of a world behind revision `after`, in their order; at most `limit`. */
  async *edits(world: WorldDescriptor, after = 0n, limit = Infinity): AsyncGenerator<LoggedEdit, void, undefined> {
    for (let left = limit; left > 0;) {
      const query = { after: String(after), limit: String(Math.min(EDITS_PER_PAGE, left)) };
      const { edits, revision } = await this.json(got(["v1", "worlds", world.id, "edits"], query), (json) =>
        readLog(json, after),
      );
      for (const edit of edits) {
        this.outdate(world, edit.stale, edit.revision);
        yield edit;
      }
      left -= edits.length;
      after += BigInt(edits.length);
      if (after >= revision) {
        return;
      }
    }
  }

  /** A ticket that opens the stream of a world's edits once, in place of the API key; null if the client has none. */
  async ticket(world: WorldDescriptor, { signal }: CallOptions = {}): Promise<string | null> {
    if (this.exchange.headers["authorization"] === undefined) {
      return null;
    }
    const request: Request = { ...got(["v1", "worlds", world.id, "tickets"]), method: "POST" };
    return await this.json(request, (json) => json.at("ticket").text(), signal, 200, 201);
  }

  /** Whether the server answers, and can build chunks by now. */
  async isReady(): Promise<boolean> {
    try {
      await this.waitUntilReady(0);
      return true;
    } catch (error) {
      if (error instanceof Unavailable || error instanceof Unreachable) {
        return false;
      }
      throw error;
    }
  }

  /** Resolves when the server can build chunks. @throws {Unavailable} or `Unreachable` after `seconds` */
  async waitUntilReady(seconds = READY_SECONDS, { signal }: CallOptions = {}): Promise<void> {
    const secondsMax = Math.max(seconds, READY_POLL_SECONDS_MAX);
    const attemptsMax = seconds ? Infinity : 1;
    const patience = retryOf({ attemptsMax, secondsMax, backoffSecondsMax: READY_POLL_SECONDS_MAX });
    await this.exchange.ask(got(["readyz"]), (answer) => void checked(answer, 200), signal, patience);
  }

  /** What it has asked and got since it was made. */
  async traffic(): Promise<Traffic> {
    return { ...this.exchange.traffic };
  }

  /** Forgets the chunks that are older than what may have changed them. stale: which; null is all. */
  outdate(world: WorldDescriptor, stale: readonly ChunkRange[] | null, revision: bigint): void {
    if (stale !== null && !stale.length) {
      return;
    }
    this.exchange.cache.dropWhere((url, { headers }) => {
      const key = chunkAsked(world, url);
      const isOlder = key !== null && numberOf(headers, "chunk-revision") < revision;
      return isOlder && (stale === null || isStale(key, stale));
    });
  }

  private json<Value>(
    request: Request,
    read: (json: Json) => Value,
    signal?: AbortSignal,
    ...statuses: number[]
  ): Promise<Value> {
    return this.exchange.ask(
      request,
      (answer) => read(jsonOf(checked(answer, ...(statuses.length ? statuses : [200])))),
      signal,
    );
  }
}

/** @throws {RangeError} for a number that JavaScript has rounded, or may have: it would be another world */
function seedAsked(seed: number | bigint): string {
  if (typeof seed === "number" && !Number.isSafeInteger(seed)) {
    throw new RangeError(`seed is ${seed}: a number has to be an integer below 2^53, what is larger a bigint`);
  }
  return String(seed);
}
