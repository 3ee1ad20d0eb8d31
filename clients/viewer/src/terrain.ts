/**
 * What is drawn of a world, and what is fetched for it: docs/level-of-detail.md, "While chunks load".
 *
 * An edit makes chunks stale that are drawn. They count as changed, like those of which another level is wanted, so one
 * list of swaps has both: chunks of one edit are drawn anew at once, and borders fit at all times.
 */

import {
  LevelOfDetail,
  chunkName,
  isStale,
  swapsInParts,
  type AnyWorld,
  type ChunkClient,
  type ChunkKey,
  type ChunkMesh,
  type ChunkRange,
  type ChunkSet,
  type FittedChunk,
  type Selection,
  type Triple,
  type ViewOptions,
} from "chunkserver-client";

import { Fetching } from "./fetching.js";
import { free } from "./freeing.js";
import { byDistance, isIn } from "./places.js";

/** How much coarser the first worlds are that are shown: a whole one comes soon. */
const STAGES: readonly number[] = [16, 4, 1];
/** Milliseconds between two looks at what is to be shown, while chunks are on their way. */
const SELECT_MS = 250;
/** Milliseconds of a frame in which it is worked out what to swap, or a part of the frame if that is longer. */
const PLAN_MS = 1;
const PLAN_PART = 0.03;
/**
 * Milliseconds after which all of it is worked out in one frame, for those who edit all the time. A first, coarse world
 * is, too: it is small, and somebody waits for it.
 */
const PATIENCE_MS = 300;

/** Milliseconds in which nothing that is wanted could be drawn. */
const STARVED_MS = 1_000;

/** Bytes of meshes that are handed to the graphics card in a frame, and more only if one step has more. */
const DRAWN_BYTES = 1_000_000;

/** Where chunks are drawn. Those without triangles are not among them. */
export interface Canvas {
  draw(name: string, mesh: ChunkMesh): void;
  remove(name: string): void;
}

/** Chunks that take others' place once all of them have come. */
interface Step {
  readonly old: readonly string[];
  readonly fresh: ReadonlyMap<string, FittedChunk>;
  missing: number;
}

export class Terrain {
  private stages: readonly LevelOfDetail[];
  /** What has made the selection, and knows what was split in it. */
  private selector: LevelOfDetail | null = null;
  private readonly fetching: Fetching;
  private stage = 0;
  private selection: Selection | null = null;
  private drawn = new Map<string, FittedChunk>();
  /** Names of those that an edit has outdated. */
  private readonly stale = new Set<string>();
  /** Came, and are not drawn yet. */
  private readonly ready = new Map<string, ChunkMesh>();
  private steps: Step[] = [];
  private readonly stepOf = new Map<string, Step>();
  private isChanged = false;
  private selectedAt = -Infinity;
  /** What is to be shown and swapped is being worked out: nothing is drawn until then. */
  private planning: Generator<undefined, void, undefined> | null = null;
  /** Whether the first half of that is being done. */
  private isChoosing = false;
  private plannedAt = performance.now();
  private updatedAt = performance.now();
  private drawnAt = performance.now();
  private isStopped = false;
  private isBegun = false;
  private readonly chunkCells: number;
  private coveredBy: FittedChunk | null = null;

  /**
   * @param shown the world, with as many of its levels as are shown
   * @param failed told when chunks cannot be had; `resume` tries again
   */
  constructor(
    client: ChunkClient,
    world: AnyWorld,
    private readonly shown: Pick<AnyWorld, "chunkCells" | "lods" | "low" | "high" | "geometricErrors">,
    private options: ViewOptions,
    private readonly canvas: Canvas,
    failed: (error: unknown) => void,
  ) {
    this.stages = stagesOf(shown, options);
    this.chunkCells = world.chunkCells;
    this.fetching = new Fetching(client, world, {
      arrived: (mesh) => this.arrived(mesh),
      failed: (error) => {
        this.isStopped = true;
        failed(error);
      },
    });
  }

  /** Chunks that are wanted and not drawn yet. */
  get pending(): number {
    return this.steps.reduce((sum, step) => sum + step.fresh.size, 0);
  }

  /** Whether what is drawn is what is wanted, at full detail. */
  get isSettled(): boolean {
    const isPlanned = !this.isChanged && (this.planning === null || this.isChoosing);
    return this.steps.length === 0 && isPlanned && this.selector === this.stages.at(-1);
  }

