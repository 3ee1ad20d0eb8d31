/** Noise for the ground, made at start: a height that repeats, and its slope. */

import {
  DataTexture,
  LinearFilter,
  LinearMipmapLinearFilter,
  RepeatWrapping,
  RGBAFormat,
  UnsignedByteType,
} from "three";

/** Height at u, v in [0, 1), the same one period further. */
type Field = (u: number, v: number) => number;

/** Texels a side. */
export const NOISE_SIZE = 256;
/** What a slope of 1, as bytes have it, is in heights per period. */
export const SLOPE_MAX = 24;

/** Soft and grainy, of soil and grass: octaves of gradient noise. */
export function soilNoise(seed: number): Uint8Array {
  return bytesOf(octaves(seed, 5, 6, 0.62, (value) => value));
}

/** With ridges and cracks, of rock: octaves of noise that is folded where it changes sign. */
export function rockNoise(seed: number): Uint8Array {
  return bytesOf(octaves(seed, 4, 6, 0.55, (value) => 0.7 - 1.9 * Math.abs(value)));
}

/** As a texture with all its mip levels: further away it fades to its mean by itself. */
export function textureOf(bytes: Uint8Array, anisotropy: number): DataTexture {
  const texture = new DataTexture(bytes, NOISE_SIZE, NOISE_SIZE, RGBAFormat, UnsignedByteType);
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.magFilter = LinearFilter;
  texture.minFilter = LinearMipmapLinearFilter;
  texture.generateMipmaps = true;
  texture.anisotropy = anisotropy;
  texture.needsUpdate = true;
  return texture;
}

/** Height, slope along u, slope along v, and the height without its finer octaves; each centred at 128. */
function bytesOf(fields: { readonly all: Field; readonly coarse: Field }): Uint8Array {
  const size = NOISE_SIZE;
  const [heights, coarse] = [fields.all, fields.coarse].map((field) => {
    const values = new Float32Array(size * size);
    for (let at = 0; at < values.length; at++) {
      values[at] = field((at % size) / size, Math.floor(at / size) / size);
    }
    return centred(values);
  });
  const bytes = new Uint8Array(4 * size * size);
  const slope = size / (2 * SLOPE_MAX);
  for (let at = 0; at < size * size; at++) {
    const [column, row] = [at % size, Math.floor(at / size)];
    const along = (u: number, v: number) => heights![((row + v + size) % size) * size + ((column + u + size) % size)]!;
    bytes[4 * at] = byteOf(heights![at]!);
    bytes[4 * at + 1] = byteOf((along(1, 0) - along(-1, 0)) * slope);
    bytes[4 * at + 2] = byteOf((along(0, 1) - along(0, -1)) * slope);
    bytes[4 * at + 3] = byteOf(coarse![at]!);
  }
  return bytes;
}

/** From -1 to 1 with a mean of 0, so that what mips make of it is neither lighter nor darker. */
function centred(values: Float32Array): Float32Array {
  const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
  const most = values.reduce((least, value) => Math.max(least, Math.abs(value - mean)), 0);
  return values.map((value) => (value - mean) / most);
}

function byteOf(value: number): number {
  return Math.max(0, Math.min(255, Math.round(128 + 127 * value)));
}

function octaves(seed: number, cells: number, count: number, gain: number, shape: (value: number) => number) {
  const layers = Array.from({ length: count }, (_, octave) => gradientNoise(seed + octave, cells * 2 ** octave));
  const sum = (upTo: number): Field => {
    return (u, v) =>
      layers.slice(0, upTo).reduce((height, layer, octave) => height + shape(layer(u, v)) * gain ** octave, 0);
  };
  return { all: sum(count), coarse: sum(2) };
}

/** Gradient noise over a lattice of `cells` by `cells`, with the fifth-order fade. */
function gradientNoise(seed: number, cells: number): Field {
  const random = randomOf(seed * 7919 + cells);
  const gradients = Array.from({ length: cells * cells }, () => {
    const angle = 2 * Math.PI * random();
    return [Math.cos(angle), Math.sin(angle)] as const;
  });
  const corner = (column: number, row: number, x: number, y: number) => {
    const [along, up] = gradients[(row % cells) * cells + (column % cells)]!;
    return along * x + up * y;
  };
  return (u, v) => {
    const [column, row] = [Math.floor(u * cells), Math.floor(v * cells)];
    const [x, y] = [u * cells - column, v * cells - row];
    const [fx, fy] = [fade(x), fade(y)];
    const low = mix(corner(column, row, x, y), corner(column + 1, row, x - 1, y), fx);
    const high = mix(corner(column, row + 1, x, y - 1), corner(column + 1, row + 1, x - 1, y - 1), fx);
    return mix(low, high, fy);
  };
}

function fade(x: number): number {
  return x * x * x * (x * (6 * x - 15) + 10);
}

function mix(from: number, to: number, share: number): number {
  return from + (to - from) * share;
}

/** Numbers in [0, 1), the same ones for the same seed: a linear congruential generator, its high bits. */
function randomOf(seed: number): () => number {
  let state = (Math.imul(seed, 2654435761) >>> 0) | 1;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return (state >>> 8) / 2 ** 24;
  };
}
