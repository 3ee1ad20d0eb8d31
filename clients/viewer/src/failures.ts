/**
 * What becomes of everything that can go wrong: one table, which clients/web/src/errors.ts has the errors of.
 *
 *     wait     the server is away or has too much to do: until it says that it is ready
 *     retry    once more after a pause, which grows: it may pass
 *     reopen   the world is not what it was: it is shown as it is now
 *     key      somebody has to enter an API key
 *     stop     nothing helps but another world, or to load the page anew
 */

import {
  BadAnswer,
  BadRequest,
  ClientError,
  Conflict,
  Gone,
  NotAllowed,
  NotFound,
  Problem,
  StreamEnded,
  Unavailable,
  Unreachable,
  WorkerFailed,
} from "chunkserver-client";

export type Remedy = "wait" | "retry" | "reopen" | "key" | "stop";

/** What is done, and what people are told meanwhile. */
export interface Verdict {
  readonly remedy: Remedy;
  readonly message: string;
}

interface Row<Kind extends Error = Error> {
  isIt(error: unknown): error is Kind;
  /** Of a world that is shown. */
  readonly remedy: Remedy;
  /** Of one that is to be opened. */
  readonly opening: Remedy;
  says(error: Kind): string;
}

/** Ends of a stream that another one would have too. */
const KEEPS_OUT: readonly number[] = [4401, 4403];
const IS_OVER = 4404;
const AGAIN = "It is tried again by itself.";
const GOES_ON = "This page goes on by itself.";

/** The first row that fits counts. */
const TABLE: readonly Row[] = [
  row(WorkerFailed, "stop", "stop", ({ message }) => `Reload the page: ${message}.`),
  row(Unreachable, "wait", "wait", () => "The server is away. This page goes on when it is back."),
  row(Unavailable, "wait", "wait", busy),
  row(NotAllowed, "key", "key", ({ detail }) => detail),
  ended((code) => KEEPS_OUT.includes(code), "key"),
  row(Gone, "reopen", "retry", () => "The world has changed: it is opened anew."),
  { isIt: isForeign, remedy: "retry", opening: "retry", says: () => `The server is not where it was. ${AGAIN}` },
  row(NotFound, "reopen", "stop", ({ message }) => message),
  ended((code) => code === IS_OVER, "reopen"),
  row(Conflict, "retry", "stop", ({ message }) => message),
  row(BadRequest, "retry", "stop", ({ message }) => message),
  row(BadAnswer, "retry", "retry", ({ message }) => `What came is not what was asked for: ${message}. ${AGAIN}`),
  row(Problem, "retry", "retry", ({ message }) => `${message}. ${AGAIN}`),
  row(ClientError, "retry", "retry", ({ message }) => `${message}. ${AGAIN}`),
  row(Error, "stop", "stop", (error) => `This page has a fault: ${String(error)}. Reload it.`),
];

/** isOpening: whether the world is not shown yet */
export function verdictOn(error: unknown, isOpening = false): Verdict {
  const root = rootOf(error);
  const found = TABLE.find(({ isIt }) => isIt(root)) ?? TABLE.at(-1)!;
  return { remedy: isOpening ? found.opening : found.remedy, message: found.says(root as Error) };
}

/** Whether it is not known if the server did what it was asked to do, or it says that it did not and may be asked again. */
export function isOpen(error: unknown): boolean {
  const isFull = error instanceof Problem && error.status === 507;
  const isServers = error instanceof Problem && error.status >= 500 && !isFull;
  return error instanceof Unreachable || error instanceof BadAnswer || error instanceof Unavailable || isServers;
}

/** The server gives its problems a type: this one is of a proxy's, which does not know the server for now. */
function isForeign(error: unknown): error is NotFound {
  return error instanceof NotFound && error.type === "about:blank";
}

/** A stream that the server did not take ends with the problem that it was answered with. */
function rootOf(error: unknown): unknown {
  return error instanceof StreamEnded && error.cause instanceof Problem ? error.cause : error;
}

function busy({ problem, status, detail }: Unavailable): string {
  switch (problem) {
    case "unavailable":
      return detail.includes("stopping") ? `The server is stopping. ${GOES_ON}` : `The server is starting. ${GOES_ON}`;
    case "deadline-passed":
      return `The server takes too long. ${GOES_ON}`;
    case "worker-lost":
      return `The server has failed to build what is here. ${AGAIN}`;
    default:
      return status === 502 || status === 504
        ? `The server cannot be reached from where this page comes from. ${GOES_ON}`
        : `The server has too much to do. ${GOES_ON}`;
  }
}

function row<Kind extends Error>(
  kind: abstract new (...args: never[]) => Kind,
  remedy: Remedy,
  opening: Remedy,
  says: (error: Kind) => string,
): Row {
  return { isIt: (error): error is Kind => error instanceof kind, remedy, opening, says: says as Row["says"] };
}

function ended(has: (code: number) => boolean, remedy: Remedy): Row {
  const isIt = (error: unknown): error is StreamEnded => error instanceof StreamEnded && has(error.code);
  return { isIt, remedy, opening: remedy, says: ({ message }) => message };
}
