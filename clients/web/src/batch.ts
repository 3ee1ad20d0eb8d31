/** Many chunks in one answer; what a stream that breaks off leaves out is asked for again. */

import { meshOf } from "./answers.js";
import type { Entry } from "./cache.js";
import type { Coding } from "./coding.js";
import { placeIn, type AnyWorld } from "./descriptors.js";
import { BadAnswer, ClientError, Unavailable, problem } from "./errors.js";
import { BODY_BYTES_MAX, checked, mediaType, type Answer, type Exchange, type Head } from "./exchange.js";
import { BATCH_MEDIA_TYPE, FrameReader, type Frame } from "./frames.js";
import { Json } from "./json.js";
import { chunkName, type ChunkMesh, type FittedChunk, type Triple } from "./mesh.js";
import { MEDIA_TYPES, batchRequest, chunkRequest, isImmutable, type ChunkOptions, type Request } from "./questions.js";
import { Trial, pause } from "./retry.js";

/** Chunks of one request. */
export const BATCH_CHUNKS_MAX = 1024;

/** How a batch is asked for. */
export interface BatchOptions extends ChunkOptions {
  /** x, y, z in voxels: nearer chunks come first. */
  readonly viewer?: Triple;
  /** Ends the batch: what is on its way is dropped, and the server drops what it has not begun. */
  readonly signal?: AbortSignal;
}

/** One chunk of a batch, and what the cache has of it. */
interface Wanted {
  readonly chunk: FittedChunk;
  readonly request: Request;
  readonly entry: Entry | null;
}

/** One batch under way: at most `BATCH_CHUNKS_MAX` chunks, each once. coding: of each. */
export class Batch {
  private readonly missing = new Map<string, Wanted>();
  private failed: ClientError | null = null;

  constructor(
    private readonly exchange: Exchange,
    private readonly world: AnyWorld,
    private readonly chunks: readonly FittedChunk[],
    private readonly options: BatchOptions,
    private readonly coding: Coding,
  ) {}

  /**
   * Yields the mesh of each chunk as soon as it is there.
   *
   * A chunk that fails for a reason of its own does not stop the others: the first such error is thrown at the end.
   */
  async *meshes(): AsyncGenerator<ChunkMesh, void, undefined> {
    yield* this.fresh();
    const trial = new Trial(this.exchange.retry);
    while (this.missing.size) {
      try {
        yield* this.stream(trial);
      } catch (error) {
        this.options.signal?.throwIfAborted();
        if (error instanceof ClientError && !(error instanceof Unavailable || error instanceof BadAnswer)) {
          throw error;
        }
        if (this.missing.size) {
          await pause(trial.pauseAfter(error), this.options.signal);
        }
      }
    }
    if (this.failed !== null) {
      throw this.failed;
    }
  }

  /**
   * By which the cache knows a chunk. What is asked about each time is as new as the answer says, whatever revision was
   * waited for: without it among the names, a tag is good for more than one edit.
   */
  private get named(): ChunkOptions {
    const { minRevision, ...named } = this.options;
    return named.revision === undefined || minRevision === undefined ? named : this.options;
  }

  /** Yields what the cache has and may use without asking. */
  private async *fresh(): AsyncGenerator<ChunkMesh, void, undefined> {
    const { cache } = this.exchange;
    for (const chunk of this.chunks) {
      const request = chunkRequest(this.world, chunk, { ...this.named, coarser: chunk.coarser });
      const entry = cache.find(request);
      if (entry !== null && cache.isFresh(entry)) {
        this.exchange.traffic.cached += 1;
        yield await meshOf(entry.answer, placeIn(this.world, chunk), chunk.coarser);
      } else {
        this.missing.set(chunkName(chunk), { chunk, request, entry });
      }
    }
  }

