/** Noise for the ground, made at start, octave by octave: a height that repeats, and its slope. */

import {
  DataTexture,
  LinearFilter,
  LinearMipmapLinearFilter,
  RepeatWrapping,
  RGBAFormat,
  UnsignedByteType,
} from "three";

/** Row after row; `coarse` is that of the first two octaves. */
interface Heights {
  readonly all: Float32Array;
  readonly coarse: Float32Array;
}

/** Noise under way: of each texel four bytes, in the end. */
type Making = Generator<undefined, Uint8Array, undefined>;

/** Texels a side. */
export const NOISE_SIZE = 256;
/** What a slope of 1, as bytes have it, is in heights per period. */
export const SLOPE_MAX = 24;

/** Soft and grainy, of soil and grass: octaves of gradient noise. */
export function* soilNoise(seed: number): Making {
  return bytesOf(yield* octaves(seed, 5, 6, 0.62, (value) => value));
}

/** With ridges and cracks, of rock: octaves of noise that is folded where it changes sign. */
export function* rockNoise(seed: number): Making {
  return bytesOf(yield* octaves(seed, 4, 6, 0.55, (value) => 0.7 - 1.9 * Math.abs(value)));
}

/** Makes it in as many tasks as it has octaves: frames are drawn in between. */
export async function inTasks(making: Making): Promise<Uint8Array> {
  for (;;) {
    const step = making.next();
    if (step.done === true) {
      return step.value;
    }
    await new Promise((resolve) => setTimeout(resolve));
  }
}

/** Ground without any noise, to be seen before there is some. */
export function noNoise(): Uint8Array {
  return new Uint8Array(4 * NOISE_SIZE * NOISE_SIZE).fill(byteOf(0));
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

/** Shows other bytes from now on. */
export function fill(texture: DataTexture, bytes: Uint8Array): void {
  texture.image.data!.set(bytes);
  texture.needsUpdate = true;
}

/** Height, slope along u, slope along v, and the height without its finer octaves; each centred at 128. */
function bytesOf({ all, coarse }: Heights): Uint8Array {
  const size = NOISE_SIZE;
  const [heights, low] = [centred(all), centred(coarse)];
  const bytes = new Uint8Array(4 * size * size);
  const slope = size / (2 * SLOPE_MAX);
  for (let row = 0; row < size; row++) {
    const [above, below] = [((row + 1) % size) * size, ((row + size - 1) % size) * size];
    for (let column = 0; column < size; column++) {
      const at = row * size + column;
      const [right, left] = [row * size + ((column + 1) % size), row * size + ((column + size - 1) % size)];
      bytes[4 * at] = byteOf(heights[at]!);
      bytes[4 * at + 1] = byteOf((heights[right]! - heights[left]!) * slope);
      bytes[4 * at + 2] = byteOf((heights[above + column]! - heights[below + column]!) * slope);
      bytes[4 * at + 3] = byteOf(low[at]!);
    }
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

/** Octaves over a lattice of `cells` by `cells`, each twice as fine and `gain` times as high as the one before. */
function* octaves(
  seed: number,
  cells: number,
  count: number,
  gain: number,
  shape: (value: number) => number,
): Generator<undefined, Heights, undefined> {
  const all = new Float32Array(NOISE_SIZE * NOISE_SIZE);
  let coarse = all;
  for (let octave = 0; octave < count; octave++) {
    addGradientNoise(all, seed + octave, cells * 2 ** octave, gain ** octave, shape);
    if (octave === 1) {
      coarse = all.slice();
    }
    yield;
  }
  return { all, coarse };
}

/** Gradient noise with the fifth-order fade. */
function addGradientNoise(
  sum: Float32Array,
  seed: number,
  cells: number,
  height: number,
  shape: (value: number) => number,
): void {
  const random = randomOf(seed * 7919 + cells);
  const gradients = new Float32Array(2 * cells * cells);
  for (let at = 0; at < cells * cells; at++) {
    const angle = 2 * Math.PI * random();
    gradients[2 * at] = Math.cos(angle);
    gradients[2 * at + 1] = Math.sin(angle);
  }
  for (let row = 0; row < NOISE_SIZE; row++) {
    const v = (row / NOISE_SIZE) * cells;
    const low = Math.floor(v);
    const [y, lowRow, highRow] = [v - low, low * cells, ((low + 1) % cells) * cells];
    const fy = fade(y);
    for (let column = 0; column < NOISE_SIZE; column++) {
      const u = (column / NOISE_SIZE) * cells;
      const left = Math.floor(u);
      const x = u - left;
      const right = (left + 1) % cells;
      const [a, b, c, d] = [2 * (lowRow + left), 2 * (lowRow + right), 2 * (highRow + left), 2 * (highRow + right)];
      const fx = fade(x);
      const below = mix(gradients[a]! * x + gradients[a + 1]! * y, gradients[b]! * (x - 1) + gradients[b + 1]! * y, fx);
      const above = mix(
        gradients[c]! * x + gradients[c + 1]! * (y - 1),
        gradients[d]! * (x - 1) + gradients[d + 1]! * (y - 1),
        fx,
      );
      const at = row * NOISE_SIZE + column;
      sum[at] = sum[at]! + height * shape(mix(below, above, fy));
    }
  }
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
