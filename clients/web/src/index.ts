/**
 * Client of chunkserver for browsers and Node.js: the mesh of any chunk, as typed arrays.
 *
 *     const client = new Client("http://127.0.0.1:8000");
 *     const mesh = await client.chunk(await client.seed(42), { lod: 0, x: 0, y: -1, z: 0 });
 */

export type { BatchOptions } from "./batch.js";
export { Client, type CallOptions, type ClientOptions, type ListOptions, type WorldOptions } from "./client.js";
export type { Coding } from "./coding.js";
export { GLB_MEDIA_TYPE, MESH_MEDIA_TYPE, decode } from "./decoding.js";
export {
  placeIn,
  type AnyWorld,
  type ChunkHead,
  type Descriptor,
  type ListedWorld,
  type Recipe,
  type SeedDescriptor,
  type WorldDescriptor,
} from "./descriptors.js";
export { EditStream, type StreamClient, type StreamOptions } from "./edit_stream.js";
export { isStale, type ChunkRange, type LoggedEdit, type Stroke, type WrittenEdit } from "./edits.js";
export {
  BadAnswer,
  BadChunk,
  BadRequest,
  ClientError,
  Conflict,
  EditLost,
  Gone,
  NotAllowed,
  NotFound,
  Problem,
  StreamEnded,
  Unavailable,
  Unreachable,
  WorkerFailed,
} from "./errors.js";
export type { Traffic } from "./exchange.js";
export { LevelOfDetail, type ChunkSet, type Selection, type ViewOptions } from "./levels.js";
export type { Box } from "./marks.js";
export {
  chunkName,
  cornerOf,
  keyName,
  latticePositions,
  positionsInMetres,
  sideOf,
  unitOf,
  type ChunkKey,
  type ChunkMesh,
  type Content,
  type FittedChunk,
  type Place,
  type Profile,
  type Triple,
} from "./mesh.js";
export type { ChunkOptions, RecipeTree } from "./questions.js";
export type { Retry } from "./retry.js";
export { redraws, swaps, swapsInParts, type Swap } from "./swaps.js";
export { WorkerClient, type ChunkClient } from "./worker_client.js";
export type { Refresh } from "./stream/chunks.js";
export type { Skipped, StreamEvent } from "./stream/inbox.js";
export type { Ack, Edit, Edits, Nack, Progress, Resync, Stale } from "./stream/messages.js";
export type { Region } from "./stream/regions.js";
export type { StartOver } from "./stream/session.js";
