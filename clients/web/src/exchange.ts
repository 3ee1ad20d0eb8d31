/** One request and its whole answer: asked for again while that makes sense, out of the cache where that is right. */

import type { AnswerCache, Entry } from "./cache.js";
import { joined, type Coding } from "./coding.js";
import { BadAnswer, ClientError, Unavailable, problem, type Problem } from "./errors.js";
import { Json } from "./json.js";
import type { Request } from "./questions.js";
import { Trial, giveUp, pause, retryAfter, type Retry } from "./retry.js";

/** Of an answer. A chunk of 64 cells whose every cell is full, in floats, has 36 MB. */
export const BODY_BYTES_MAX = 1 << 26;
const JSON_MEDIA_TYPE = "application/json";
const PROBLEM_MEDIA_TYPE = "application/problem+json";
const SHOWN_CHARACTERS_MAX = 200;
/** With these a server says that it did nothing. A proxy's 502 and 504 leave open what the server behind it did. */
const REFUSED_STATUSES: readonly number[] = [429, 503];

/** A whole answer. coding: of `content`, where the browser has not undone it. */
export interface Answer {
  readonly status: number;
  readonly headers: Headers;
  readonly content: Uint8Array<ArrayBuffer>;
  readonly coding: Coding;
}

/** An answer whose head has come. */
export interface Head {
  readonly status: number;
  readonly headers: Headers;
  /** The next piece of the body; null at its end. Rejects if none comes in time. */
  read(): Promise<Uint8Array | null>;
}

/** What a client has asked and got. */
export interface Traffic {
  readonly requests: number;
  /** Of bodies: chunks of a batch with their coding, all else as the browser hands it over, without. */
  readonly bytes: number;
  /** Answers and chunks that were used as the cache had them, those that a 304 has confirmed included. */
  readonly cached: number;
}

/** How this client asks. */
export class Exchange {
  readonly traffic = { requests: 0, bytes: 0, cached: 0 };

  /**
   * @param url of the server, without a slash at the end
   * @param headers of every request
   * @param readSeconds of the wait for an answer's head, and for each piece of its body
   */
  constructor(
    readonly url: string,
    readonly headers: Readonly<Record<string, string>>,
    readonly retry: Retry,
    readonly cache: AnswerCache,
    readonly readSeconds: number,
    private readonly fetch: typeof globalThis.fetch,
  ) {}

  /**
   * What `parse` makes of the answer.
   *
   * Asked for again after a 429 or 503; and, if the request is repeatable, after a 502 or 504, when the connection was
   * lost, or when `parse` throws `BadAnswer`. What the cache keeps has been parsed once.
   *
   * @throws {Problem} for an answer that is an error, `BadAnswer`, `Unreachable`, and the reason of `signal`
   */
  async ask<Value>(
    request: Request,
    parse: (answer: Answer) => Value | Promise<Value>,
    signal?: AbortSignal,
    retry: Retry = this.retry,
  ): Promise<Value> {
    const trial = new Trial(retry);
    for (;;) {
      const entry = request.cached ? this.cache.find(request) : null;
      if (entry !== null && this.cache.isFresh(entry)) {
        this.traffic.cached += 1;
        return await parse(entry.answer);
      }
      try {
        const answer = await this.answer(request, entry, trial, signal);
        const value = await parse(answer);
        if (request.cached) {
          this.cache.keep(request, answer);
        }
        return value;
      } catch (error) {
        await pause(this.pauseAfter(error, request, trial, signal), signal);
      }
    }
  }

  /** Sends `request`, and waits for the head of its answer; no longer than the trial has left. */
  async open(request: Request, trial: Trial, signal?: AbortSignal, tag?: string): Promise<Head> {
    const controller = new AbortController();
    const within = async <Value>(step: Promise<Value>): Promise<Value> => {
      const seconds = Math.max(0, Math.min(this.readSeconds, trial.secondsLeft));
      const timer = setTimeout(
        () => controller.abort(new Error(`nothing came for ${seconds.toFixed(1)} s`)),
        1000 * seconds,
      );
      try {
        return await step;
      } finally {
        clearTimeout(timer);
      }
    };
    this.traffic.requests += 1;
    const response = await within(
      this.fetch(this.url + request.url, {
        method: request.method,
        headers: { ...this.headers, ...request.headers, ...(tag === undefined ? {} : { "if-none-match": tag }) },
        body: request.body ?? null,
        signal: signal === undefined ? controller.signal : AbortSignal.any([signal, controller.signal]),
      }),
    );
    const reader = response.body?.getReader();
    const read = async () => {
      const piece = reader === undefined ? undefined : (await within(reader.read())).value;
      this.traffic.bytes += piece?.length ?? 0;
      return piece ?? null;
    };
    return { status: response.status, headers: response.headers, read };
  }

