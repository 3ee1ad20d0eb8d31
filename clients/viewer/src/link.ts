/** A link that restores world and camera: `#recipe=planet&seed=42&at=0,220.5,30&look=0.1,-0.2,-0.97&walk=1`. */

import type { Triple } from "chunkserver-client";

import type { View } from "./look/index.js";
import { SEED_MAX, type Source } from "./world.js";

export interface Link {
  readonly source: Source;
  /** The recipe whose ground, sea and sky it has: of one that was made of it. null: its own */
  readonly like: string | null;
  /** Where the viewer is, in voxels; null where the link does not say. */
  readonly position: Triple | null;
  readonly ahead: Triple | null;
  readonly isWalking: boolean;
  readonly view: View;
}

/** In the order of their keys; the first one is that of a link which names none. */
export const VIEWS: readonly View[] = ["shaded", "wireframe", "levels", "normals"];
/** Of a link which names none. */
export const SEED_FIRST = 42n;
const ID = /^[a-z0-9_-]{1,64}$/;
const DECIMAL = /^[+-]?\d{1,13}(\.\d{1,9})?$/;
const PLACES = 3;
const PLACES_OF_DIRECTION = 4;

/** What a hash says, with what it leaves out or has wrong as by default. */
export function readLink(hash: string): Link {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const [id, recipe, seed] = [given.get("world"), given.get("recipe"), given.get("seed")];
  const like = ID.test(given.get("like") ?? "") ? given.get("like") : null;
  const source: Source =
    id !== null && ID.test(id)
      ? { kind: "world", id }
      : {
          kind: "seed",
          seed: seedOf(seed ?? "") ?? SEED_FIRST,
          recipe: recipe !== null && ID.test(recipe) ? recipe : "continents",
        };
  const [position, ahead] = [triple(given.get("at")), triple(given.get("look"))];
  const view = VIEWS.find((each) => each === given.get("view")) ?? VIEWS[0]!;
  return { source, like, position, ahead, isWalking: given.get("walk") === "1", view };
}

export function writeLink({ source, like, position, ahead, isWalking, view }: Link): string {
  const which = source.kind === "world" ? `world=${source.id}` : `recipe=${source.recipe}&seed=${source.seed}`;
  const looks = like === null ? "" : `&like=${like}`;
  const at = position === null ? "" : `&at=${position.map((place) => decimal(place, PLACES)).join(",")}`;
  const look = ahead === null ? "" : `&look=${ahead.map((part) => decimal(part, PLACES_OF_DIRECTION)).join(",")}`;
  return `#${which}${looks}${at}${look}${isWalking ? "&walk=1" : ""}${view === VIEWS[0] ? "" : `&view=${view}`}`;
}

/** A signed 64-bit integer; null for anything else. */
export function seedOf(text: string): bigint | null {
  if (!/^\s*[+-]?\d{1,19}\s*$/.test(text)) {
    return null;
  }
  const seed = BigInt(text.trim().replace("+", ""));
  return seed >= -SEED_MAX - 1n && seed <= SEED_MAX ? seed : null;
}

function decimal(value: number, places: number): string {
  return value.toFixed(places).replace(/\.?0+$/, "");
}

function triple(text: string | null): Triple | null {
  const parts = text?.split(",") ?? [];
  return parts.length === 3 && parts.every((part) => DECIMAL.test(part))
    ? [Number(parts[0]), Number(parts[1]), Number(parts[2])]
    : null;
}
