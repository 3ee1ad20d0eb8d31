/**
 * GLB, from bytes to arrays: docs/wire/glb.md. Reads what chunkserver writes, not every glTF.
 *
 *     12 bytes | JSON chunk | BIN chunk: positions | normals | indices
 */

import { BadChunk } from "./errors.js";
import { Json } from "./json.js";
import {
  COARSER_MAX,
  CONTENTS,
  INDICES_MAX,
  POSITION_MAX,
  REVISION_MAX,
  VERTICES_MAX,
  VOXELS_MAX,
  checkBounds,
  checkIndices,
  checkPlace,
  cornerOf,
  emptyMesh,
  sideOf,
  unitOf,
  type ChunkMesh,
  type Place,
  type Triple,
} from "./mesh.js";

const MAGIC = 0x46546c67; // "glTF"
const VERSION = 2;
const JSON_CHUNK = 0x4e4f534a; // "JSON"
const BIN_CHUNK = 0x004e4942; // "BIN\0"
const HEADER_BYTES = 12;
const CHUNK_HEADER_BYTES = 8;
const JSON_BYTES_MAX = 1 << 16;
const QUANTIZATION = "KHR_mesh_quantization";
const TRIANGLES = 4;
const ACCESSORS_MAX = 1 << 10;
const OFFSET_MAX = 2 ** 32 - 1;
const [I8, U16, U32] = [5120, 5123, 5125] as const;
/** Numbers a vertex has, the padding included. */
const COMPONENTS = 4;
const POSITION_STRIDE = 8;
const NORMAL_STRIDE = 4;

/** Where the numbers of an accessor are: bytes from the start of the file. */
interface Numbers {
  readonly componentType: number;
  readonly count: number;
  readonly offset: number;
}

/**
 * The mesh in `content`, a whole file that starts on a multiple of 4 of its buffer.
 *
 * The place is that of the node's extras, which is exact; the node's own numbers have to agree with it.
 *
 * @throws {BadChunk} whatever the bytes are; nothing else.
 */
export function decodeGlb(content: Uint8Array): ChunkMesh {
  const { scene, binary } = split(content);
  const node = scene.at("nodes").at(0);
  const extras = node.at("extras");
  const place = readPlace(extras);
  checkTransform(node, place);
  const error = extras.get("geometric_error");
  const told = {
    revision: extras.at("revision").decimal(0n, REVISION_MAX),
    coarser: extras.at("coarser").integer(0, COARSER_MAX),
    content: extras.at("content").oneOf(...CONTENTS),
    geometricError: error === null ? null : error.number(),
  };
  if ((told.content === "surface") !== (node.get("mesh") !== null)) {
    throw new BadChunk(`content is ${told.content}, and there is ${told.content === "surface" ? "no" : "a"} mesh`);
  }
  if (told.content !== "surface") {
    return emptyMesh(place, told);
  }
  const extensions = scene.at("extensionsRequired").texts().join();
  if (extensions !== QUANTIZATION) {
    throw new BadChunk(`needs the extensions ${extensions}: known is ${QUANTIZATION}`);
  }
  return { ...place, ...told, ...readMesh(scene, node.at("mesh").integer(0, 0), content, binary) };
}

/** The JSON, and where the BIN chunk begins and ends: nowhere if there is none. */
function split(content: Uint8Array): { scene: Json; binary: [number, number] } {
  if (content.length < HEADER_BYTES + CHUNK_HEADER_BYTES) {
    throw new BadChunk(`${content.length} bytes: a GLB has more`);
  }
  const view = new DataView(content.buffer, content.byteOffset, content.byteLength);
  if (view.getUint32(0, true) !== MAGIC || view.getUint32(4, true) !== VERSION) {
    throw new BadChunk("does not begin as a GLB of version 2");
  }
  const length = view.getUint32(8, true);
  if (length !== content.length) {
    throw new BadChunk(`its length is ${length}: there are ${content.length} bytes`);
  }
  const [start, end] = chunk(view, HEADER_BYTES, JSON_CHUNK);
  if (end - start > JSON_BYTES_MAX) {
    throw new BadChunk(`${end - start} bytes of JSON: at most ${JSON_BYTES_MAX}`);
  }
  const scene = Json.parse(new TextDecoder().decode(content.subarray(start, end)), BadChunk);
  const binary = end === content.length ? ([0, 0] as [number, number]) : chunk(view, end, BIN_CHUNK);
  if (binary[1] && binary[1] !== content.length) {
    throw new BadChunk(`${content.length - binary[1]} bytes behind the BIN chunk`);
  }
  return { scene, binary };
}

function chunk(view: DataView, start: number, wanted: number): [number, number] {
  const begin = start + CHUNK_HEADER_BYTES;
  if (begin > view.byteLength) {
    throw new BadChunk(`no header of a chunk at ${start}`);
  }
  const end = begin + view.getUint32(start, true);
  if (view.getUint32(start + 4, true) !== wanted || end > view.byteLength) {
    throw new BadChunk(`a chunk at ${start} is of another kind, or longer than the file`);
  }
  return [begin, end];
}

