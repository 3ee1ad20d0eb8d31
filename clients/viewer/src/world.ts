/** Which world is shown: a seed's, which nobody has to create, and the world that is made of it when somebody digs. */

import {
  Conflict,
  type AnyWorld,
  type ChunkClient,
  type SeedDescriptor,
  type Triple,
  type WorldDescriptor,
} from "chunkserver-client";

import type { Shape } from "./shape.js";

/** What a link names. recipe: a name or a digest */
export type Source =
  | { readonly kind: "seed"; readonly seed: bigint; readonly recipe: string }
  | { readonly kind: "world"; readonly id: string };

/** Whether a recipe is named by its digest: somebody has written it. */
export const isOwn = (recipe: string): boolean => /^[0-9a-f]{32}$/.test(recipe);

export const SEED_MAX = (1n << 63n) - 1n;
const ID_MAX = 64;
const DIGEST_SHOWN = 16;
/** Levels of a world without end that are shown: beyond the last is fog. */
const LODS_FLAT = 10;
const REACH_FLAT = 12_288;
/** Room around a ball, in its radii: what is outside is not asked for. */
const BALL_BOX = 1.5;
/** Widths of the last level that a ball is seen from. */
const BALL_WIDTHS = 16;

export async function open(client: ChunkClient, source: Source): Promise<AnyWorld> {
  if (source.kind === "world") {
    return client.world(source.id);
  }
  const pristine = await client.seed(source.seed, source.recipe);
  return (await dugOut(client, pristine)) ?? pristine;
}

/** The world that has been made of a seed; null if there is none yet, or another one has its id. */
export async function dugOut(client: ChunkClient, pristine: SeedDescriptor): Promise<WorldDescriptor | null> {
  const id = idOf(pristine);
  if (!(await isThere(client, id))) {
    return null;
  }
  const world = await unlessConflict(client.world(id));
  if (world === null) {
    return null;
  }
  const isIt = world.seed === pristine.seed && world.recipe.digest === pristine.recipe.digest;
  return isIt && world.lods === pristine.lods && world.voxelSize === pristine.voxelSize ? world : null;
}

/** Makes the world of a seed that can be dug in. Its chunks are the same, until somebody does. */
export function digOut(client: ChunkClient, pristine: SeedDescriptor): Promise<WorldDescriptor> {
  const { seed, recipe, lods, voxelSize, chunkCells } = pristine;
  return client.createWorld(idOf(pristine), seed, recipe.name, { lods, voxelSize, chunkCells });
}

/** The same in every browser, so that all dig in the same world. */
export function idOf({ recipe, seed }: SeedDescriptor): string {
  const name = recipe.name === recipe.digest ? recipe.digest.slice(0, DIGEST_SHOWN) : recipe.name;
  return `viewer-${name}-${seed}`.slice(0, ID_MAX);
}

/** Asks the list, for which a world that is not there is no error. */
async function isThere(client: ChunkClient, id: string): Promise<boolean> {
  const [first] = await client.worlds({ after: justBefore(id), limit: 1 });
  return first?.id === id;
}

/** Another generator's world is another world: nobody can show it, and nobody needs to. */
async function unlessConflict<World>(asked: Promise<World>): Promise<World | null> {
  try {
    return await asked;
  } catch (error) {
    if (error instanceof Conflict) {
      return null;
    }
    throw error;
  }
}

/** The last id in order before another one that ends in a digit, as good as. */
function justBefore(id: string): string {
  const last = id.charCodeAt(id.length - 1);
  const lower = id.endsWith("0") ? "-" : String.fromCharCode(last - 1);
  return `${id.slice(0, -1)}${lower}`.padEnd(ID_MAX, "z");
}

/** Where the server is: beside this page, whatever proxy is in front of it. */
export function serverUrl(): string {
  return new URL(".", location.href.split("#")[0]).href.replace(/\/+$/, "");
}

/** How far the surface may seem to be off, in pixels. Of a ball that large coasts are seen as a whole. */
const ERROR_PIXELS = 8;
const ERROR_PIXELS_LARGE = 4;
const RADIUS_LARGE = 2000;

/** How far one sees in a world, and how finely, as `LevelOfDetail` takes it. Voxels. */
export interface Extent {
  readonly lods: number;
  readonly reach: number;
  readonly errorPixels: number;
  readonly box?: { readonly low: Triple; readonly high: Triple };
}

export function extentOf(world: AnyWorld, { centre, radius }: Shape): Extent {
  const widest = (lods: number) => world.chunkCells * 2 ** (lods - 1);
  if (centre === null || radius === null) {
    const lods = Math.min(world.lods, LODS_FLAT);
    return { lods, reach: Math.min(REACH_FLAT, BALL_WIDTHS * widest(lods)), errorPixels: ERROR_PIXELS };
  }
  let lods = 1;
  while (lods < world.lods && widest(lods) < 2 * BALL_BOX * radius) {
    lods += 1;
  }
  const room = Math.ceil(BALL_BOX * radius) + world.chunkCells;
  const low = centre.map((at) => Math.floor(at - room)) as unknown as Triple;
  const high = centre.map((at) => Math.ceil(at + room)) as unknown as Triple;
  const errorPixels = radius < RADIUS_LARGE ? ERROR_PIXELS : ERROR_PIXELS_LARGE;
  return { lods, reach: BALL_WIDTHS * widest(lods), errorPixels, box: { low, high } };
}