  /** Asks once for all that is missing. Returns when nothing is; throws what there is to wait for otherwise. */
  private async *stream(trial: Trial): AsyncGenerator<ChunkMesh, void, undefined> {
    const wanted = [...this.missing.values()];
    const known = wanted.flatMap(({ entry }) => (entry === null ? [] : [entry.tag.replaceAll('"', "")]));
    const chunks = wanted.map(({ chunk }) => chunk);
    const request = batchRequest(this.world, chunks, this.options, this.options.viewer ?? null, known, this.coding);
    const left = new AbortController();
    const { signal = left.signal } = this.options;
    try {
      const head = await this.exchange.open(request, trial, AbortSignal.any([signal, left.signal]));
      if (head.status !== 200 || mediaType(head.headers) !== BATCH_MEDIA_TYPE) {
        checked(await this.exchange.rest(head, trial), 200);
        throw new BadAnswer(`the media type is "${mediaType(head.headers)}": expected ${BATCH_MEDIA_TYPE}`);
      }
      const busy = yield* this.frames(head, wanted, trial);
      if (this.missing.size) {
        throw busy ?? new BadAnswer("the batch is whole, but chunks are missing in it");
      }
    } finally {
      left.abort(); // whoever leaves early leaves the server's queue, too
    }
  }

  /** Takes all frames. Returns the last error after which may be asked again; throws if the stream is cut. */
  private async *frames(
    head: Head,
    wanted: readonly Wanted[],
    trial: Trial,
  ): AsyncGenerator<ChunkMesh, Unavailable | null, undefined> {
    const reader = new FrameReader(BODY_BYTES_MAX);
    let busy: Unavailable | null = null;
    while (!reader.isDone) {
      const piece = await head.read();
      for (const frame of reader.feed(piece ?? new Uint8Array(0))) {
        const one = wanted[frame.index];
        if (one === undefined || !this.missing.has(chunkName(one.chunk))) {
          continue;
        }
        const found = await this.take(frame, one);
        if (found instanceof Unavailable) {
          busy = found;
          continue;
        }
        this.missing.delete(chunkName(one.chunk));
        trial.renew();
        if (found !== null) {
          yield found;
        }
      }
      if (!reader.isDone && (piece === null || trial.secondsLeft < 0)) {
        throw new BadAnswer(piece === null ? "the batch broke off" : "the batch came too slowly");
      }
    }
    await head.read(); // the end of the body: the connection can be used again
    return busy;
  }

  /** What is in a frame: a mesh, the error after which may be asked again, or null for an error that was noted. */
  private async take(frame: Frame, { chunk, request, entry }: Wanted): Promise<ChunkMesh | Unavailable | null> {
    if (frame.status >= 400) {
      const members = Json.parse(new TextDecoder().decode(frame.body)).members();
      const error = problem(frame.status, members);
      if (error instanceof Unavailable) {
        return error;
      }
      this.failed ??= error;
      return null;
    }
    const answer = frame.status === 304 ? confirmed(frame, entry) : this.answer(frame);
    this.exchange.traffic.cached += frame.status === 304 ? 1 : 0;
    const mesh = await meshOf(answer, placeIn(this.world, chunk), chunk.coarser);
    this.exchange.cache.keep(request, answer);
    return mesh;
  }

  /** What a request for this chunk alone would have given. */
  private answer({ status, tag, content, revision, coding, body }: Frame): Answer {
    const headers = new Headers({
      "cache-control": isImmutable(this.world, this.options, revision) ? "max-age=31536000, immutable" : "no-cache",
      "chunk-content": content ?? "",
      "chunk-revision": String(revision),
      "content-type": MEDIA_TYPES[this.options.format ?? "mesh"],
    });
    if (tag) {
      headers.set("etag", `"${tag}"`);
    }
    return { status, headers, content: body, coding };
  }
}

/** @throws {BadAnswer} if the 304 is about something that was not named */
function confirmed(frame: Frame, entry: Entry | null): Answer {
  if (entry === null || entry.tag !== `"${frame.tag}"`) {
    throw new BadAnswer(`a 304 for ${frame.tag}, which was not named`);
  }
  return entry.answer;
}