function readPlace(extras: Json): Place {
  const most = BigInt(VOXELS_MAX);
  const [lod, x, y, z] = ["lod", "x", "y", "z"].map((name) => Number(extras.at(name).decimal(-most, most)));
  const key = { lod: lod!, x: x!, y: y!, z: z! };
  const place = { key, cells: extras.at("cells").integer(0, VOXELS_MAX), voxelSize: extras.at("voxel_size").number() };
  checkPlace(place);
  return place;
}

/** Refuses a node that puts the chunk somewhere else: frame `world` or `chunk`, see the page. */
function checkTransform(node: Json, place: Place): void {
  const margin = sideOf(place) / 2;
  const world = cornerOf(place).map((low) => place.voxelSize * (low - margin));
  const own = -place.voxelSize * margin;
  const translation = node
    .at("translation")
    .elements()
    .map((element) => element.number());
  if (translation.length !== 3 || !(same(translation, world) || same(translation, [own, own, own]))) {
    node.at("translation").refuse(`${world} or three times ${own}`);
  }
  const unit = unitOf(place);
  if (
    !same(
      node
        .at("scale")
        .elements()
        .map((element) => element.number()),
      [unit, unit, unit],
    )
  ) {
    node.at("scale").refuse(`three times ${unit}`);
  }
}

function readMesh(scene: Json, mesh: number, content: Uint8Array, binary: [number, number]) {
  const primitive = scene.at("meshes").at(mesh).at("primitives").at(0);
  primitive.get("mode")?.integer(TRIANGLES, TRIANGLES);
  const attributes = primitive.at("attributes");
  const position = accessor(scene, attributes.at("POSITION"), false);
  const normal = accessor(scene, attributes.at("NORMAL"), true);
  const index = accessor(scene, primitive.at("indices"), false);
  const vertices = numbers(scene, position, binary, "VEC3", POSITION_STRIDE);
  const directions = numbers(scene, normal, binary, "VEC3", NORMAL_STRIDE);
  const corners = numbers(scene, index, binary, "SCALAR", null);
  const vertexCount = vertices.count;
  if (
    vertices.componentType !== U16 ||
    directions.componentType !== I8 ||
    directions.count !== vertexCount ||
    corners.count % 3
  ) {
    throw new BadChunk(`${vertexCount} positions, ${directions.count} normals, ${corners.count} indices`);
  }
  const [low, high] = [triple(position.at("min")), triple(position.at("max"))];
  checkBounds(low, high);
  const [buffer, start] = [content.buffer, content.byteOffset];
  const indices =
    corners.componentType === U16
      ? new Uint16Array(buffer, start + corners.offset, corners.count)
      : new Uint32Array(buffer, start + corners.offset, corners.count);
  checkIndices(indices, vertexCount);
  return {
    profile: "std" as const,
    low,
    high,
    vertexCount,
    components: COMPONENTS as 4,
    positions: new Uint16Array(buffer, start + vertices.offset, COMPONENTS * vertexCount),
    normals: new Int8Array(buffer, start + directions.offset, COMPONENTS * vertexCount),
    indices,
  };
}

function accessor(scene: Json, number: Json, normalized: boolean): Json {
  const found = scene.at("accessors").at(number.integer(0, ACCESSORS_MAX));
  if ((found.get("normalized")?.boolean() ?? false) !== normalized) {
    found.refuse(`normalized to be ${normalized}`);
  }
  found.get("sparse")?.refuse("nothing");
  return found;
}

/** @param stride of a vertex, padding included, as the page has it; null if the numbers are packed. */
function numbers(scene: Json, accessor: Json, binary: [number, number], shape: string, stride: number | null): Numbers {
  const componentType = accessor.at("componentType").integer(I8, U32);
  if (![I8, U16, U32].includes(componentType as never) || accessor.at("type").text() !== shape) {
    accessor.at("type").refuse(`${shape} of a known component type`);
  }
  const count = accessor.at("count").integer(0, shape === "SCALAR" ? INDICES_MAX : VERTICES_MAX);
  const source = scene.at("bufferViews").at(accessor.at("bufferView").integer(0, ACCESSORS_MAX));
  source.at("buffer").integer(0, 0);
  const size = { [I8]: 1, [U16]: 2, [U32]: 4 }[componentType]!;
  if (stride !== null) {
    source.at("byteStride").integer(stride, stride);
  } else if (componentType === I8) {
    accessor.at("componentType").refuse(`${U16} or ${U32}`);
  } else {
    source.get("byteStride")?.integer(size, size);
  }
  const within = offsetOf(accessor) + count * (stride ?? size);
  const offset = binary[0] + offsetOf(source) + offsetOf(accessor);
  const byteLength = source.at("byteLength").integer(within, OFFSET_MAX);
  if (binary[0] + offsetOf(source) + byteLength > binary[1] || offset % size) {
    source.at("byteLength").refuse(`bytes within the BIN chunk, aligned to ${size}`);
  }
  return { componentType, count, offset };
}

function offsetOf(holder: Json): number {
  return holder.get("byteOffset")?.integer(0, OFFSET_MAX) ?? 0;
}

function triple(values: Json): Triple {
  const [x, y, z] = [0, 1, 2].map((axis) => values.at(axis).integer(0, POSITION_MAX));
  return [x!, y!, z!];
}

function same(some: readonly number[], others: readonly number[]): boolean {
  return some.length === others.length && some.every((value, at) => value === others[at]);
}
