/**
 * What is the same all around a planet, drawn once into the faces of a cube: clouds, and how moist and how mixed the land
 * is. Gradient noise of three dimensions, so that nothing repeats; where clouds are, it is bent by itself.
 */

import {
  LinearFilter,
  LinearMipmapLinearFilter,
  Mesh,
  OrthographicCamera,
  PlaneGeometry,
  Scene,
  ShaderMaterial,
  WebGLCubeRenderTarget,
  type Texture,
  type WebGLRenderer,
} from "three";

import type { Quality } from "./quality.js";

/** What a shader needs to read it. */
export interface GlobeUniforms {
  [name: string]: { value: unknown };
  globe: { value: Texture };
}

/** Texels along an edge of the cube, and octaves of its noise. */
const SIZE: Readonly<Record<Quality, number>> = { high: 512, low: 128 };
const OCTAVES: Readonly<Record<Quality, number>> = { high: 7, low: 4 };
const FACES = 6;

/** `globe`: thickness of clouds, moisture, mixture, each from 0 to 1 with a mean of about a half. */
export class Globe {
  readonly uniforms: GlobeUniforms;
  private readonly target: WebGLCubeRenderTarget;
  private isDrawn = false;

  constructor(private readonly quality: Quality) {
    this.target = new WebGLCubeRenderTarget(SIZE[quality], {
      minFilter: LinearMipmapLinearFilter,
      magFilter: LinearFilter,
      generateMipmaps: true,
      depthBuffer: false,
    });
    this.uniforms = { globe: { value: this.target.texture } };
  }

  /** Texels in a radian, about. */
  get texels(): number {
    return (SIZE[this.quality] * 2) / Math.PI;
  }

  /** The graphics card has lost it. */
  outdate(): void {
    this.isDrawn = false;
  }

  /** Draws it, if that has not been done. */
  update(renderer: WebGLRenderer): void {
    if (this.isDrawn) {
      return;
    }
    this.isDrawn = true;
    const face = { value: 0 };
    const material = new ShaderMaterial({
      uniforms: { face },
      defines: { OCTAVES: OCTAVES[this.quality] },
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      depthTest: false,
      depthWrite: false,
      toneMapped: false,
    });
    const quad = new Mesh(new PlaneGeometry(2, 2), material);
    quad.frustumCulled = false;
    const scene = new Scene();
    scene.add(quad);
    const camera = new OrthographicCamera(-1, 1, 1, -1, 0, 1);
    const before = renderer.getRenderTarget();
    const texture = this.target.texture;
    for (let number = 0; number < FACES; number++) {
      face.value = number;
      texture.generateMipmaps = number === FACES - 1;
      renderer.setRenderTarget(this.target, number);
      renderer.render(scene, camera);
    }
    renderer.setRenderTarget(before);
    quad.geometry.dispose();
    material.dispose();
  }

  dispose(): void {
    this.target.dispose();
  }
}

const VERTEX = /* glsl */ `
varying vec2 place;
void main() {
  place = position.xy;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}
`;

const FRAGMENT = /* glsl */ `
precision highp int;
varying vec2 place;
uniform int face;

/** Three numbers from -1 to 1 for a lattice point. The factors are odd and large: all bits of a coordinate count. */
vec3 chance(ivec3 cell) {
  uvec3 bits = uvec3(cell) * uvec3(2654435769u, 2246822519u, 3266489917u);
  uint all = bits.x ^ (bits.y >> 3) ^ (bits.y << 29) ^ (bits.z >> 7) ^ (bits.z << 25);
  uvec3 three = (uvec3(all) + uvec3(0u, 1013904223u, 2027808446u)) * 2654435769u;
  three ^= three >> 15;
  three *= 2246822519u;
  three ^= three >> 13;
  return vec3(three >> 8) / 8388608.0 - 1.0;
}

float corner(ivec3 cell, vec3 inside, ivec3 at) {
  return dot(chance(cell + at), inside - vec3(at));
}

/** Gradient noise with the fifth-order fade. */
float noise(vec3 at) {
  vec3 low = floor(at);
  ivec3 cell = ivec3(low);
  vec3 inside = at - low;
  vec3 share = inside * inside * inside * (inside * (6.0 * inside - 15.0) + 10.0);
  vec4 near = vec4(
    corner(cell, inside, ivec3(0, 0, 0)), corner(cell, inside, ivec3(0, 1, 0)),
    corner(cell, inside, ivec3(0, 0, 1)), corner(cell, inside, ivec3(0, 1, 1)));
  vec4 far = vec4(
    corner(cell, inside, ivec3(1, 0, 0)), corner(cell, inside, ivec3(1, 1, 0)),
    corner(cell, inside, ivec3(1, 0, 1)), corner(cell, inside, ivec3(1, 1, 1)));
  vec4 x = mix(near, far, share.x);
  vec2 y = mix(x.xz, x.yw, share.y);
  return mix(y.x, y.y, share.z);
}

/** The turn between octaves keeps their lattices apart. */
float octaves(vec3 at, int count, float gain) {
  const mat3 turn = mat3(0.0, 0.8, 0.6, -0.8, 0.36, -0.48, -0.6, -0.48, 0.64);
  float sum = 0.0;
  float height = 1.0;
  for (int octave = 0; octave < OCTAVES; octave++) {
    if (octave >= count) break;
    sum += height * noise(at);
    height *= gain;
    at = turn * at * 2.03 + 7.1;
  }
  return sum;
}

vec3 towards() {
  float s = place.x;
  float t = place.y;
  if (face == 0) return vec3(1.0, -t, -s);
  if (face == 1) return vec3(-1.0, -t, s);
  if (face == 2) return vec3(s, 1.0, t);
  if (face == 3) return vec3(s, -1.0, -t);
  if (face == 4) return vec3(s, -t, 1.0);
  return vec3(-s, -t, -1.0);
}

void main() {
  vec3 ahead = normalize(towards());
  // weather: carried around by winds that turn, in bands along the equator and at middle latitudes
  vec3 winds = vec3(octaves(ahead * 2.1 + 3.0, 3, 0.5), octaves(ahead * 2.1 + 31.0, 3, 0.5), octaves(ahead * 2.1 + 57.0, 3, 0.5));
  vec3 carried = ahead + 0.36 * cross(ahead, winds);
  vec3 finer = vec3(octaves(carried * 6.0 + 11.0, 2, 0.5), octaves(carried * 6.0 + 41.0, 2, 0.5), octaves(carried * 6.0 + 71.0, 2, 0.5));
  carried += 0.05 * finer;
  float latitude = abs(ahead.y);
  float band = 0.10 * cos(latitude * 9.0) - 0.05 * latitude;
  float broad = octaves(carried * vec3(2.3, 3.1, 2.3), 3, 0.5);
  float clouds = 0.5 + 0.55 * broad + 0.50 * octaves(carried * 7.0 + 5.0, OCTAVES, 0.66) + band;
  float moist = 0.5 + 0.75 * octaves(ahead * 2.7 + 17.0, OCTAVES, 0.55);
  float mixed = 0.5 + 0.6 * octaves(ahead * 11.0 + 23.0, OCTAVES, 0.62);
  gl_FragColor = vec4(clouds, moist, mixed, 1.0);
}
`;
