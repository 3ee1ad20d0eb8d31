/**
 * The native chunk format, version 1, from bytes to arrays: docs/wire/native-v1.md.
 *
 *     header, 96 bytes | block table, 16 bytes a block | positions | normals | indices
 */

import { BadChunk } from "./errors.js";
import {
  COARSER_MAX,
  CONTENTS,
  INDICES_MAX,
  POSITION_LOW,
  POSITION_MAX,
  REVISION_MAX,
  VERTICES_MAX,
  checkBounds,
  checkIndices,
  checkPlace,
  emptyMesh,
  unitOf,
  type ChunkMesh,
  type Place,
  type Profile,
  type Triple,
} from "./mesh.js";

const MAGIC = 0x4b4e4843; // "CHNK"
const VERSION = 1;
const HEADER_BYTES_MIN = 96;
const BLOCK_BYTES = 16;
const ALIGNMENT = 16;
const PROFILES: readonly Profile[] = ["std", "f32"];
const [POSITIONS, NORMALS, INDICES] = [1, 2, 3] as const;
const NOT_STATED = -1;
/** Of a component in float32: a unit vector's, and more than any rounding. */
const NORMAL_MAX = 1.001;

type View = Int8Array | Uint16Array | Uint32Array | Float32Array;

/** What a block of one kind has to be. */
interface Kind {
  readonly componentType: number;
  readonly components: number;
  readonly stride: number;
  view(content: Uint8Array, offset: number, length: number): View;
}

const i8: Kind["view"] = (content, offset, length) =>
  new Int8Array(content.buffer, content.byteOffset + offset, length);
const u16: Kind["view"] = (content, offset, length) =>
  new Uint16Array(content.buffer, content.byteOffset + offset, length);
const u32: Kind["view"] = (content, offset, length) =>
  new Uint32Array(content.buffer, content.byteOffset + offset, length);
const f32: Kind["view"] = (content, offset, length) =>
  new Float32Array(content.buffer, content.byteOffset + offset, length);

const U16_4: Kind = { componentType: 5123, components: 4, stride: 8, view: u16 };
const I8_4: Kind = { componentType: 5120, components: 4, stride: 4, view: i8 };
const F32_3: Kind = { componentType: 5126, components: 3, stride: 12, view: f32 };
const U16_1: Kind = { componentType: 5123, components: 1, stride: 2, view: u16 };
const U32_1: Kind = { componentType: 5125, components: 1, stride: 4, view: u32 };

/** By profile and bytes of an index. */
const KINDS: Readonly<Record<string, Readonly<Record<number, Kind>>>> = {
  std2: { [POSITIONS]: U16_4, [NORMALS]: I8_4, [INDICES]: U16_1 },
  std4: { [POSITIONS]: U16_4, [NORMALS]: I8_4, [INDICES]: U32_1 },
  f324: { [POSITIONS]: F32_3, [NORMALS]: F32_3, [INDICES]: U32_1 },
};

interface Header {
  readonly place: Place;
  readonly headerBytes: number;
  readonly revision: bigint;
  readonly vertexCount: number;
  readonly indexCount: number;
  readonly geometricError: number | null;
  readonly profile: number;
  readonly coarser: number;
  readonly content: number;
  readonly indexBytes: number;
  readonly blockCount: number;
  readonly low: Triple;
  readonly high: Triple;
}

/**
 * The mesh in `content`, a whole file that starts on a multiple of 4 of its buffer.
 *
 * @throws {BadChunk} whatever the bytes are; nothing else.
 */
export function decodeNative(content: Uint8Array): ChunkMesh {
  const header = readHeader(content);
  const { place, revision, coarser, geometricError, vertexCount, indexCount, blockCount, low, high } = header;
  const what = CONTENTS[header.content]!;
  if (what !== "surface") {
    if (vertexCount || indexCount || blockCount) {
      throw new BadChunk(`content is ${what}, but there are ${vertexCount} vertices`);
    }
    return emptyMesh(place, { content: what, revision, coarser, geometricError });
  }
  const profile = PROFILES[header.profile]!;
  const blocks = readBlocks(content, header, profile);
  const positions = blocks[POSITIONS] as Uint16Array | Float32Array;
  const normals = blocks[NORMALS] as Int8Array | Float32Array;
  const indices = blocks[INDICES] as Uint16Array | Uint32Array;
  if (profile === "f32") {
    const unit = unitOf(place);
    checkFloats(positions, -POSITION_LOW * unit, (POSITION_MAX - POSITION_LOW) * unit, "position");
    checkFloats(normals, -NORMAL_MAX, NORMAL_MAX, "normal");
  }
  checkIndices(indices, vertexCount);
  const components = profile === "f32" ? 3 : 4;
  return {
    ...place,
    content: what,
    revision,
    coarser,
    geometricError,
    profile,
    low,
    high,
    vertexCount,
    components,
    positions,
    normals,
    indices,
  };
}

