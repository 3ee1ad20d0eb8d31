/** What is drawn: how fine, how far, and where the ground nearest to the viewer is. */

import { ChunkObject } from "chunkserver-client/three";
import { Vector3, type Object3D, type Scene } from "three";

/** Of all chunks in a scene; lengths in metres. */
export interface Survey {
  readonly chunks: readonly ChunkObject[];
  /** The finest level that is drawn. */
  readonly lod: number;
  /** The point of the nearest chunk's box that is nearest to the viewer. */
  readonly nearest: Vector3;
  /** How far the middle of the furthest chunk is. */
  readonly reach: number;
}

/** All chunks of a scene, whatever they are in. */
export function chunksOf(scene: Scene): ChunkObject[] {
  const found: ChunkObject[] = [];
  const visit = (object: Object3D) => {
    if (object instanceof ChunkObject) {
      found.push(object);
    } else {
      object.children.forEach(visit);
    }
  };
  visit(scene);
  return found;
}

/** @returns null if nothing is drawn */
export function surveyOf(chunks: readonly ChunkObject[], viewer: Vector3): Survey | null {
  let lod = Infinity;
  let least = Infinity;
  let most = 0;
  let group: Object3D | null = null;
  let scale = 1;
  const nearest = new Vector3();
  const at = viewer.clone();
  const point = new Vector3();
  for (const chunk of chunks) {
    const box = chunk.geometry.boundingBox;
    if (box === null) {
      continue;
    }
    if (chunk.parent !== group) {
      group = chunk.parent;
      scale = chunk.matrixWorld.getMaxScaleOnAxis();
      at.copy(viewer).divideScalar(scale);
    }
    const distance = box.clampPoint(at, point).distanceToSquared(at) * scale * scale;
    if (distance < least) {
      least = distance;
      nearest.copy(point).multiplyScalar(scale);
    }
    lod = Math.min(lod, chunk.chunk.key.lod);
    most = Math.max(most, box.getCenter(point).distanceToSquared(at) * scale * scale);
  }
  return lod === Infinity ? null : { chunks, lod, nearest, reach: Math.sqrt(most) };
}

/** Changes whenever chunks come or go: what goes is replaced by what comes last. */
export function signatureOf(scene: Scene): number {
  let [count, last] = [0, 0];
  for (const child of scene.children) {
    count += child.children.length;
    last += child.children.at(-1)?.id ?? 0;
  }
  return count * 2 ** 24 + last;
}
