/** A session does and says what the Python client's does, on every recorded history. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { keyName, type ChunkKey } from "../src/mesh.js";
import { RETRY } from "../src/retry.js";
import { Inbox } from "../src/stream/inbox.js";
import { Chunks, type Refresh } from "../src/stream/chunks.js";
import type { Edits } from "../src/stream/messages.js";
import type { Region } from "../src/stream/regions.js";
import { Session, type SessionEvent } from "../src/stream/session.js";
import { given } from "./pages.js";

interface Step {
  readonly do: string;
  readonly state: Record<string, unknown>;
  readonly refused?: true;
  readonly [member: string]: any;
}

type Key = [lod: number, x: number, y: number, z: number];

/** A session with its clock, and what a game holds. */
class Game {
  now = 0;
  readonly session: Session;
  private readonly refreshes: Refresh[] = [];

  constructor(regions: Region[], cells: number) {
    const retry = { ...RETRY, backoffSeconds: 0.5, backoffSecondsMax: 8 };
    this.session = new Session({ client: "me", regions, cells, retry, clock: () => this.now, random: () => 0.5 });
  }

  /** Does a step; returns what came of it, in the words of the record. */
  act(step: Step): Record<string, unknown> {
    const { session } = this;
    switch (step.do) {
      case "connected":
        return (void session.connected(), {});
      case "send":
        return {
          frames: session.outgoing().map((frame) => (typeof frame === "string" ? JSON.parse(frame) : hex(frame))),
        };
      case "hear":
        return { events: session.received(step["text"]).map(told) };
      case "lost":
        return { events: session.lost(step["code"]).map(told) };
      case "edit":
        return {
          seq: session.edit(
            step["strokes"].map((stroke: any) =>
              stroke.values ? { ...stroke, values: Int32Array.from(stroke.values) } : stroke,
            ),
          ),
        };
      case "show":
        return (void session.chunks.add(keyOf(step["key"])), {});
      case "hide":
        return (void session.chunks.remove(keyOf(step["key"])), {});
      case "take": {
        const found = session.chunks
          .take()
          .sort((one, other) => (String(sorted(one)) < String(sorted(other)) ? -1 : 1));
        const wanted: string[] = step["refreshes"].map(([keys]: [Key[]]) => String(keys));
        found.sort((one, other) => wanted.indexOf(String(sorted(one))) - wanted.indexOf(String(sorted(other))));
        this.refreshes.push(...found);
        return { refreshes: found.map((refresh) => [sorted(refresh), String(refresh.revision)]) };
      }
      case "done":
        return (void session.chunks.done(this.refreshes.splice(step["at"], 1)[0]!, BigInt(step["revision"])), {});
      case "failed":
        return (void session.chunks.failed(this.refreshes.splice(step["at"], 1)[0]!), {});
      case "subscribe":
        return (void session.subscribe(step["region"]), {});
      case "unsubscribe":
        return (void session.unsubscribe(step["region"]), {});
      case "wait":
        return (void (this.now += step["seconds"]), {});
      default:
        throw new Error(`a step that is not known: ${step.do}`);
    }
  }

  state(): Record<string, unknown> {
    const { epoch, revision, isLive, isBroken, connectAt, unansweredCount, areRegionsInForce, chunks, regions } =
      this.session;
    return {
      ...{ epoch, revision: String(revision), isLive, isBroken, connectAt, unansweredCount, areRegionsInForce },
      areCurrent: chunks.areCurrent,
      regions: regions.map((region) => JSON.stringify(region)).sort(),
    };
  }
}

function keyOf([lod, x, y, z]: Key): ChunkKey {
  return { lod, x, y, z };
}

function sorted({ keys }: Refresh): Key[] {
  const found = keys.map(({ lod, x, y, z }): Key => [lod, x, y, z]);
  return found.sort((one, other) => one.map((value, at) => value - other[at]!).find(Boolean) ?? 0);
}

function told(event: SessionEvent): unknown {
  const found =
    event.kind === "nack" ? { ...event, problem: event.problem.problem, path: event.problem.values["path"] } : event;
  return JSON.parse(JSON.stringify(found, (_, value) => (typeof value === "bigint" ? String(value) : value)));
}

