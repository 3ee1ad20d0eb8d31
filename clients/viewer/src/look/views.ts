/** The views that show how a world is made: its triangles, its levels of detail, its normals. */

import type { ChunkMesh } from "chunkserver-client";
import { placed } from "chunkserver-client/three";
import { Color, ShaderMaterial, Vector3, type Material } from "three";

import { LEVELS, srgb } from "./palette.js";

/** What is behind the ground where there is no sky. */
export const BACKGROUND = new Color(0x11161d);

/** Lattice units of a chunk's side: docs/wire. */
const UNITS_PER_SIDE = 32768;

/** The materials of three views. */
export interface ViewMaterials {
  /** Lines, in the colour of their level. */
  readonly lines: Material;
  /** What hides the lines behind it. */
  readonly hidden: Material;
  readonly levels: Material;
  readonly normals: Material;
}

/** @param cellUnits width of a cell of any level, in the units of positions */
export function viewMaterials(cellUnits: { value: number }): ViewMaterials {
  const uniforms = { cellUnits, palette: { value: LEVELS.map((hex) => new Vector3(...srgb(hex))) } };
  const material = (fragmentShader: string, more: object = {}) =>
    placed(new ShaderMaterial({ uniforms, vertexShader: VERTEX, fragmentShader, toneMapped: false, ...more }));
  return {
    lines: material(LINES, { wireframe: true }),
    hidden: material(HIDDEN, { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }),
    levels: material(LEVELS_FRAGMENT),
    normals: material(NORMALS),
  };
}

/** Of the world that a chunk is of. */
export function cellUnitsOf(chunk: Pick<ChunkMesh, "cells">): number {
  return UNITS_PER_SIDE / chunk.cells;
}

const VERTEX = /* glsl */ `
#include <common>
#include <logdepthbuf_pars_vertex>
varying vec3 place;
varying vec3 outwards;
varying vec3 cell;
varying float level;
uniform float cellUnits;
void main() {
  #include <begin_vertex>
  vec4 world = modelMatrix * vec4(transformed, 1.0);
  place = world.xyz;
  outwards = normal;
  cell = position / cellUnits;
  level = log2(chunkPlace.w);
  gl_Position = projectionMatrix * (viewMatrix * world);
  #include <logdepthbuf_vertex>
}
`;

const FRAGMENT = /* glsl */ `
#include <common>
#include <logdepthbuf_pars_fragment>
varying vec3 place;
varying vec3 outwards;
varying vec3 cell;
varying float level;
uniform vec3 palette[${LEVELS.length}];

vec3 colourOf(float level) {
  return palette[int(mod(level + 0.5, ${LEVELS.length}.0))];
}

/** The plane that a triangle is in. */
vec3 facet() {
  return normalize(cross(dFdx(place), dFdy(place)));
}
`;

const LINES = /* glsl */ `
${FRAGMENT}
void main() {
  #include <logdepthbuf_fragment>
  float facing = 0.6 + 0.4 * abs(dot(normalize(outwards), normalize(cameraPosition - place)));
  gl_FragColor = vec4(mix(colourOf(level), vec3(1.0), 0.12) * facing, 1.0);
  #include <colorspace_fragment>
}
`;

const HIDDEN = /* glsl */ `
${FRAGMENT}
void main() {
  #include <logdepthbuf_fragment>
  float facing = abs(dot(facet(), normalize(cameraPosition - place)));
  gl_FragColor = vec4(mix(vec3(0.006, 0.008, 0.012), colourOf(level) * 0.05, facing), 1.0);
  #include <colorspace_fragment>
}
`;

const LEVELS_FRAGMENT = /* glsl */ `
${FRAGMENT}
/** Lines where the surface goes from cell to cell, as far as they are further apart than a few pixels. */
float lines() {
  vec3 face = facet();
  vec3 width = fwidth(cell);
  vec3 away = abs(fract(cell + 0.5) - 0.5) / max(width, 1e-6);
  vec3 seen = (1.0 - smoothstep(0.5, 1.3, away)) * (1.0 - smoothstep(0.12, 0.35, width));
  seen *= smoothstep(0.08, 0.25, 1.0 - abs(face));
  return max(seen.x, max(seen.y, seen.z));
}
void main() {
  #include <logdepthbuf_fragment>
  vec3 face = facet();
  float light = 0.30 + 0.42 * max(dot(face, normalize(vec3(0.5, 0.75, 0.35))), 0.0) + 0.28 * (0.5 + 0.5 * dot(normalize(outwards), normalize(cameraPosition - place)));
  vec3 colour = colourOf(level) * light;
  gl_FragColor = vec4(colour * (1.0 - 0.45 * lines()), 1.0);
  #include <colorspace_fragment>
}
`;

const NORMALS = /* glsl */ `
${FRAGMENT}
void main() {
  #include <logdepthbuf_fragment>
  gl_FragColor = vec4(normalize(outwards) * 0.5 + 0.5, 1.0);
}
`;
