/**
 * Chunks in a scene of three.js: `chunkserver-client/three`.
 *
 *     const group = new ChunkGroup(world);
 *     const material = placed(new MeshStandardMaterial());
 *     scene.add(group);
 *     group.moveAnchor(viewer);
 *     group.add(new ChunkObject(mesh, material));
 *     camera.position.copy(group.positionOf(viewer));
 *
 * **Why borders do not sparkle.** A vertex stays the integer that it is on the wire. The shader adds its chunk's
 * corner, an integer too, counted from one anchor for all chunks:
 *
 *     place = corner + position * 2^lod          lattice units of LOD 0 from the anchor
 *
 * Both terms are exact in float32 and their sum is rounded once, so vertices of two chunks that are the same point get
 * the same bits, and all chunks share one matrix from there on. A matrix for each chunk would round each chunk's own
 * way: then pixels of the background show through along seams.
 *
 * Corners are exact as long as chunks lie within 2^23 chunks of LOD 0 of the anchor, more than any view reaches.
 */

import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  Group,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  Matrix4,
  Mesh,
  MeshDepthMaterial,
  MeshDistanceMaterial,
  Sphere,
  Vector3,
  type Intersection,
  type Material,
  type Raycaster,
} from "three";

import type { Descriptor } from "./descriptors.js";
import { POSITION_LOW, UNITS_PER_SIDE, type ChunkMesh, type Triple } from "./mesh.js";

/** The name of the attribute with a chunk's corner, and its step in `w`. */
const PLACE = "chunkPlace";

/** A chunk's mesh, in a `ChunkGroup`. It owns its geometry: `dispose` it when it is taken out. */
export class ChunkObject extends Mesh<InstancedBufferGeometry, Material | Material[]> {
  /** A shadow is cast from where the chunk is. */
  override customDepthMaterial: Material = DEPTH;
  override customDistanceMaterial: Material = DISTANCE;
  private readonly place = new InstancedBufferAttribute(new Float32Array(4), 4);

  /**
   * @param chunk of profile "std", not empty. Its arrays are handed to WebGL as they are.
   * @param material one that `placed` has returned
   */
  constructor(
    readonly chunk: ChunkMesh,
    material: Material | Material[],
  ) {
    super(geometryOf(chunk), material);
    this.geometry.setAttribute(PLACE, this.place);
    this.matrixAutoUpdate = false;
  }

  /** Counts it from another anchor, in chunks of LOD 0. `ChunkGroup` does that. */
  placeAt(anchor: Triple): void {
    const { key, low, high } = this.chunk;
    const step = 2 ** key.lod;
    const places = [key.x, key.y, key.z];
    const corner = new Vector3(
      ...places.map((place, axis) => (place * step - anchor[axis]!) * UNITS_PER_SIDE - POSITION_LOW * step),
    );
    this.place.setXYZW(0, corner.x, corner.y, corner.z, step);
    this.place.needsUpdate = true;
    const bounds = new Box3(new Vector3(...low), new Vector3(...high));
    this.geometry.boundingBox = new Box3(
      bounds.min.multiplyScalar(step).add(corner),
      bounds.max.multiplyScalar(step).add(corner),
    );
    this.geometry.boundingSphere = this.geometry.boundingBox.getBoundingSphere(new Sphere());
  }

  /** Frees what the graphics card holds. */
  override dispose(): void {
    this.geometry.dispose();
  }

  override raycast(raycaster: Raycaster, intersects: Intersection[]): void {
    const sphere = SPHERE.copy(this.geometry.boundingSphere!).applyMatrix4(this.matrixWorld);
    if (!raycaster.ray.intersectsSphere(sphere)) {
      return;
    }
    const [x, y, z, step] = this.place.array;
    PROBE.material = this.material;
    PROBE.geometry = new BufferGeometry()
      .setAttribute("position", this.geometry.getAttribute("position"))
      .setIndex(this.geometry.index);
    PROBE.geometry.boundingSphere = new Sphere(new Vector3(), Infinity);
    PROBE.matrixWorld
      .copy(this.matrixWorld)
      .multiply(MATRIX.makeTranslation(x!, y!, z!))
      .scale(VECTOR.setScalar(step!));
    const found: Intersection[] = [];
    PROBE.raycast(raycaster, found);
    intersects.push(...found.map((hit) => ({ ...hit, object: this })));
  }
}