function hex(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

test("the histories of the Python client", () => {
  const histories: { regions: Region[]; cells: number; steps: Step[] }[] = JSON.parse(
    readFileSync(given("CHUNKSERVER_HISTORIES"), "utf8"),
  );
  const seen = new Map<string, number>();
  const note = (what: string) => seen.set(what, (seen.get(what) ?? 0) + 1);
  for (const { regions, cells, steps } of histories) {
    const game = new Game(regions, cells);
    for (const step of steps) {
      const { do: what, state, refused, ...rest } = step;
      let found: Record<string, unknown> = {};
      try {
        found = game.act(step);
        assert.equal(refused, undefined, "it was refused");
      } catch (error) {
        assert.ok(refused && error instanceof RangeError, String(error));
        note("refused");
      }
      for (const [name, value] of Object.entries(found)) {
        assert.deepEqual(value, rest[name], `${what}: ${name}`);
      }
      const { regions: inForce, ...others } = state as { regions: string[] };
      const { regions: here, ...mine } = game.state() as { regions: string[] };
      assert.deepEqual(mine, others, what);
      assert.deepEqual(
        here.map((each) => JSON.parse(each)),
        inForce.map((each) => JSON.parse(each)),
        what,
      );
      note(what);
      (step["events"] ?? []).forEach(({ kind }: { kind: string }) => note(kind));
      note(state["isBroken"] ? "broken" : "whole");
    }
  }
  const kinds = [
    "welcome",
    "ack",
    "nack",
    "edits",
    "progress",
    "stale",
    "resync",
    "start over",
    "ended",
    "refused",
    "broken",
  ];
  const steps = [
    "connected",
    "send",
    "hear",
    "lost",
    "edit",
    "show",
    "hide",
    "take",
    "done",
    "failed",
    "subscribe",
    "unsubscribe",
    "wait",
  ];
  for (const what of [...kinds, ...steps]) {
    assert.ok((seen.get(what) ?? 0) >= 10, `${what} was seen ${seen.get(what)} times`);
  }
});

test("what a game has not taken yet is bounded; another world is not skipped", () => {
  const edits = (revision: bigint): Edits => ({ kind: "edits", after: revision - 1n, revision, edits: [], stale: [] });
  const [inbox, chunks] = [new Inbox(), new Chunks()];
  const taken = () => Array.from({ length: 2000 }, () => inbox.take(chunks)).filter((event) => event !== null);
  inbox.put({ kind: "start over", epoch: "two", revision: 0n, lost: [] }, 10, 0n);
  for (let revision = 1n; revision <= 1025n; revision++) {
    inbox.put(edits(revision), 10, revision);
  }
  assert.deepEqual(
    taken().map(({ kind }) => kind),
    ["start over", "skipped", "edits"],
  );
  [1n, 2n, 3n].forEach((revision) => inbox.put(edits(revision), 2 ** 19, revision));
  assert.deepEqual(taken(), [{ kind: "skipped", revision: 3n }]);
  chunks.add({ lod: 0, x: 1, y: 2, z: 3 });
  inbox.put(edits(4n), 10, 4n);
  assert.deepEqual(
    taken().map((event) => (event.kind === "refresh" ? event.keys.map(keyName) : event.kind)),
    ["edits", ["0/1/2/3"]],
  );
});

test("too many edits are refused", () => {
  const game = new Game([], 32);
  game.session.connected();
  const limits = { frame_bytes: 65536, inflight: 64, regions: 64 };
  game.session.received(
    JSON.stringify({ type: "welcome", epoch: "one", revision: "0", floor: "0", last_seq: null, limits }),
  );
  for (let count = 0; count < 1024; count++) {
    game.session.edit([{ op: "carve" }]);
  }
  assert.throws(() => game.session.edit([{ op: "carve" }]), /1024 edits wait/);
  const regions = Array.from({ length: 65 }, (_, x): Region => ({ low: [x, 0, 0], high: [x, 0, 0] }));
  assert.throws(() => game.session.subscribe(...regions), /65 regions/);
  assert.deepEqual(game.session.regions, []);
});
