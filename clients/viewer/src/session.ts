/** One world on the screen, from its first chunk to its last: what is drawn, the viewer in it, its edits. */

import { type AnyWorld, type Stroke, type ChunkClient, type Triple } from "chunkserver-client";
import { ChunkGroup, ChunkObject } from "chunkserver-client/three";
import { Matrix4, PerspectiveCamera, Scene, Vector3, type Vector3Tuple, type WebGLRenderer } from "three";

import { Following } from "./following.js";
import { free } from "./freeing.js";
import { Ground, type Hit } from "./ground.js";
import { Look, type View } from "./look/index.js";
import type { Link } from "./link.js";
import { Motion, type Wish } from "./motion.js";
import { openPlace } from "./open_place.js";
import { Pose } from "./pose.js";
import type { Part } from "./recovery.js";
import { shapeOf } from "./shape.js";
import type { Start } from "./starts.js";
import { Terrain } from "./terrain.js";
import { lengthOf, minus, plus } from "./vectors.js";
import { extentOf } from "./world.js";
import type { Troubles, WorldShown } from "./worlds.js";

export const FOV_DEGREES = 60;
/** Of a level, in its cells, whatever the server says. */
const ERROR_LEAST = 0.15;
/** More would take long to come, and to draw. */
const CHUNKS_MAX = 4096;
/** Voxels from the viewer to the anchor. */
const ANCHOR_AWAY_MAX = 2048;
/** Triangles of which lines are made in a frame, when wires are shown. */
const LINED_TRIANGLES = 40_000;
/** How long light and shadows take to follow what has changed. */
const RESTLESS_SECONDS = 1.5;
/** A machine whose frames take that long rests where it can. */
const SLOW_SECONDS = 1 / 25;
const PACE_PART = 0.2;
/** Some want nothing to move by itself. */
const CALM = matchMedia("(prefers-reduced-motion: reduce)");
const NEAR_MIN = 0.08;
const NEAR_MAX = 1e5;
/** Of the distance to the nearest bounds of a chunk. */
const NEAR_PART = 0.5;
/** How far above somebody in a cave rock is looked for, in voxels. */
const ROOF = 256;
/** How far is dug, in metres; further where the ground is further away. */
const REACH_LEAST = 400;

export class Session implements WorldShown<Session> {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(FOV_DEGREES, 1, NEAR_MIN, 1e4);
  readonly ground = new Ground();
  readonly pose: Pose;
  readonly motion: Motion;
  readonly terrain: Terrain;
  readonly following: Following;
  /** The recipe whose ground, sea and sky it has. */
  readonly likeness: string;
  /** Whether the viewer is where they are to be: else they are taken out of rock, until all is there or they move. */
  isPlaced = true;
  triangles = 0;
  /** Whether nothing is fetched or heard any more. */
  isRetired = false;
  bytes = 0;
  private readonly group: ChunkGroup;
  private readonly look: Look;
  private readonly objects = new Map<string, ChunkObject>();
  /** Chunks that are still drawn as in the view before. */
  private unstyled: ChunkObject[] = [];
  private readonly far: number;
  private view: View = "shaded";
  /** The camera of the frame before. */
  private readonly seen = { place: new Matrix4(), projection: new Matrix4() };
  /** Seconds a frame, about. */
  private pace = 0;
  /** Seconds for which the picture still changes. */
  private restless = RESTLESS_SECONDS;