/**
 * All chunks of one world, around an anchor: a corner of a chunk of LOD 0 that is the origin of the scene.
 *
 * Scene units are metres. Move the anchor when the viewer is some kilometres away from it, and then everything else in
 * the scene by what `moveAnchor` returns.
 */
export class ChunkGroup extends Group {
  private readonly cells: number;
  private readonly voxelSize: number;
  private chunk: Triple = [0, 0, 0];

  constructor(world: Pick<Descriptor, "chunkCells" | "voxelSize">) {
    super();
    this.cells = world.chunkCells;
    this.voxelSize = world.voxelSize;
    this.scale.setScalar((world.voxelSize * world.chunkCells) / UNITS_PER_SIDE);
    this.updateMatrix();
    this.matrixAutoUpdate = false;
  }

  /** Where the scene's origin is in the world: x, y, z in voxels. */
  get anchor(): Triple {
    const [x, y, z] = this.chunk;
    return [x * this.cells, y * this.cells, z * this.cells];
  }

  /** Moves the anchor to the chunk of LOD 0 that a point is in, in voxels; returns the old origin in the new scene. */
  moveAnchor(point: Triple): Vector3 {
    const before = this.anchor;
    const [x, y, z] = point;
    this.chunk = [Math.floor(x / this.cells), Math.floor(y / this.cells), Math.floor(z / this.cells)];
    for (const child of this.children) {
      this.placeChild(child);
    }
    return this.positionOf(before);
  }

  /** Where a point of the world, in voxels, is in the scene, in metres. Taken in float64: exact far away, too. */
  positionOf(point: Triple): Vector3 {
    const anchor = this.anchor;
    return new Vector3(...point.map((voxel, axis) => (voxel - anchor[axis]!) * this.voxelSize));
  }

  /** Where a point of the scene, in metres, is in the world, in voxels. */
  voxelAt({ x, y, z }: Vector3): Triple {
    const anchor = this.anchor;
    return [anchor[0] + x / this.voxelSize, anchor[1] + y / this.voxelSize, anchor[2] + z / this.voxelSize];
  }

  override add(...objects: Parameters<Group["add"]>): this {
    for (const object of objects) {
      this.placeChild(object);
    }
    return super.add(...objects);
  }

  private placeChild(child: unknown): void {
    if (child instanceof ChunkObject) {
      child.placeAt(this.chunk);
    }
  }
}

/**
 * Returns the material, with a vertex shader that puts chunks where they are. For any of three.js's own, and for those
 * that include `begin_vertex`. What its `onBeforeCompile` did before is done after this.
 */
export function placed<Kind extends Material>(material: Kind): Kind {
  const before = material.onBeforeCompile;
  const key = material.customProgramCacheKey;
  material.onBeforeCompile = (shader, renderer) => {
    shader.vertexShader = placedShader(shader.vertexShader);
    before.call(material, shader, renderer);
  };
  material.customProgramCacheKey = () => `${PLACE} ${key.call(material)}`;
  return material;
}

/** The vertex shader of three.js with a chunk's place in it. @throws {RangeError} if it has no `begin_vertex` */
export function placedShader(source: string): string {
  const begin = "#include <begin_vertex>";
  if (!source.includes(begin)) {
    throw new RangeError(`the vertex shader has no ${begin}`);
  }
  const moved = `vec3 transformed = ${PLACE}.xyz + position * ${PLACE}.w;`;
  return `attribute vec4 ${PLACE};\n${source.replace(begin, moved)}`;
}

const DEPTH = placed(new MeshDepthMaterial());
const DISTANCE = placed(new MeshDistanceMaterial());
const SPHERE = new Sphere();
const MATRIX = new Matrix4();
const VECTOR = new Vector3();
const PROBE = new Mesh();

/** The arrays of a chunk as attributes: views into the bytes that came. @throws {RangeError} for another profile */
function geometryOf(chunk: ChunkMesh): InstancedBufferGeometry {
  if (chunk.profile !== "std" || chunk.content !== "surface") {
    throw new RangeError(`the chunk is ${chunk.content}, profile ${chunk.profile}: expected a surface of profile std`);
  }
  const geometry = new InstancedBufferGeometry();
  geometry.instanceCount = 1;
  geometry.setAttribute("position", new BufferAttribute(chunk.positions, chunk.components));
  geometry.setAttribute("normal", new BufferAttribute(chunk.normals, chunk.components, true));
  geometry.setIndex(new BufferAttribute(chunk.indices, 1));
  return geometry;
}
