/**
 * Everything that can go wrong, drawn before any code.
 *
 *     ClientError
 *     |-- BadAnswer            what came is not what docs/wire and docs/api.md say
 *     |   `-- BadChunk         bytes that are no chunk: truncated, mutated, of another version
 *     |-- Unreachable          no whole answer came, however often it was asked for
 *     |-- WorkerFailed         the worker of a `WorkerClient` is of no use any more
 *     |-- StreamEnded          a stream of edits is over, and why
 *     |-- EditLost             nobody answers this edit of a stream any more
 *     `-- Problem              the server says no, and why
 *         |-- BadRequest       400, 413, 415, 422: asked for in the wrong way
 *         |-- NotAllowed       401, 403: an API key is missing, unknown, or too weak
 *         |-- NotFound         404
 *         |-- Conflict         409
 *         |-- Gone             410: the generator or the epoch has changed; read the descriptor again
 *         `-- Unavailable      429, 502, 503, 504: not now; it was asked for again until the time was up
 *
 * What is called in the wrong way is a `RangeError` or a `TypeError`; what the caller has aborted, the signal's reason.
 */

export const PROBLEM_PREFIX = "urn:chunkserver:problem:";

/** Whatever this package throws on purpose. */
export class ClientError extends Error {
  constructor(message: string, options?: ErrorOptions) {
    super(message, options);
    this.name = new.target.name;
  }
}

/** What came is not what the documents say. The message names the place and the value. */
export class BadAnswer extends ClientError {}

/** Bytes that are no chunk. */
export class BadChunk extends BadAnswer {}

/** No whole answer came. `cause` is the last error of the connection. */
export class Unreachable extends ClientError {}

/** The worker could not be loaded, or has died. All calls of its client fail; another client may do better. */
export class WorkerFailed extends ClientError {}

const ENDS: Readonly<Record<number, string>> = {
  1009: "a frame was too large",
  1011: "this side has failed",
  4400: "a message was malformed",
  4401: "the API key is missing, unknown, or not good any more",
  4403: "this may not be done from here, or with this API key",
  4404: "the world is gone",
  4409: "another connection of the same name has come, or another generator has created the world",
  4412: "a message came out of order",
  4422: "the server does not speak this version of the protocol",
};

/** A stream of edits is over, and another connection would end in the same way. */
export class StreamEnded extends ClientError {
  /**
   * @param code as docs/wire/edit_v1.md has it; 4000 + the status if the server did not take the connection at all:
   *     then `cause` is the `Problem`
   */
  constructor(
    readonly code: number,
    options?: ErrorOptions,
  ) {
    super(`the stream has ended with ${code}: ${ENDS[code] ?? "this side has closed it"}`, options);
  }
}

/** Nobody answers this edit any more: the stream has ended, or the world has begun anew. It may be written or not. */
export class EditLost extends ClientError {
  constructor(
    readonly seq: number,
    why: string,
  ) {
    super(`edit ${seq} was not answered: ${why}`);
  }
}

/** An answer that is an error: RFC 9457's members, and the offending values. */
export class Problem extends ClientError {
  /** "about:blank" where it has none. */
  readonly type: string;
  readonly title: string;
  readonly detail: string;
  readonly instance: string;
  /** The problem's further members, under the names of their parameters. */
  readonly values: Readonly<Record<string, unknown>>;

  /**
   * @param status of HTTP
   * @param members of the problem
   * @param retryAfter seconds that the server asks to wait; 0 if it does not
   */
  constructor(
    readonly status: number,
    readonly members: Readonly<Record<string, unknown>>,
    readonly retryAfter = 0,
  ) {
    const { type, title, detail, instance, status: _, ...values } = members;
    super(`${status} ${text(title)}: ${text(detail)}`);
    this.type = text(type) || "about:blank";
    this.title = text(title);
    this.detail = text(detail);
    this.instance = text(instance);
    this.values = values;
  }

  /** The short name of docs/api.md's table: `bad-key`. Of a problem that is not chunkserver's, the whole type. */
  get problem(): string {
    return this.type.startsWith(PROBLEM_PREFIX) ? this.type.slice(PROBLEM_PREFIX.length) : this.type;
  }
}

/** Asked for in the wrong way: `values` has what is wrong. */
export class BadRequest extends Problem {}

/** An API key is missing, unknown, or has too small a scope. */
export class NotAllowed extends Problem {}

/** No such world, recipe, revision or path. */
export class NotFound extends Problem {}

/** A world with other content has this id, or another generator has created it. */
export class Conflict extends Problem {}

/** The descriptor is out of date: the generator or the epoch has changed. */
export class Gone extends Problem {}

/** Not now, and not later either within the time that `Retry` gives. */
export class Unavailable extends Problem {}

const BY_STATUS: Readonly<Record<number, typeof Problem>> = {
  ...Object.fromEntries([400, 413, 415, 422].map((status) => [status, BadRequest])),
  ...Object.fromEntries([401, 403].map((status) => [status, NotAllowed])),
  404: NotFound,
  409: Conflict,
  410: Gone,
  ...Object.fromEntries([429, 502, 503, 504].map((status) => [status, Unavailable])),
};

/** The `Problem` for an answer: the class that its status has, with what its body says. */
export function problem(status: number, members: Readonly<Record<string, unknown>>, retryAfter = 0): Problem {
  return new (BY_STATUS[status] ?? Problem)(status, members, retryAfter);
}

function text(value: unknown): string {
  return typeof value === "string" ? value : value === undefined || value === null ? "" : String(value);
}
