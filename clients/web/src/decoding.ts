/** From an answer's bytes to a mesh: one row a format. */

import { BadChunk } from "./errors.js";
import { decodeGlb } from "./glb.js";
import { decodeNative } from "./native.js";
import type { ChunkMesh } from "./mesh.js";

export const MESH_MEDIA_TYPE = "application/vnd.chunkserver.mesh";
export const GLB_MEDIA_TYPE = "model/gltf-binary";

/** Of one file. The largest that the format can state has 0.5 GiB. */
const CHUNK_BYTES_MAX = 2 ** 30;
/** Of the largest number that a file has. */
const ALIGNMENT = 4;

const DECODERS: Readonly<Record<string, (content: Uint8Array) => ChunkMesh>> = {
  [MESH_MEDIA_TYPE]: decodeNative,
  [GLB_MEDIA_TYPE]: decodeGlb,
};

/**
 * The mesh of a chunk's file, of the native format or GLB, as views into `content`: nothing is copied, unless the file
 * starts at an odd place of its buffer.
 *
 * Every length, offset, type and index is checked, so the arrays can be handed to code that checks nothing.
 *
 * @param content a whole file
 * @param mediaType an answer's `Content-Type`; parameters behind a semicolon are ignored
 * @throws {BadChunk} if the bytes are no chunk, truncated or mutated, and for any other media type; nothing else
 */
export function decode(content: ArrayBuffer | Uint8Array, mediaType: string = MESH_MEDIA_TYPE): ChunkMesh {
  const name = mediaType.split(";", 1)[0]!.trim().toLowerCase();
  const decoder = Object.hasOwn(DECODERS, name) ? DECODERS[name] : undefined;
  if (decoder === undefined) {
    throw new BadChunk(`media type "${name.slice(0, 80)}": there are ${Object.keys(DECODERS).join(", ")}`);
  }
  const bytes = content instanceof Uint8Array ? content : new Uint8Array(content);
  if (bytes.length > CHUNK_BYTES_MAX) {
    throw new BadChunk(`${bytes.length} bytes: at most ${CHUNK_BYTES_MAX}`);
  }
  return decoder(bytes.byteOffset % ALIGNMENT ? bytes.slice() : bytes);
}
