/** Content codings of the frames of a batch. Those of other answers are the browser's matter. */

import { decompress } from "fzstd";

import { BadAnswer } from "./errors.js";

export type Coding = "identity" | "gzip" | "zstd";

/** In the order of their numbers in a frame. */
export const CODINGS: readonly Coding[] = ["identity", "gzip", "zstd"];

const ZSTD_MAGIC = 0xfd2fb528;
/** Magic, descriptor, window, dictionary, content size. */
const ZSTD_HEADER_BYTES_MAX = 18;

/**
 * `body` without its coding; a body without any is returned as it is.
 *
 * @throws {BadAnswer} if the coding is broken, cut, or gives more than `bytesMax`.
 */
export async function decoded(
  body: Uint8Array<ArrayBuffer>,
  coding: Coding,
  bytesMax: number,
): Promise<Uint8Array<ArrayBuffer>> {
  try {
    switch (coding) {
      case "identity":
        return body;
      case "gzip":
        return await unzipped(body, bytesMax);
      case "zstd": {
        const content = new Uint8Array(zstdContentBytes(body, bytesMax));
        // fzstd does not say when there is less than a frame states: then zeros follow, which the format's checks see.
        decompress(body, content);
        return content;
      }
    }
  } catch (error) {
    throw error instanceof BadAnswer ? error : new BadAnswer(`${coding}: ${String(error).slice(0, 80)}`);
  }
}

async function unzipped(body: Uint8Array<ArrayBuffer>, bytesMax: number): Promise<Uint8Array<ArrayBuffer>> {
  const pieces: Uint8Array[] = [];
  let size = 0;
  const reader = new Blob([body]).stream().pipeThrough(new DecompressionStream("gzip")).getReader();
  for (let step = await reader.read(); !step.done; step = await reader.read()) {
    pieces.push(step.value);
    size += step.value.length;
    if (size > bytesMax) {
      void reader.cancel();
      throw new BadAnswer(`gzip: more than ${bytesMax} bytes`);
    }
  }
  return joined(pieces, size);
}

/** How long the one frame of zstd says that its content is: RFC 8878, 3.1.1.1. A frame that does not say is refused. */
function zstdContentBytes(body: Uint8Array<ArrayBuffer>, bytesMax: number): number {
  const head = new Uint8Array(ZSTD_HEADER_BYTES_MAX);
  head.set(body.subarray(0, ZSTD_HEADER_BYTES_MAX));
  const view = new DataView(head.buffer);
  const descriptor = head[4]!;
  const isSingleSegment = (descriptor >> 5) & 1;
  const at = 5 + (isSingleSegment ? 0 : 1) + [0, 1, 2, 4][descriptor & 3]!;
  const sizes = [
    () => (isSingleSegment ? view.getUint8(at) : Infinity),
    () => view.getUint16(at, true) + 256,
    () => view.getUint32(at, true),
    () => Number(view.getBigUint64(at, true)),
  ];
  const size = sizes[descriptor >> 6]!();
  if (view.getUint32(0, true) !== ZSTD_MAGIC || size > bytesMax) {
    throw new BadAnswer(`zstd: no frame of at most ${bytesMax} bytes that states its size`);
  }
  return size;
}

/** The pieces one after the other, in a buffer of their own. size: of all of them. */
export function joined(pieces: readonly Uint8Array[], size: number): Uint8Array<ArrayBuffer> {
  const whole = new Uint8Array(size);
  let at = 0;
  for (const piece of pieces) {
    whole.set(piece, at);
    at += piece.length;
  }
  return whole;
}