  /** Whether an edit has outdated something that is drawn. */
  get isOutdated(): boolean {
    return this.stale.size > 0;
  }

  /** Whether nothing was drawn for long, though chunks are wanted: edits may outdate them before all of them have come. */
  get isStarved(): boolean {
    return this.steps.length > 0 && !this.isStopped && this.updatedAt - this.drawnAt > STARVED_MS;
  }

  /** Whether a first, coarse world around the viewer was drawn completely. */
  get isPresentable(): boolean {
    return this.isBegun;
  }

  get chunks(): number {
    return this.drawn.size;
  }

  /** Chunks that have come, wanted by then or not. */
  get received(): number {
    return this.fetching.arrived;
  }

  /** Of waiting, for one that came. */
  get msPerChunk(): number {
    return this.fetching.arrived ? this.fetching.busyMs / this.fetching.arrived : 0;
  }

  /** Once a frame. position, velocity: voxels, and voxels a second */
  update(position: Triple, velocity: Triple): void {
    const now = performance.now();
    const until = now + Math.max(PLAN_MS, (now - this.updatedAt) * PLAN_PART);
    this.updatedAt = now;
    if (this.isSelecting(now)) {
      this.selectedAt = now;
      this.planning = this.choose(position, velocity);
    } else if (this.isChanged && !this.isChoosing) {
      this.planning = this.plan(position);
    }
    const isLate = !this.isLastStage || now - this.plannedAt > PATIENCE_MS;
    while (this.planning?.next().done === false) {
      if (performance.now() > until && !isLate) {
        return;
      }
    }
    this.planning = null;
    this.plannedAt = now;
    this.advance();
  }

  /** Whether the chunk is drawn that a point is in, whichever level it is of. */
  covers(point: Triple): boolean {
    if (
      this.coveredBy !== null &&
      this.drawn.has(chunkName(this.coveredBy)) &&
      isIn(point, this.coveredBy, this.chunkCells)
    ) {
      return true;
    }
    this.coveredBy = null;
    for (const chunk of this.drawn.values()) {
      if (isIn(point, chunk, this.chunkCells)) {
        this.coveredBy = chunk;
        return true;
      }
    }
    return false;
  }

  /** The picture is of another height, in pixels: more or less detail is wanted of the same places. */
  resize(screenPixels: number): void {
    if (screenPixels !== this.options.screenPixels) {
      this.options = { ...this.options, screenPixels };
      this.stages = stagesOf(this.shown, this.options);
    }
  }

  /** The viewer is somewhere else all at once: begins with a coarse world there. */
  jump(): void {
    this.stage = 0;
    this.selector = this.planning = null;
    this.isChoosing = false;
    this.selectedAt = -Infinity;
    this.isChanged = true;
  }

  /** The same chunks are those of another world from now on: a seed's, of which somebody has made a world. */
  setWorld(world: AnyWorld): void {
    this.fetching.setWorld(world);
  }

  /**
   * Some chunks have changed: they are fetched anew, and what was fetched is not drawn.
   *
   * @param stale null is all of them
   * @param revision of the world that has changed them
   */
  outdate(stale: readonly ChunkRange[] | null, revision: bigint): void {
    this.fetching.expect(revision);
    const isOld = (chunk: ChunkKey) => stale === null || isStale(chunk, stale);
    for (const [name, chunk] of this.drawn) {
      if (isOld(chunk)) {
        this.stale.add(name);
        this.isChanged = true;
      }
    }
    for (const [name, mesh] of this.ready) {
      if (isOld(mesh.key)) {
        this.drop(name, mesh);
        this.isChanged = true;
      }
    }
    this.isChanged = this.fetching.drop(isOld) || this.isChanged;
  }

  /** Goes on after a failure. */
  resume(): void {
    this.isStopped = false;
    this.isChanged = true;
  }

  /** Fetches nothing more; what is drawn stays. */
  stop(): void {
    this.fetching.stop();
    this.isStopped = true;
  }

  dispose(): void {
    this.stop();
    for (const name of this.drawn.keys()) {
      this.canvas.remove(name);
    }
    this.drawn.clear();
  }

  private get isLastStage(): boolean {
    return this.stage === this.stages.length - 1;
  }

  private isSelecting(now: number): boolean {
    const isDue = this.steps.length === 0 || this.selector === null || now - this.selectedAt > SELECT_MS;
    return isDue && this.planning === null;
  }

