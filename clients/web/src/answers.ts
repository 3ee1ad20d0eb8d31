/** From the answer to a request for a chunk to its mesh. */

import { decoded } from "./coding.js";
import { decode } from "./decoding.js";
import type { ChunkHead } from "./descriptors.js";
import { BadAnswer, BadChunk } from "./errors.js";
import { BODY_BYTES_MAX, checked, type Answer } from "./exchange.js";
import { REVISION_MAX, emptyMesh, keyName, type ChunkMesh, type Place } from "./mesh.js";

const NUMBER = /^[0-9]{1,19}$/;

/**
 * The mesh of an answer, in a buffer that nobody else has; a 204 is an empty one.
 *
 * @param coarser the mask that was asked for
 * @throws {Problem} and `BadAnswer`, also for another chunk's
 */
export async function meshOf(answer: Answer, place: Place, coarser: number): Promise<ChunkMesh> {
  if (checked(answer, 200, 204).status === 204) {
    const content = answer.headers.get("chunk-content");
    if (content !== "air" && content !== "rock") {
      throw new BadAnswer(`an empty chunk is "${content}": air or rock`);
    }
    return emptyMesh(place, {
      content,
      revision: numberOf(answer.headers, "chunk-revision"),
      coarser,
      geometricError: null,
    });
  }
  const bytes =
    answer.coding === "identity"
      ? answer.content.slice()
      : await decoded(answer.content, answer.coding, BODY_BYTES_MAX);
  const mesh = decode(bytes, answer.headers.get("content-type") ?? "");
  const isAsked =
    keyName(mesh.key) === keyName(place.key) && mesh.cells === place.cells && mesh.voxelSize === place.voxelSize;
  if (!isAsked || mesh.coarser !== coarser) {
    throw new BadChunk(
      `it is ${keyName(mesh.key)} with mask ${mesh.coarser}: asked for was ${keyName(place.key)} with ${coarser}`,
    );
  }
  return mesh;
}

/** What an answer to HEAD says. */
export function headOfChunk(answer: Answer): ChunkHead {
  const { headers } = checked(answer, 200, 204);
  return {
    etag: (headers.get("etag") ?? "").replaceAll('"', ""),
    content: headers.get("chunk-content") ?? "",
    revision: numberOf(headers, "chunk-revision"),
  };
}

/** The number that a header has; 0 if it is not there. @throws {BadAnswer} for what is no number */
export function numberOf(headers: Headers, name: string): bigint {
  const text = headers.get(name) ?? "0";
  const value = NUMBER.test(text) ? BigInt(text) : null;
  if (value === null || value > REVISION_MAX) {
    throw new BadAnswer(`${name} is "${text.slice(0, 20)}": a number below 2^63`);
  }
  return value;
}
