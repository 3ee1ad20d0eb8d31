/**
 * A client on the other side of a port: what is said over it, and the side that has the client.
 *
 *     page: make, then for each call its name and arguments      worker: the value, or items and an end, or an error
 */

import { Client, type ClientOptions } from "./client.js";
import { BadAnswer, BadChunk, ClientError, Problem, Unreachable, problem } from "./errors.js";
import type { ChunkMesh } from "./mesh.js";

/** What both a worker and the end of a `MessageChannel` are. */
export interface Port {
  postMessage(message: unknown, transfer: Transferable[]): void;
  /** `error` and `messageerror` are of a worker that has failed. */
  addEventListener(type: "message" | "error" | "messageerror", listener: (event: MessageEvent) => void): void;
}

/** Items that are sent before the other side has said that it took one. */
export const ITEMS_AHEAD = 64;

/** Milliseconds for which an item waits for others, a frame; the last one of a call waits for nobody. */
const ITEMS_MS = 16;

/** What can be called. */
export type CallName = Exclude<keyof Client, "url">;

/** What the page says. */
export type Asked =
  | { readonly make: readonly [url: string, options: ClientOptions] }
  | { readonly id: number; readonly call: CallName; readonly args: readonly unknown[] }
  | { readonly id: number; readonly taken: number }
  | { readonly id: number; readonly cancel: true };

/** What the worker says. `end` comes behind the last item. */
export type Told =
  | { readonly id: number; readonly value: unknown }
  | { readonly id: number; readonly items: readonly unknown[] }
  | { readonly id: number; readonly end: true }
  | { readonly id: number; readonly error: unknown };

/** A call under way. */
interface Call {
  readonly cancel: AbortController;
  /** Items that may still be sent. */
  room: number;
  /** Called when there is room again. */
  wake: () => void;
}

/** Makes the client that the page asks for, and answers its calls. */
export function serve(port: Port): void {
  const calls = new Map<number, Call>();
  let client: Client | null = null;
  port.addEventListener("message", ({ data }) => {
    const asked = data as Asked;
    if ("make" in asked) {
      client = new Client(...asked.make);
    } else if ("call" in asked && client !== null) {
      const call: Call = { cancel: new AbortController(), room: ITEMS_AHEAD, wake: () => {} };
      calls.set(asked.id, call);
      void answer(port, client, asked, call).finally(() => calls.delete(asked.id));
    } else if ("taken" in asked) {
      const call = calls.get(asked.id);
      if (call !== undefined) {
        call.room += asked.taken;
        call.wake();
      }
    } else if ("cancel" in asked) {
      const call = calls.get(asked.id);
      call?.cancel.abort();
      call?.wake();
    }
  });
}

async function answer(
  port: Port,
  client: Client,
  { id, call: name, args }: Extract<Asked, { args: unknown }>,
  call: Call,
): Promise<void> {
  const tell = (told: Told, transfer: Transferable[] = []) => port.postMessage(told, transfer);
  const { signal } = call.cancel;
  const group = new Group((items) => tell({ id, items }, items.flatMap(buffersOf)));
  try {
    const options = { ...(args.at(-1) as object), signal };
    const method = client[name] as (...args: unknown[]) => unknown;
    const found = method.apply(client, [...args.slice(0, -1), options]);
    if (isAsyncIterable(found)) {
      for await (const item of found) {
        while (call.room === 0 && !signal.aborted) {
          await new Promise<void>((resolve) => (call.wake = resolve));
        }
        if (signal.aborted) {
          return;
        }
        call.room -= 1;
        group.add(item);
      }
      group.send();
      tell({ id, end: true });
    } else {
      const value = await found;
      tell({ id, value }, buffersOf(value));
    }
  } catch (error) {
    group.send();
    tell({ id, error: packed(error) });
  } finally {
    group.drop();
  }
}

/** Items that go over in one message. */
class Group {
  private items: unknown[] = [];
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly tell: (items: readonly unknown[]) => void) {}

  add(item: unknown): void {
    this.items.push(item);
    this.timer ??= setTimeout(() => this.send(), ITEMS_MS);
  }

  send(): void {
    const { items } = this;
    this.drop();
    if (items.length > 0) {
      this.tell(items);
    }
  }

  drop(): void {
    clearTimeout(this.timer);
    this.timer = undefined;
    this.items = [];
  }
}

/** The buffers of a mesh go over, they are not copied. */
function buffersOf(value: unknown): ArrayBuffer[] {
  const { positions, normals, indices } = (value ?? {}) as Partial<ChunkMesh>;
  const buffers = [positions, normals, indices].flatMap((array) =>
    array?.byteLength ? [array.buffer as ArrayBuffer] : [],
  );
  return [...new Set(buffers)];
}

function isAsyncIterable(value: unknown): value is AsyncIterable<unknown> {
  return typeof value === "object" && value !== null && Symbol.asyncIterator in value;
}

const KINDS = { BadAnswer, BadChunk, Unreachable, ClientError } as const;

/** An error as a port can carry it: of this package's own only members, for a port drops what a class adds. */
interface Packed {
  readonly packed: keyof typeof KINDS | "Problem";
  readonly message: string;
  readonly status: number;
  readonly members: Readonly<Record<string, unknown>>;
  readonly retryAfter: number;
}

function packed(error: unknown): unknown {
  if (error instanceof Problem) {
    const { status, members, retryAfter, message } = error;
    return { packed: "Problem", message, status, members, retryAfter } satisfies Packed;
  }
  if (error instanceof ClientError) {
    const names = Object.keys(KINDS) as (keyof typeof KINDS)[];
    const name = names.find((each) => error.constructor === KINDS[each]) ?? "ClientError";
    return { packed: name, message: error.message, status: 0, members: {}, retryAfter: 0 } satisfies Packed;
  }
  return error instanceof RangeError || error instanceof DOMException ? error : new Error(String(error));
}

/** The error that `packed` has made fit for a port. */
export function unpacked(error: unknown): unknown {
  if (typeof error !== "object" || error === null || !("packed" in error)) {
    return error;
  }
  const { packed: name, message, status, members, retryAfter } = error as Packed;
  return name === "Problem" ? problem(status, members, retryAfter) : new KINDS[name](message);
}