  /** Reads the body to its end. @throws {BadAnswer} if it is too long, or comes too slowly */
  async rest(head: Head, trial: Trial): Promise<Answer> {
    const pieces: Uint8Array[] = [];
    let size = 0;
    for (let piece = await head.read(); piece !== null; piece = await head.read()) {
      pieces.push(piece);
      size += piece.length;
      if (size > BODY_BYTES_MAX) {
        throw new BadAnswer(`a body of more than ${BODY_BYTES_MAX} bytes`);
      }
      if (trial.secondsLeft < 0) {
        throw new BadAnswer(`${size} bytes of a body came, and then the time was up`);
      }
    }
    return { status: head.status, headers: head.headers, content: joined(pieces, size), coding: "identity" };
  }

  /** The answer of the server, or what the cache has if the server says that it is still right. */
  private async answer(request: Request, entry: Entry | null, trial: Trial, signal?: AbortSignal): Promise<Answer> {
    const answer = await this.rest(await this.open(request, trial, signal, entry?.tag), trial);
    if (entry === null || answer.status !== 304) {
      return answer;
    }
    this.traffic.cached += 1;
    return confirmed(entry, answer);
  }

  private pauseAfter(error: unknown, request: Request, trial: Trial, signal?: AbortSignal): number {
    signal?.throwIfAborted();
    if (error instanceof Unavailable) {
      if (!request.repeatable && !REFUSED_STATUSES.includes(error.status)) {
        throw error;
      }
    } else if (error instanceof BadAnswer) {
      this.cache.drop(request);
    } else if (error instanceof ClientError) {
      throw error;
    }
    if (!request.repeatable && !(error instanceof Unavailable)) {
      giveUp(error);
    }
    return trial.pauseAfter(error);
  }
}

/** What the cache has, which a 304 says is right. @throws {BadAnswer} if the 304 is about something else */
function confirmed(entry: Entry, answer: Answer): Answer {
  if (answer.headers.get("etag") !== entry.tag) {
    throw new BadAnswer(`a 304 for ${answer.headers.get("etag")}: asked for ${entry.tag}`);
  }
  const headers = new Headers(entry.answer.headers);
  headers.set("cache-control", answer.headers.get("cache-control") ?? headers.get("cache-control") ?? "");
  return { ...entry.answer, headers };
}

/** `answer`, if its status is one of `statuses`. @throws {Problem} for an error, `BadAnswer` for all else */
export function checked(answer: Answer, ...statuses: number[]): Answer {
  if (statuses.includes(answer.status)) {
    return answer;
  }
  if (answer.status < 400) {
    throw new BadAnswer(`the status is ${answer.status}: expected ${statuses.join(", ")}`);
  }
  throw refusal(answer);
}

/** The `Problem` that an answer is; what is no problem+json, a proxy's page say, becomes its `detail`. */
export function refusal({ status, headers, content }: Pick<Answer, "status" | "headers" | "content">): Problem {
  const text = new TextDecoder().decode(content);
  let members: Readonly<Record<string, unknown>> = {
    title: "no problem+json",
    detail: text.slice(0, SHOWN_CHARACTERS_MAX),
  };
  if (mediaType(headers) === PROBLEM_MEDIA_TYPE) {
    try {
      members = Json.parse(text).members();
    } catch {
      // then the text is all there is
    }
  }
  return problem(status, members, retryAfter(headers));
}

/** The JSON of an answer. @throws {BadAnswer} if it has another type */
export function jsonOf({ headers, content }: Answer): Json {
  if (mediaType(headers) !== JSON_MEDIA_TYPE) {
    throw new BadAnswer(`the media type is "${mediaType(headers)}": expected ${JSON_MEDIA_TYPE}`);
  }
  return Json.parse(new TextDecoder().decode(content));
}

/** The media type in lower case, without parameters; "" if it is not told. */
export function mediaType(headers: Headers): string {
  return (headers.get("content-type") ?? "").split(";", 1)[0]!.trim().toLowerCase();
}
