/** What is asked, as requests: which path, which query, which headers and body. docs/api.md has the words. */

import type { Coding } from "./coding.js";
import { GLB_MEDIA_TYPE, MESH_MEDIA_TYPE } from "./decoding.js";
import { pathOf, type AnyWorld, type WorldDescriptor } from "./descriptors.js";
import { base64Of, type Stroke } from "./edits.js";
import { BATCH_MEDIA_TYPE } from "./frames.js";
import { keyName, type ChunkKey, type FittedChunk, type Profile, type Triple } from "./mesh.js";

/** An expression tree, a number, or a built-in recipe with parameters: `{ builtin: "planet", radius: 500 }`. */
export type RecipeTree = Readonly<Record<string, unknown>> | number;

/** How a chunk is asked for. What is left out is the server's default. */
export interface ChunkOptions {
  /** "mesh", the native format (default), or "glb". */
  readonly format?: "mesh" | "glb";
  /** Of the native format. */
  readonly profile?: Profile;
  /** Of GLB. It only changes the node; the mesh that is decoded is the same. */
  readonly frame?: "world" | "chunk";
  /** The surface extractor; the descriptor names those that are built. */
  readonly mesher?: string;
  /** How borders between levels are closed: "transitions" (default), "skirts" or "none". */
  readonly seam?: string;
  /** Mask of the faces whose neighbour is one LOD coarser: -x 1, +x 2, -y 4, +y 8, -z 16, +z 32. */
  readonly coarser?: number;
  /** Of a world: wait until it has this revision. */
  readonly minRevision?: bigint;
  /**
   * Of a world: one that the caller knows, `world.revision` say. A chunk that had not been edited since is then used
   * from the cache without asking, also later.
   */
  readonly revision?: bigint;
  /** 0 (first) to 7; 3 when left out. Who comes first while requests wait. */
  readonly urgency?: number;
}

/** One request to the server. */
export interface Request {
  readonly method: "GET" | "HEAD" | "POST" | "DELETE";
  /** Path and query. */
  readonly url: string;
  readonly headers: Readonly<Record<string, string>>;
  readonly body?: string;
  /** Whether the same once more changes nothing. */
  readonly repeatable: boolean;
  /** Whether its answer is kept. */
  readonly cached: boolean;
}

export const MEDIA_TYPES = { mesh: MESH_MEDIA_TYPE, glb: GLB_MEDIA_TYPE } as const;

const JSON_MEDIA_TYPE = "application/json";
/** Of an edit's key that nobody has chosen. */
const KEY_BYTES = 16;
const EDIT_KEY = /^[!-~]{1,128}$/;

/** The chunk of a batch; without a mask of its own it has that of the options. */
export function fitted(chunk: ChunkKey & { readonly coarser?: number }, options: ChunkOptions): FittedChunk {
  const { lod, x, y, z, coarser = options.coarser ?? 0 } = chunk;
  return { lod, x, y, z, coarser };
}

export function chunkRequest(
  world: AnyWorld,
  key: ChunkKey,
  options: ChunkOptions,
  method: "GET" | "HEAD" = "GET",
): Request {
  const format = options.format ?? "mesh";
  const url = `${pathOf(world)}/chunks/${keyName(key)}.${format}${query(world, options)}`;
  return {
    method,
    url,
    headers: { accept: MEDIA_TYPES[format], ...priority(options) },
    repeatable: true,
    cached: method === "GET",
  };
}

/** @param known entity tags, without quotes */
export function batchRequest(
  world: AnyWorld,
  chunks: Iterable<FittedChunk>,
  options: ChunkOptions,
  viewer: Triple | null,
  known: readonly string[],
  coding: Coding,
): Request {
  const rows = Array.from(chunks, ({ lod, x, y, z, coarser }) => (coarser ? [lod, x, y, z, coarser] : [lod, x, y, z]));
  const body = {
    chunks: rows,
    format: options.format ?? "mesh",
    coding,
    ...(viewer === null ? {} : { viewer }),
    ...(known.length ? { known } : {}),
  };
  const url = `${pathOf(world)}/chunks${query(world, { ...options, coarser: 0 })}`; // each row has its own
  return posted(url, body, { accept: BATCH_MEDIA_TYPE, ...priority(options) });
}

