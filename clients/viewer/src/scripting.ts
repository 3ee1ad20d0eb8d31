/**
 * `window.chunkserver`: the page for scripts and tests. Wait on its counters, never for a time.
 *
 *     await page.waitForFunction(() => chunkserver.counters.isSettled)
 *     chunkserver.setCamera([0, 230, 0], [0, -1, 0.01])
 *     await chunkserver.dig([0, 200, 0], 8)
 */

import type { Triple } from "chunkserver-client";
import type { WebGLRenderer } from "three";

import type { App } from "./app.js";
import type { View } from "./look/index.js";

/** All of it is of this moment. */
export interface Counters {
  /** Chunks that are shown, those without triangles too, and the triangles of all. */
  readonly chunks: number;
  readonly triangles: number;
  /** Chunks that are wanted and not shown yet. */
  readonly pending: number;
  /** By level, chunks with triangles that are shown. */
  readonly levels: readonly number[];
  /** Whether what is shown is all that is wanted, and no other world is on its way. */
  readonly isSettled: boolean;
  /** Whether others are heard as soon as they dig. */
  readonly isLive: boolean;
  /** The newest edit that is known of. */
  readonly revision: string;
  readonly isAway: boolean;
  readonly isWalking: boolean;
  readonly isStanding: boolean;
  /** Metres of the eye above the ground. */
  readonly altitude: number;
  readonly frames: number;
  /** Chunks that have come, those that were not drawn too. */
  readonly received: number;
  /** Of answers, as they came over the network. */
  readonly bytes: number;
  readonly requests: number;
  /** What is shown: the id of a world, or "seed". */
  readonly world: string;
}

export interface Scripting {
  readonly counters: Counters;
  /** In voxels, and a direction. */
  readonly camera: { readonly position: Triple; readonly ahead: Triple } | null;
  setCamera(position: Triple, ahead?: Triple): void;
  setView(view: View): void;
  /** What draws, with three.js's own figures in `info`. */
  readonly renderer: WebGLRenderer;
  /** Takes a ball away, in voxels; resolves when that is durable. */
  dig(center: Triple, radius: number): Promise<void>;
  build(center: Triple, radius: number): Promise<void>;
  /** Where the crosshair meets the ground, in voxels; null if it meets none. */
  aim(): Triple | null;
}

export function scripting(app: App): Scripting {
  const stroke = (op: string) => (center: Triple, radius: number) =>
    app.edit([{ op, shape: "sphere", center, radius }]);
  return {
    get counters(): Counters {
      const { session } = app;
      const world = session?.world;
      return {
        chunks: session?.terrain.chunks ?? 0,
        triangles: session?.triangles ?? 0,
        pending: session?.terrain.pending ?? 0,
        levels: session?.levels ?? [],
        isSettled: session?.isSettled === true && !app.isOpening,
        isLive: session?.following.isLive ?? false,
        revision: String(session?.following.revision ?? 0n),
        isAway: app.isAway,
        isWalking: session?.motion.isWalking ?? false,
        isStanding: session?.motion.isStanding ?? false,
        altitude: session?.motion.altitude ?? 0,
        frames: app.frames,
        received: session?.terrain.received ?? 0,
        bytes: app.traffic.bytes,
        requests: app.traffic.requests,
        world: world === undefined ? "" : world.kind === "world" ? world.id : "seed",
      };
    },
    get camera() {
      const pose = app.session?.pose;
      return pose === undefined ? null : { position: pose.position, ahead: pose.ahead };
    },
    setCamera: (position, ahead) => app.moveTo(position, ahead ?? null),
    setView: (view) => app.setView(view),
    renderer: app.renderer,
    dig: stroke("carve"),
    build: stroke("fill"),
    aim() {
      const { session } = app;
      const hit = session?.aim() ?? null;
      return session === null || hit === null
        ? null
        : (session.pose.position.map((at, axis) => at + session.pose.ahead[axis]! * hit.along) as unknown as Triple);
    },
  };
}
