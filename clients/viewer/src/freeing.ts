/** Memory that is given back at once: that of chunks comes and goes by tens of megabytes a second. */

import type { ChunkMesh } from "chunkserver-client";

/** What newer browsers' buffers can do. */
type Transferable = ArrayBufferLike & { transfer?(byteLength: number): unknown };

/**
 * Frees the arrays of a mesh that nobody will read any more; they are empty from then on.
 *
 * A browser's own collection begins whenever so many bytes of buffers have come, needed or not, and takes milliseconds.
 * Without buffers that can be transferred it is as it was.
 */
export function free({ positions, normals, indices }: ChunkMesh): void {
  for (const { buffer } of [positions, normals, indices]) {
    if (buffer.byteLength > 0) {
      (buffer as Transferable).transfer?.(0);
    }
  }
}