  /**
   * @param like the recipe whose ground, sea and sky it has; null: its own
   * @param screenPixels height of the picture; 0 of a page that is not shown yet
   */
  constructor(
    renderer: WebGLRenderer,
    client: ChunkClient,
    world: AnyWorld,
    private readonly like: string | null,
    start: (name: string, shape: ReturnType<typeof shapeOf>) => Start,
    screenPixels: number,
    troubles: Troubles,
  ) {
    const shape = shapeOf(world.recipe.expression);
    const extent = extentOf(world, shape);
    this.likeness = like ?? world.recipe.name;
    const { position, ahead } = start(this.likeness, shape);
    this.pose = new Pose(shape, position, ahead);
    const within = (shape.centre === null ? 2 ** 40 - 2 ** 20 : extent.reach * 0.9) as number;
    this.motion = new Motion(this.pose, this.ground, world.voxelSize, within);
    this.group = new ChunkGroup(world);
    this.scene.add(this.group);
    this.group.moveAnchor(position);
    this.far = 1.5 * extent.reach * world.voxelSize;
    this.look = new Look(renderer, this.scene, {
      seedOrRecipeName: this.likeness,
      voxelSize: world.voxelSize,
      isPlanet: shape.centre !== null,
      centre: shape.centre === null ? null : [...shape.centre],
      radius: shape.radius,
    });
    this.look.isCovered = () => this.ground.ray(this.pose.position, this.pose.up, ROOF) !== null;
    void this.look.isDetailed.then(() => this.touch());
    const { lods, ...view } = extent;
    const shown = { ...world, lods, geometricErrors: errorsOf(world, lods) };
    const options = {
      ...view,
      chunksMax: CHUNKS_MAX,
      fovDegrees: FOV_DEGREES,
      screenPixels: Math.max(screenPixels, 1),
    };
    const canvas = {
      draw: this.draw.bind(this),
      remove: this.remove.bind(this),
    };
    const chunksFailed = (error: unknown) => troubles.chunksFailed(error);
    this.terrain = new Terrain(client, world, shown, options, canvas, chunksFailed);
    this.following = new Following(client, world, this.terrain, troubles);
  }

  get world(): AnyWorld {
    return this.following.world;
  }

  /** How many chunks of each level are drawn that have triangles. */
  get levels(): number[] {
    const counts: number[] = [];
    for (const { chunk } of this.objects.values()) {
      counts[chunk.key.lod] = (counts[chunk.key.lod] ?? 0) + 1;
    }
    return Array.from(counts, (count) => count ?? 0);
  }

  /** The picture is not what was drawn last. */
  touch(): void {
    this.restless = RESTLESS_SECONDS;
  }

  setView(view: View): void {
    this.touch();
    this.view = view;
    this.look.setView(view);
    this.unstyled = [...this.objects.values()];
    this.restyle(view === "wireframe" ? LINED_TRIANGLES : Infinity);
  }

  /** Whether all that is wanted is shown, as it is wanted. */
  get isSettled(): boolean {
    return this.terrain.isSettled && this.unstyled.length === 0;
  }

  /** Shows chunks of so many triangles as the view has them: lines are made of triangles, which takes its time. */
  private restyle(trianglesMax: number): void {
    for (let triangles = 0; triangles < trianglesMax && this.unstyled.length > 0;) {
      const object = this.unstyled.pop()!;
      object.material = this.look.materialFor(object.chunk);
      triangles += object.chunk.indices.length / 3;
      this.touch();
    }
  }

  /** A page that is hidden may have no size: what is drawn stays as it was then. */
  resize(width: number, height: number): void {
    if (width === 0 || height === 0) {
      return;
    }
    this.touch();
    this.terrain.resize(height);
    this.camera.aspect = width / height;
    this.look.resize(width, height);
  }

  /** One frame. elapsed: seconds since the one before */
  frame(wish: Wish, elapsed: number): void {
    this.motion.move(wish, elapsed, this.terrain.covers(this.pose.position));
    if (!this.isPlaced) {
      this.leaveRock(wish);
    }
    const { position, ahead, up } = this.pose;
    this.restyle(LINED_TRIANGLES);
    this.following.update();
    this.terrain.update(position, this.motion.voxelsPerSecond);
    if (lengthOf(minus(position, this.group.anchor)) > ANCHOR_AWAY_MAX) {
      this.group.moveAnchor(position);
    }
    const { camera } = this;
    camera.position.copy(this.group.positionOf(position));
    camera.up.set(...(up as Vector3Tuple));
    camera.lookAt(camera.position.clone().add(new Vector3(...ahead)));
    const clear = this.ground.clearance(position) * this.world.voxelSize;
    camera.near = Math.max(NEAR_MIN, Math.min(clear * NEAR_PART, NEAR_MAX));
    camera.far = Math.max(this.far, 4 * camera.near);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    this.paint(elapsed);
  }

  private leaveRock({ onwards, right, up }: Wish): void {
    const { ground, pose, terrain } = this;
    const open = terrain.covers(pose.position) ? openPlace(ground, pose.position, pose.up) : null;
    if (open !== null) {
      pose.position = open;
    }
    this.isPlaced = (open === null && this.isSettled) || onwards !== 0 || right !== 0 || up !== 0;
  }

