/** How near a chunk has to be to be split, level by level: docs/level-of-detail.md, "Split distances" and "Limits". */

/** Nothing is split that is further away than so many times its own width. */
export const WIDTHS_MAX = 16;
/** How often the pixels of error are raised by a third before whole levels are given up. */
const RAISES_MAX = 8;

/** What is wanted, as distances in whole voxels. */
export interface Rung {
  /** Chunks of the last level are there if they are nearer. */
  readonly reach: number;
  /** By LOD: chunks are split if they are nearer. Those of LOD 0 never are. */
  readonly split: readonly number[];
}

/** How near a chunk has to be to stay as near ones are. */
export function kept(distance: number): number {
  return distance + Math.floor(distance / 4);
}

/** What is wanted at most while a viewer trembles. */
export function roomy({ reach, split }: Rung): Rung {
  return { reach: kept(reach), split: split.map(kept) };
}

/**
 * What is wanted first, and then less and less: the last rung has 64 chunks at most.
 *
 * Everything is a whole number below 2^53, so the divisions are exact.
 *
 * @param cells of a chunk's side
 * @param errors by LOD: how far the surface may be off, in voxels
 * @param sharpness how many times its error's size away from the viewer a chunk has to be
 * @param reach voxels
 */
export function rungs(cells: number, errors: readonly number[], sharpness: number, reach: number): Rung[] {
  const sides = errors.map((_, lod) => cells * 2 ** lod);
  const widest = sides.at(-1)!;
  let worst = 0;
  const wanted = errors.map((error, lod) => {
    worst = Math.max(worst, error);
    return Math.floor(Math.min(worst * sharpness, WIDTHS_MAX * sides[lod]!));
  });
  const raised = Array.from({ length: RAISES_MAX + 1 }, (_, times) =>
    wanted.map((distance) => Math.floor((distance * 3 ** times) / 4 ** times)),
  );
  const last = raised.at(-1)!;
  const dropped = errors.slice(1).map((_, finest) => last.map((distance, lod) => (lod < finest + 2 ? 0 : distance)));
  const found: Rung[] = [...raised, ...dropped].map((row) => ({ reach, split: [0, ...row.slice(1)] }));
  const nothing = errors.map(() => 0);
  for (let less = Math.floor((reach * 3) / 4); less > widest / 2; less = Math.floor((less * 3) / 4)) {
    found.push({ reach: less, split: nothing });
  }
  found.push({ reach: widest / 2, split: nothing });
  const unique = new Map(found.map((rung) => [`${rung.reach}: ${rung.split}`, rung]));
  return [...unique.values()];
}
