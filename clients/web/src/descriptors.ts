/** What the server says of worlds and recipes, typed and checked: docs/api.md. */

import type { Json } from "./json.js";
import {
  CELLS_BUILT,
  COARSER_MAX,
  LOD_MAX,
  POSITION_LOW,
  REVISION_MAX,
  UNITS_PER_SIDE,
  VOXELS_MAX,
  type ChunkKey,
  type Place,
  type Triple,
} from "./mesh.js";

const SEED_MAX = (1n << 63n) - 1n;

/** What a world is made of. */
export interface Recipe {
  /** Names the expression, the same on every server. */
  readonly digest: string;
  /** Of a built-in recipe; of any other the digest. */
  readonly name: string;
  /** Of a built-in recipe. */
  readonly description: string;
  /** Of a built-in recipe: a JSON Schema each, with its default. */
  readonly parameters: Readonly<Record<string, unknown>>;
  /** The expression tree, as it could be posted; empty in a list of recipes. */
  readonly expression: Readonly<Record<string, unknown>>;
}

/** Everything to know before asking for a chunk. A plain object: it can be cloned, kept and sent to a worker. */
export interface Descriptor {
  /** Signed, 64 bits. */
  readonly seed: bigint;
  readonly recipe: Recipe;
  /** The same token means the same bytes. */
  readonly generator: string;
  /** Metres. */
  readonly voxelSize: number;
  /** Cells a side of a chunk, at every LOD. */
  readonly chunkCells: number;
  /** Levels of detail, 0 (finest) to lods - 1. */
  readonly lods: number;
  /** The world's extent in voxels, both ends included. */
  readonly low: Triple;
  readonly high: Triple;
  /** What is built. */
  readonly meshers: readonly string[];
  readonly seams: readonly string[];
  readonly coarser: readonly number[];
  /** By LOD, how far its surface may be off, in voxels; null if the server does not say. */
  readonly geometricErrors: readonly number[] | null;
}

/** The pristine world of a seed: it needs no creation and never changes. */
export interface SeedDescriptor extends Descriptor {
  readonly kind: "seed";
}

/** A world that somebody has created. */
export interface WorldDescriptor extends Descriptor {
  readonly kind: "world";
  readonly id: string;
  /** A world that is deleted and created again has another one. */
  readonly epoch: string;
  /** How many edits it had taken. */
  readonly revision: bigint;
  /** ISO 8601. */
  readonly created: string;
  /** Whether it outlives the server. */
  readonly durable: boolean;
  /** How long a request waits at most, for a worker or for a revision. */
  readonly answerSeconds: number;
}

export type AnyWorld = SeedDescriptor | WorldDescriptor;

/** One world of the list. */
export interface ListedWorld {
  readonly id: string;
  readonly epoch: string;
  readonly revision: bigint;
  readonly created: string;
  readonly seed: bigint;
  /** Its name, or the digest. */
  readonly recipe: string;
  readonly generator: string;
}

/** What HEAD says of a chunk. */
export interface ChunkHead {
  /** Without quotes. */
  readonly etag: string;
  readonly content: string;
  /** Of the chunk's own last edit; 0 is pristine. */
  readonly revision: bigint;
}

/** Where a chunk of a world is. */
export function placeIn(world: Descriptor, { lod, x, y, z }: ChunkKey): Place {
  return { key: { lod, x, y, z }, cells: world.chunkCells, voxelSize: world.voxelSize };
}

/** Where a world is on the server. */
export function pathOf(world: AnyWorld): string {
  return world.kind === "seed" ? `/v1/seeds/${world.seed}` : `/v1/worlds/${encodeURIComponent(world.id)}`;
}

export function readSeed(json: Json): SeedDescriptor {
  return { kind: "seed", ...shared(json) };
}

export function readWorld(json: Json): WorldDescriptor {
  return {
    kind: "world",
    ...shared(json),
    ...identity(json),
    durable: json.at("durable").boolean(),
    answerSeconds: json.at("limits").at("answer_seconds").number(),
  };
}

export function readListedWorld(json: Json): ListedWorld {
  return {
    ...identity(json),
    seed: readSeedNumber(json),
    recipe: json.at("recipe").text(),
    generator: json.at("generator").text(),
  };
}

export function readRecipe(json: Json): Recipe {
  const digest = json.at("digest").text();
  return {
    digest,
    name: json.get("name")?.text() ?? digest,
    description: json.get("description")?.text() ?? "",
    parameters: json.get("parameters")?.members() ?? {},
    expression: json.get("expression")?.members() ?? {},
  };
}

function identity(json: Json) {
  return {
    id: json.at("id").text(),
    epoch: json.at("epoch").text(),
    revision: json.at("revision").decimal(0n, REVISION_MAX),
    created: time(json.at("created")),
  };
}

function time(json: Json): string {
  return Number.isNaN(Date.parse(json.text())) ? json.refuse("a time of ISO 8601") : json.text();
}

function readSeedNumber(json: Json): bigint {
  return json.at("seed").decimal(-SEED_MAX - 1n, SEED_MAX);
}

function shared(json: Json): Descriptor {
  const lattice = json.at("position_lattice");
  lattice.at("low").integer(POSITION_LOW, POSITION_LOW);
  lattice.at("high").integer(POSITION_LOW + UNITS_PER_SIDE, POSITION_LOW + UNITS_PER_SIDE);
  const lods = json.at("lods").integer(1, LOD_MAX + 1);
  const cells = json.at("chunk_cells").integer(Math.min(...CELLS_BUILT), Math.max(...CELLS_BUILT));
  return {
    seed: readSeedNumber(json),
    recipe: readRecipe(json.at("recipe")),
    generator: json.at("generator").text(),
    voxelSize: json.at("voxel_size").number(),
    chunkCells: CELLS_BUILT.includes(cells) ? cells : json.at("chunk_cells").refuse(CELLS_BUILT.join(", ")),
    lods,
    low: point(json.at("bounds").at("min")),
    high: point(json.at("bounds").at("max")),
    meshers: json.at("meshers").texts(),
    seams: json.at("seams").texts(),
    coarser: json
      .at("coarser")
      .elements()
      .map((mask) => mask.integer(0, COARSER_MAX)),
    geometricErrors: readErrors(json.get("geometric_errors"), lods),
  };
}

function readErrors(json: Json | null, lods: number): readonly number[] | null {
  const errors = json?.elements().map((error) => error.number()) ?? null;
  if (json !== null && errors !== null && (errors.length !== lods || Math.min(...errors) < 0)) {
    json.refuse(`${lods} numbers, none of them negative`);
  }
  return errors;
}

function point(json: Json): Triple {
  const [x, y, z] = [0, 1, 2].map((axis) => json.at(axis).integer(-VOXELS_MAX, VOXELS_MAX));
  return [x!, y!, z!];
}