  /**
   * Draws, unless nothing has changed, light and shadows have had their time, and the machine is slow: on a fast one
   * the clouds drift on.
   */
  private paint(elapsed: number): void {
    const { camera } = this;
    const { place, projection } = this.seen;
    if (!place.equals(camera.matrixWorld) || !projection.equals(camera.projectionMatrix)) {
      place.copy(camera.matrixWorld);
      projection.copy(camera.projectionMatrix);
      this.restless = RESTLESS_SECONDS;
    }
    const isResting = this.restless <= 0 && (CALM.matches || this.pace > SLOW_SECONDS);
    if (!isResting) {
      this.restless -= elapsed;
      this.pace += (elapsed - this.pace) * PACE_PART;
      this.look.update(camera, [...this.group.anchor], camera.up, elapsed);
      this.look.render(camera);
    }
  }

  /** Where the crosshair meets the ground. */
  aim(): Hit | null {
    const reach = Math.max(REACH_LEAST, 4 * this.motion.altitude) / this.world.voxelSize;
    return this.ground.ray(this.pose.position, this.pose.ahead, reach);
  }

  /** Takes a ball of rock away, or puts one there. radius: metres. Returns whether there was anything to aim at. */
  async strike(op: "carve" | "fill", radius: number): Promise<boolean> {
    const hit = this.aim();
    if (hit === null) {
      return false;
    }
    const center = plus(this.pose.position, this.pose.ahead, hit.along);
    await this.edit([{ op, shape: "sphere", center, radius: radius / this.world.voxelSize }]);
    return true;
  }

  edit(strokes: readonly Stroke[]): Promise<void> {
    return this.following.edit(strokes);
  }

  moveTo(position: Triple, ahead: Triple | null): void {
    this.motion.stop();
    this.pose.position = position;
    if (ahead !== null) {
      this.pose.lookAlong(ahead);
    }
    this.terrain.jump();
  }

  get isPresentable(): boolean {
    return this.terrain.isPresentable;
  }

  prepare(leader: Session | null): void {
    if (leader !== null) {
      this.pose.position = leader.pose.position;
      this.pose.lookAlong(leader.pose.ahead);
    }
    this.following.update();
    this.terrain.update(this.pose.position, [0, 0, 0]);
  }

  get place(): Omit<Link, "source"> {
    const { like, pose, motion, view } = this;
    return { like, position: pose.position, ahead: pose.ahead, isWalking: motion.isWalking, view };
  }

  resume(part: Part): void {
    if (part === "chunks") {
      this.terrain.resume();
    } else {
      this.following.resume();
    }
  }

  retire(): void {
    this.isRetired = true;
    this.following.stop();
    this.terrain.stop();
  }

  dispose(): void {
    this.retire();
    this.terrain.dispose();
    this.look.dispose();
  }

  private draw(name: string, mesh: ConstructorParameters<typeof ChunkObject>[0]): void {
    const object = new ChunkObject(mesh, this.look.materialFor(mesh));
    object.castShadow = object.receiveShadow = true;
    this.touch();
    this.objects.set(name, object);
    this.group.add(object);
    this.ground.add(mesh);
    this.triangles += mesh.indices.length / 3;
    this.bytes += mesh.positions.byteLength + mesh.normals.byteLength + mesh.indices.byteLength;
  }

  private remove(name: string): void {
    const object = this.objects.get(name);
    if (object !== undefined) {
      this.touch();
      this.objects.delete(name);
      this.group.remove(object);
      object.dispose();
      this.ground.remove(object.chunk);
      const { positions, normals, indices } = object.chunk;
      this.triangles -= indices.length / 3;
      this.bytes -= positions.byteLength + normals.byteLength + indices.byteLength;
      free(object.chunk);
    }
  }
}

/** By level, how far it may be off. Where the server has seen no error there may be one all the same: of a lone hill. */
function errorsOf({ geometricErrors }: AnyWorld, lods: number): number[] | null {
  return geometricErrors?.slice(0, lods).map((error, lod) => Math.max(error, ERROR_LEAST * 2 ** lod)) ?? null;
}