function readHeader(content: Uint8Array): Header {
  if (content.length < HEADER_BYTES_MIN) {
    throw new BadChunk(`${content.length} bytes: a header has ${HEADER_BYTES_MIN}`);
  }
  const view = new DataView(content.buffer, content.byteOffset, content.byteLength);
  const [magic, version] = [view.getUint32(0, true), view.getUint16(4, true)];
  if (magic !== MAGIC || version !== VERSION) {
    throw new BadChunk(`begins with ${hex(magic)} ${version}: expected ${hex(MAGIC)} ${VERSION}`);
  }
  const fileBytes = view.getUint32(68, true);
  if (fileBytes !== content.length) {
    throw new BadChunk(`file_bytes is ${fileBytes}: there are ${content.length}`);
  }
  const indexCount = atMost("index_count", view.getUint32(52, true), INDICES_MAX);
  if (indexCount % 3) {
    throw new BadChunk(`index_count is ${indexCount}: three a triangle`);
  }
  const stated = view.getFloat32(56, true);
  if (stated !== NOT_STATED && !(Number.isFinite(stated) && stated >= 0)) {
    throw new BadChunk(`geometric_error is ${stated}: metres, or -1 where it is not stated`);
  }
  const revision = view.getBigUint64(32, true);
  if (revision > REVISION_MAX) {
    throw new BadChunk(`revision is ${revision}: at most ${REVISION_MAX}`);
  }
  const triple = (offset: number): Triple => [
    view.getUint16(offset, true),
    view.getUint16(offset + 2, true),
    view.getUint16(offset + 4, true),
  ];
  const key = { lod: view.getUint8(62), x: place64(view, 8), y: place64(view, 16), z: place64(view, 24) };
  const place = { key, cells: view.getUint16(60, true), voxelSize: view.getFloat64(40, true) };
  checkPlace(place);
  const header = {
    place,
    headerBytes: view.getUint16(6, true),
    revision,
    vertexCount: atMost("vertex_count", view.getUint32(48, true), VERTICES_MAX),
    indexCount,
    geometricError: stated === NOT_STATED ? null : stated,
    profile: atMost("profile", view.getUint8(63), PROFILES.length - 1),
    coarser: atMost("coarser", view.getUint8(64), COARSER_MAX),
    content: atMost("content", view.getUint8(65), CONTENTS.length - 1),
    indexBytes: view.getUint8(66),
    blockCount: view.getUint8(67),
    low: triple(72),
    high: triple(78),
  };
  checkBounds(header.low, header.high);
  return header;
}

/** The blocks by their kind, as they stand in the file. */
function readBlocks(content: Uint8Array, header: Header, profile: Profile): Record<number, View> {
  const kinds = KINDS[`${profile}${header.indexBytes}`];
  if (kinds === undefined) {
    throw new BadChunk(`index_bytes is ${header.indexBytes} in profile ${profile}`);
  }
  const end = header.headerBytes + BLOCK_BYTES * header.blockCount;
  if (header.headerBytes < HEADER_BYTES_MIN || end > content.length) {
    throw new BadChunk(`a table of ${header.blockCount} blocks at ${header.headerBytes}: beyond the file`);
  }
  const counts: Record<number, number> = {
    [POSITIONS]: header.vertexCount,
    [NORMALS]: header.vertexCount,
    [INDICES]: header.indexCount,
  };
  const found: Record<number, View> = {};
  for (let row = 0; row < header.blockCount; row++) {
    const at = new DataView(content.buffer, content.byteOffset + header.headerBytes + BLOCK_BYTES * row, BLOCK_BYTES);
    const number = at.getUint16(0, true);
    const kind = kinds[number];
    if (kind === undefined) {
      continue; // a later writer's
    }
    const entry = [at.getUint16(2, true), at.getUint16(4, true), at.getUint16(6, true)];
    if (found[number] !== undefined || entry.join() !== [kind.componentType, kind.components, kind.stride].join()) {
      throw new BadChunk(`block ${row} of kind ${number} has type, components, stride ${entry.join(", ")}`);
    }
    const [offset, byteLength] = [at.getUint32(8, true), at.getUint32(12, true)];
    const fits = offset % ALIGNMENT === 0 && offset >= end && offset + byteLength <= content.length;
    if (!fits || byteLength !== counts[number]! * kind.stride) {
      throw new BadChunk(`block ${row} of kind ${number} has ${byteLength} bytes at ${offset}`);
    }
    found[number] = kind.view(content, offset, counts[number]! * kind.components);
  }
  const missing = Object.keys(kinds).filter((number) => found[Number(number)] === undefined);
  if (missing.length) {
    throw new BadChunk(`no block of kind ${missing.join(", ")}`);
  }
  return found;
}

/** A chunk coordinate; beyond 2^53 it is rounded, and refused with its place. */
function place64(view: DataView, offset: number): number {
  return Number(view.getBigInt64(offset, true));
}

function atMost(name: string, value: number, highest: number): number {
  if (value > highest) {
    throw new BadChunk(`${name} is ${value}: at most ${highest}`);
  }
  return value;
}

/** Refuses a number outside, or one that is none: every comparison with NaN is false. */
function checkFloats(values: View, low: number, high: number, what: string): void {
  for (let at = 0; at < values.length; at++) {
    if (!(values[at]! >= low && values[at]! <= high)) {
      throw new BadChunk(`a ${what} is ${values[at]}: a number from ${low} to ${high}`);
    }
  }
}

function hex(value: number): string {
  return `0x${value.toString(16)}`;
}