/** Which chunk of a world is asked for by a URL that `chunkRequest` has made; null for any other URL. */
export function chunkAsked(world: AnyWorld, url: string): ChunkKey | null {
  const head = `${pathOf(world)}/chunks/`;
  if (!url.startsWith(head)) {
    return null;
  }
  const [lod, x, y, z] = url.slice(head.length).split(".", 1)[0]!.split("/").map(Number);
  return { lod: lod!, x: x!, y: y!, z: z! };
}

/** Without a key the edit gets one, so it can be sent again. @throws {RangeError} for a key that is none */
export function editRequest(world: WorldDescriptor, strokes: Iterable<Stroke>, key: string | null): Request {
  const name = key ?? randomKey();
  if (!EDIT_KEY.test(name)) {
    throw new RangeError(`key is "${name}": an edit's key has 1 to 128 visible ASCII characters`);
  }
  return posted(`${pathOf(world)}/edits`, { strokes: [...strokes] }, { "idempotency-key": name });
}

/** @throws {RangeError} for NaN or infinity, which JSON does not have */
export function posted(url: string, body: unknown, headers: Readonly<Record<string, string>> = {}): Request {
  const all = { accept: JSON_MEDIA_TYPE, "content-type": JSON_MEDIA_TYPE, ...headers };
  return { method: "POST", url, headers: all, body: jsonText(body), repeatable: true, cached: false };
}

/** A GET of JSON. parts: of the path. */
export function got(parts: readonly string[], query: Readonly<Record<string, string>> = {}, cached = false): Request {
  const path = `/${parts.map(encodeURIComponent).join("/")}`;
  return { method: "GET", url: path + asQuery(query), headers: { accept: JSON_MEDIA_TYPE }, repeatable: true, cached };
}

/** Whether a chunk of `revision` that came for these options is the same for ever. */
export function isImmutable(world: AnyWorld, options: ChunkOptions, revision: bigint): boolean {
  return world.kind === "seed" || (options.revision !== undefined && revision <= options.revision);
}

/** The tokens of the descriptor are in it where they promise something. */
function query(world: AnyWorld, options: ChunkOptions): string {
  const { profile, frame, mesher, seam, coarser, minRevision, revision } = options;
  const tokens =
    world.kind === "seed"
      ? { recipe: world.recipe.name, g: world.generator }
      : revision === undefined
        ? {}
        : { revision: String(revision), g: world.generator, epoch: world.epoch };
  const asked = { ...tokens, profile, frame, mesher, seam, coarser: coarser || undefined, min_revision: minRevision };
  const given = Object.entries(asked).filter(([, value]) => value !== undefined);
  return asQuery(Object.fromEntries(given.map(([name, value]) => [name, String(value)])));
}

function asQuery(query: Readonly<Record<string, string>>): string {
  const text = new URLSearchParams(query).toString();
  return text && `?${text}`;
}

function priority({ urgency }: ChunkOptions): Record<string, string> {
  return urgency === undefined ? {} : { priority: `u=${urgency}` };
}

function randomKey(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(KEY_BYTES)), (byte) =>
    byte.toString(16).padStart(2, "0"),
  ).join("");
}

/**
 * The JSON of a value: bigints as decimal strings, an `Int32Array` as base64.
 *
 * @throws {RangeError} for NaN or infinity, which JSON does not have
 */
export function jsonText(value: unknown): string {
  return JSON.stringify(value, (name, each: unknown) => {
    if (typeof each === "number" && !Number.isFinite(each)) {
      throw new RangeError(`${name} is ${each}: JSON has finite numbers only`);
    }
    return typeof each === "bigint" ? String(each) : each instanceof Int32Array ? base64Of(each) : each;
  });
}