  /** Chooses what is to be shown, and works out how to come there. */
  private *choose(position: Triple, velocity: Triple): Generator<undefined, void, undefined> {
    if (this.selector !== null && !this.isLastStage && this.steps.length === 0 && !this.isChanged) {
      this.stage += 1;
      this.isBegun = true;
    }
    const levels = this.stages[this.stage]!;
    const before = this.selector === levels ? this.selection : null;
    this.isChoosing = true;
    this.selection = yield* levels.selectInParts(position, velocity, before);
    this.isChoosing = false;
    this.selector = levels;
    if (this.isChanged || this.selection.chunks !== before?.chunks) {
      yield;
      yield* this.plan(position);
    }
  }

  /** Works out what has to be swapped, and asks for what is missing: in parts, between which nothing else is drawn. */
  private *plan(position: Triple): Generator<undefined, void, undefined> {
    this.isChanged = false;
    const found = yield* swapsInParts(this.marked(), this.selection!.chunks);
    yield;
    this.steps = found.map(({ old, new: fresh }) => this.step(old, fresh));
    this.stepOf.clear();
    for (const step of this.steps) {
      for (const name of step.fresh.keys()) {
        this.stepOf.set(name, step);
      }
    }
    for (const [name, mesh] of this.ready) {
      if (!this.stepOf.has(name)) {
        this.drop(name, mesh);
      }
    }
    yield;
    const wanted = byDistance(
      this.steps.map(({ fresh }) => fresh),
      position,
      this.chunkCells,
    );
    yield;
    if (!this.isStopped) {
      const missing = wanted.filter(([name]) => !this.ready.has(name));
      this.fetching.want(missing, position);
    }
  }

  /** What is drawn, with other names for what is out of date. */
  private marked(): ChunkSet {
    return this.stale.size === 0
      ? this.drawn
      : new Map([...this.drawn].map(([name, chunk]) => [this.stale.has(name) ? `${name}!` : name, chunk]));
  }

  private step(old: ChunkSet, fresh: ChunkSet): Step {
    let missing = 0;
    for (const name of fresh.keys()) {
      missing += this.ready.has(name) ? 0 : 1;
    }
    const names = this.stale.size === 0 ? [...old.keys()] : Array.from(old.values(), chunkName);
    return { old: names, fresh, missing };
  }

  /** Does the steps whose chunks have all come, until enough is drawn for one frame: the first of them is done anyway. */
  private advance(): void {
    let bytes = 0;
    const left: Step[] = [];
    for (const step of this.steps) {
      if (step.missing > 0 || bytes >= DRAWN_BYTES) {
        left.push(step);
      } else {
        bytes += this.take(step);
      }
    }
    if (left.length === 0 || left.length < this.steps.length) {
      this.drawnAt = this.updatedAt;
    }
    this.steps = left;
  }

  /** Draws what has come in place of what was there; returns how many bytes that is. */
  private take(step: Step): number {
    let bytes = 0;
    for (const name of step.old) {
      this.remove(name);
    }
    for (const [name, chunk] of step.fresh) {
      this.remove(name); // the same chunk from before an edit
      this.drawn.set(name, chunk);
      const mesh = this.ready.get(name)!;
      this.ready.delete(name);
      if (mesh.content === "surface") {
        this.canvas.draw(name, mesh);
        bytes += mesh.positions.byteLength + mesh.normals.byteLength + mesh.indices.byteLength;
      }
    }
    return bytes;
  }

  /** Takes away what has come and is not drawn. */
  private drop(name: string, mesh: ChunkMesh): void {
    this.ready.delete(name);
    free(mesh);
  }

  private remove(name: string): void {
    if (this.drawn.delete(name)) {
      this.stale.delete(name);
      this.canvas.remove(name);
    }
  }

  private arrived(mesh: ChunkMesh): void {
    const name = chunkName({ ...mesh.key, coarser: mesh.coarser });
    const step = this.stepOf.get(name);
    if (step === undefined || this.ready.has(name) || this.isStopped) {
      free(mesh);
      return;
    }
    this.ready.set(name, mesh);
    step.missing -= 1;
  }
}

/** Coarser and coarser choices, the first one to be shown first. */
function stagesOf(shown: ConstructorParameters<typeof LevelOfDetail>[0], options: ViewOptions): LevelOfDetail[] {
  const { errorPixels = 4 } = options;
  return STAGES.map((times) => new LevelOfDetail(shown, { ...options, errorPixels: errorPixels * times }));
}
