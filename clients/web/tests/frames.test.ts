/** docs/wire/batch-v1.md: the example, in pieces of any size; codings; streams that are none. */

import assert from "node:assert/strict";
import { gzipSync } from "node:zlib";
import { test } from "node:test";

import { decoded } from "../src/coding.js";
import { BadAnswer } from "../src/errors.js";
import { FrameReader, type Frame } from "../src/frames.js";
import { bytesOf, hexdump, page } from "./pages.js";

const EXAMPLE = hexdump(page("wire/batch-v1.md"), "batch");

function framesOf(stream: Uint8Array, size: number): { frames: Frame[]; isDone: boolean } {
  const reader = new FrameReader(1 << 20);
  const frames: Frame[] = [];
  for (let start = 0; start < stream.length; start += size) {
    frames.push(...reader.feed(stream.subarray(start, start + size)));
  }
  return { frames, isDone: reader.isDone };
}

for (const size of [1, 7, 16, 1000]) {
  test(`the example in pieces of ${size}`, () => {
    const { frames, isDone } = framesOf(EXAMPLE, size);
    assert.ok(isDone);
    assert.deepEqual(
      frames.map(({ body, ...rest }) => ({ ...rest, body: body.length })),
      [
        {
          index: 0,
          status: 204,
          content: "air",
          coding: "identity",
          revision: 0n,
          tag: "0123456789abcdef0123456789abcdef",
          body: 0,
        },
        {
          index: 1,
          status: 304,
          content: null,
          coding: "identity",
          revision: 0n,
          tag: "fedcba9876543210fedcba9876543210",
          body: 0,
        },
      ],
    );
  });
}

test("a stream that was cut is not done", () => {
  for (let length = 0; length < EXAMPLE.length; length++) {
    assert.equal(framesOf(EXAMPLE.subarray(0, length), 50).isDone, false);
  }
});

test("bodies of any length come whole, each in a buffer of its own", () => {
  const lengths = [1, 15, 16, 17, 5000];
  const stream: number[] = [...EXAMPLE.subarray(0, 16)];
  lengths.forEach((length, index) => {
    const header = new Uint8Array(64);
    new DataView(header.buffer).setUint32(0, length, true);
    new DataView(header.buffer).setUint32(4, index, true);
    stream.push(
      ...header,
      ...Array.from({ length }, () => index + 1),
      ...Array.from({ length: -length & 15 }, () => 0),
    );
  });
  for (const size of [3, 64, 4096, 100_000]) {
    const { frames } = framesOf(Uint8Array.from(stream), size);
    assert.deepEqual(
      frames.map(({ body }) => [body.length, body[0], body.at(-1), body.byteLength === body.buffer.byteLength]),
      lengths.map((length, at) => [length, at + 1, at + 1, true]),
    );
  }
});

for (const [what, offset, value] of [
  ["another magic", 0, 0x42],
  ["another version", 4, 2],
  ["frame headers of 65 bytes", 6, 65],
  ["a coding that is not known", 16 + 11, 3],
  ["a content that is not known", 16 + 10, 4],
  ["a tag that is not visible", 16 + 24, 7],
  ["a count that is wrong", EXAMPLE.length - 64 + 12, 3],
] as const) {
  test(`a stream with ${what} is refused`, () => {
    const stream = EXAMPLE.slice();
    stream[offset] = value;
    assert.throws(() => framesOf(stream, 64), BadAnswer);
  });
}

test("a frame that is too long is refused before it is there", () => {
  const stream = EXAMPLE.slice(0, 80);
  new DataView(stream.buffer).setUint32(16, (1 << 20) + 1, true);
  assert.throws(() => framesOf(stream, 80), /at most 1048576/);
});

/** What zstd's own encoder makes of `TEXT`; it states the size. */
const ZSTD = bytesOf("28b52ffd60b0036d0000306368756e6b200100a7e42f45");
const TEXT = new TextEncoder().encode("chunk ".repeat(200));

test("gzip is undone, and bounded", async () => {
  const body = Uint8Array.from(gzipSync(TEXT));
  assert.deepEqual(await decoded(body, "gzip", TEXT.length), TEXT);
  await assert.rejects(decoded(body, "gzip", TEXT.length - 1), BadAnswer);
  await assert.rejects(decoded(body.slice(0, -9), "gzip", TEXT.length), BadAnswer);
});

test("zstd is undone, and bounded before anything is allocated", async () => {
  assert.deepEqual(await decoded(ZSTD, "zstd", TEXT.length), TEXT);
  await assert.rejects(decoded(ZSTD, "zstd", TEXT.length - 1), /at most 1199/);
  const huge = ZSTD.slice();
  huge[4] = 0xe0; // a size of 8 bytes
  await assert.rejects(decoded(huge, "zstd", 1 << 30), BadAnswer);
});

test("zstd that is cut or mutated is refused, or gives what it states", async () => {
  for (let at = 0; at < ZSTD.length * 8; at++) {
    const mutated = ZSTD.slice();
    mutated[at >> 3]! ^= 1 << (at & 7);
    for (const body of [mutated, ZSTD.slice(0, at >> 3)]) {
      await decoded(body, "zstd", 1 << 12).catch((error) => assert.ok(error instanceof BadAnswer, String(error)));
    }
  }
  await assert.rejects(decoded(ZSTD.slice(0, -8), "zstd", 1 << 12), BadAnswer);
});
