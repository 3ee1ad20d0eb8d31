/** The ground as it looks by daylight: what grows where, its detail, light, shadow and the air before it. */

import { placed } from "chunkserver-client/three";
import { ShaderMaterial, Vector3, type Texture } from "three";

import { AIR, type AirUniforms } from "./air.js";
import { CITY } from "./city.js";
import { CLIMATE } from "./climate.js";
import { CLOUDS, type CloudUniforms } from "./clouds.js";
import type { GlobeUniforms } from "./globe.js";
import { OPENNESS, type OpennessUniforms } from "./openness.js";
import type { Ground } from "./palette.js";
import { PERIOD, TURNS } from "./period.js";
import { SEA, type SeaUniforms } from "./sea.js";
import { HAZE, SKY, type SkyUniforms } from "./sky.js";
import { SHADOW, type ShadowUniforms } from "./shadows.js";
import type { Quality } from "./quality.js";
import { SLOPE_MAX } from "./noise.js";

/** What changes with the viewer. */
export interface GroundUniforms {
  [name: string]: { value: unknown };
  /** What is left of the anchor modulo PERIOD, metres. */
  anchorLeft: { value: Vector3 };
  /** The same modulo STREETS_PERIOD. */
  streetsLeft: { value: Vector3 };
  /** The middle of a planet or a ring in the scene; of a flat world, its y is where height 0 is. Metres. */
  middle: { value: Vector3 };
  /** From where the ground is seen as hazy as the sky behind it, metres. */
  visibility: { value: number };
}

export type Defines = Readonly<Record<string, number | string>>;

/** What is told to the shaders of the ground and the sky alike: which parts of them a world needs. */
export function definesOf(ground: Ground, isPlanet: boolean, quality: Quality): Defines {
  const has = (name: string, is: boolean): Defines => (is ? { [name]: 1 } : {});
  return {
    DRYER: isPlanet && !ground.hasClimate ? "0.02" : "0.0",
    AIR_STEPS: quality === "high" ? 5 : 2,
    ...has("PLANET", isPlanet),
    ...has("CITY", ground.isCity),
    ...has("RING", ground.isRing && !isPlanet),
    ...has("FINE", quality === "high"),
    ...has("SEA", ground.sea !== null),
    ...has("CLOUDS", isPlanet && ground.clouds !== null),
    ...has("CLIMATE", isPlanet && ground.hasClimate),
  };
}

/** Everything the ground is drawn with. */
export interface GroundParts {
  readonly ground: Ground;
  readonly own: GroundUniforms;
  readonly air: AirUniforms;
  readonly sky: SkyUniforms;
  readonly shadow: ShadowUniforms;
  readonly openness: OpennessUniforms;
  readonly sea: SeaUniforms;
  readonly clouds: CloudUniforms;
  readonly globe: GlobeUniforms;
  readonly rock: Texture;
  readonly soil: Texture;
  /** Metres; null for a flat world. */
  readonly radius: number | null;
  readonly voxelSize: number;
  readonly defines: Defines;
}

/** The material of all chunks in daylight. */
export function groundMaterial(parts: GroundParts): ShaderMaterial {
  const { ground, radius } = parts;
  const uniforms = {
    ...parts.own,
    ...parts.air,
    ...parts.sky,
    ...parts.shadow,
    ...parts.openness,
    ...parts.sea,
    ...parts.clouds,
    ...parts.globe,
    rockNoise: { value: parts.rock },
    soilNoise: { value: parts.soil },
    rockColour: { value: new Vector3(...ground.rock) },
    rockLayerColour: { value: new Vector3(...ground.rockLayer) },
    grassColour: { value: new Vector3(...ground.grass) },
    grassDryColour: { value: new Vector3(...ground.grassDry) },
    sandColour: { value: new Vector3(...ground.sand) },
    soilColour: { value: new Vector3(...ground.soil) },
    lowColour: { value: new Vector3(...ground.low) },
    snowColour: { value: new Vector3(...ground.snow) },
    lowBelow: { value: ground.lowBelow },
    snowAbove: { value: ground.snowAbove },
    grassSlope: { value: ground.grassSlope },
    layers: { value: ground.layers },
    roughness: { value: ground.roughness },
    radius: { value: radius ?? 0 },
    voxelSize: { value: parts.voxelSize },
  };
  const defines = { ...parts.defines };
  return placed(
    new ShaderMaterial({ uniforms, defines, vertexShader: VERTEX, fragmentShader: FRAGMENT, dithering: true }),
  );
}

/** Puts chunks where they are, and says where that is, in metres, and which way the surface looks. */
export const VERTEX = /* glsl */ `
#include <common>
#include <logdepthbuf_pars_vertex>
varying vec3 place;
varying vec3 outwards;
void main() {
  #include <begin_vertex>
  vec4 world = modelMatrix * vec4(transformed, 1.0);
  place = world.xyz;
  outwards = normal;
  gl_Position = projectionMatrix * (viewMatrix * world);
  #include <logdepthbuf_vertex>
}
`;

const turns = TURNS.map(([a, b]) => `mat2(${a}.0, ${b}.0, ${-b}.0, ${a}.0) / ${PERIOD}.0`);

const FRAGMENT = /* glsl */ `
#include <common>
#include <dithering_pars_fragment>
#include <logdepthbuf_pars_fragment>
varying vec3 place;
varying vec3 outwards;
uniform vec3 anchorLeft;
uniform vec3 streetsLeft;
uniform vec3 middle;
uniform sampler2D rockNoise;
uniform sampler2D soilNoise;
uniform vec3 rockColour;
uniform vec3 rockLayerColour;
uniform vec3 grassColour;
uniform vec3 grassDryColour;
uniform vec3 sandColour;
uniform vec3 soilColour;
uniform vec3 lowColour;
uniform vec3 snowColour;
uniform float lowBelow;
uniform float snowAbove;
uniform float grassSlope;
uniform float layers;
uniform float roughness;
uniform float radius;
uniform float voxelSize;
${AIR}
${SKY}
${HAZE}
${SHADOW}
${OPENNESS}
${CLOUDS}
${SEA}
${CLIMATE}

/** A texture on one plane: height, slope along the plane's axes, coarse height. */
vec4 plane(sampler2D noise, vec2 at, vec2 dx, vec2 dy, mat2 turn) {
  vec4 found = textureGrad(noise, turn * at, turn * dx, turn * dy) * 2.0 - 1.0039;
  return vec4(found.x, found.yz * turn, found.w);
}

struct Detail {
  float height;
  float coarse;
  vec3 slope;
};

vec3 dx;
vec3 dy;

/** The same texture from three sides, where a side is seen at all. */
Detail triplanar(sampler2D noise, vec3 at, vec3 weights, mat2 turn) {
  Detail all = Detail(0.0, 0.0, vec3(0.0));
  if (weights.x > 0.01) {
    vec4 one = weights.x * plane(noise, at.yz, dx.yz, dy.yz, turn);
    all.height += one.x; all.coarse += one.w; all.slope.yz += one.yz;
  }
  if (weights.y > 0.01) {
    vec4 one = weights.y * plane(noise, at.zx, dx.zx, dy.zx, turn);
    all.height += one.x; all.coarse += one.w; all.slope.zx += one.yz;
  }
  if (weights.z > 0.01) {
    vec4 one = weights.z * plane(noise, at.xy, dx.xy, dy.xy, turn);
    all.height += one.x; all.coarse += one.w; all.slope.xy += one.yz;
  }
  return all;
}

Detail faded(Detail one, float share) {
  return Detail(one.height * share, one.coarse * share, one.slope * share);
}

vec3 sides(vec3 normal) {
  vec3 weights = max(abs(normal) - 0.2, 0.0);
  weights *= weights * weights;
  return weights / (weights.x + weights.y + weights.z);
}

${CITY}
void main() {
  #include <logdepthbuf_fragment>
  vec3 normal = normalize(outwards);
  vec3 toEye = cameraPosition - place;
  float far = length(toEye);
  vec3 view = toEye / far;
#ifdef PLANET
  vec3 fromMiddle = place - middle;
  float rise = length(fromMiddle);
  vec3 up = fromMiddle / rise;
  float height = (rise - radius) / voxelSize;
#elif defined(RING)
  vec3 up = -normalize(vec3(place.x - middle.x, 0.0, place.z - middle.z));
  float height = 0.0;
#else
  vec3 up = vec3(0.0, 1.0, 0.0);
  float height = (place.y - middle.y) / voxelSize;
#endif
  float slope = dot(normal, up);
  vec3 at = place + anchorLeft;
  dx = dFdx(place);
  dy = dFdy(place);
  vec3 weights = sides(normal);
#ifndef FINE
  // one side almost everywhere; two or three in a narrow band, or edges between them would be seen
  vec3 faces = abs(normal);
  weights = max(faces - max(faces.x, max(faces.y, faces.z)) + 0.06, 0.0);
  weights /= weights.x + weights.y + weights.z;
#endif

  // a texture is no longer seen where its period is a few pixels: what is left of it would only repeat
  float pixel = max(length(dx), length(dy));
  vec4 seen = 1.0 - smoothstep(vec4(1.2, 0.25, 0.09, 0.03), vec4(5.0, 1.1, 0.5, 0.2), vec4(pixel));
  Detail vast = faded(triplanar(soilNoise, at, weights, ${turns[0]}), 1.0 - smoothstep(5.0, 22.0, pixel));
  Detail wide = faded(triplanar(soilNoise, at, weights, ${turns[1]}), seen.x);
  Detail mid = faded(triplanar(soilNoise, at, weights, ${turns[2]}), seen.y);
  float patches = vast.height * 0.4 + wide.height * 0.5 + mid.height * 0.25;

  // what grows where; edges between are broken up by noise
  float rugged = mid.height * 0.10 + wide.height * 0.05;
#ifdef CITY
  vec3 building = (place + streetsLeft) / voxelSize;
#endif
  float open = openness(place, normal, up);
  float grass = smoothstep(grassSlope - 0.10, grassSlope + 0.06, slope + rugged) * smoothstep(0.2, 0.5, open);
#ifdef CITY
  float low = 1.0 - smoothstep(lowBelow - 0.5, lowBelow + 0.5, height);
#else
  float low = 1.0 - smoothstep(lowBelow - 1.0, lowBelow + 1.5, height + wide.height * 6.0 + mid.height * 2.0);
#endif
#ifdef CLIMATE
  low *= 1.0 - 0.8 * smoothstep(4.0, 40.0, pixel);
#endif
  float bare = smoothstep(grassSlope - 0.24, grassSlope - 0.06, slope + rugged * 1.4) * (1.0 - grass);
  float snowLine = snowAbove + wide.height * 9.0 + mid.height * 5.0;
#if defined(CLIMATE)
  vec4 weather = texture(globe, fromMiddle);
  snowLine = snowLineAt(abs(up.y), weather.b) + (vast.height + wide.height) * 22.0 + mid.height * 8.0;
  float snow = smoothstep(-14.0, 18.0, height - snowLine) * smoothstep(0.52, 0.80, slope + rugged);
#elif defined(PLANET)
  snowLine += 26.0 - 52.0 * smoothstep(0.62, 1.0, abs(up.y) + wide.height * 0.10 + mid.height * 0.03);
  float snow = smoothstep(-3.0, 5.0, height - snowLine) * smoothstep(0.42, 0.72, slope + rugged);
#else
  float snow = smoothstep(-2.0, 3.0, height - snowLine) * smoothstep(0.35, 0.62, slope + rugged);
#endif

  float rocky = (1.0 - grass) * (1.0 - bare) * (1.0 - snow);
  vec3 bump = vec3(0.0);
#ifdef FINE
  vec2 shown = 1.0 - smoothstep(vec2(0.9, 0.3), vec2(2.6, 0.9), vec2(pixel / voxelSize));
  float strata = shown.x * sin((height + mid.coarse * 3.0 + wide.height * 8.0) * 0.9) + 0.5 * shown.y * sin((height + mid.height * 2.0) * 2.7 + 1.3);
#else
  float strata = sin((height + mid.coarse * 3.0) * 0.9) * (1.0 - smoothstep(0.9, 2.6, pixel / voxelSize));
#endif
  float fineTone = 0.0;
#ifdef FINE
  float coarseRock = 0.0;
  if (rocky > 0.01) {
    Detail a = faded(triplanar(rockNoise, at, weights, ${turns[2]}), seen.y);
    Detail b = faded(triplanar(rockNoise, at, weights, ${turns[3]}), seen.z);
    Detail c = faded(triplanar(rockNoise, at, weights, ${turns[4]}), seen.w);
    fineTone += rocky * (a.height * 0.5 + b.height * 0.55 + c.height * 0.4);
    bump += rocky * (a.slope * 1.1 + b.slope * 0.5 + c.slope * 0.10);
  }
  if (rocky < 0.99) {
    Detail b = faded(triplanar(soilNoise, at, weights, ${turns[3]}), seen.z);
    Detail c = faded(triplanar(soilNoise, at, weights, ${turns[4]}), seen.w);
    fineTone += (1.0 - rocky) * (b.height * 0.8 + c.height * 0.9);
    bump += (1.0 - rocky) * (mid.slope * 0.22 + b.slope * 0.30 + c.slope * 0.13) * (1.0 - 0.7 * snow);
  }
#ifdef CLIMATE
  // large mountains and woods are seen from far away: coarser detail goes on where finer detail has faded
  float beyond = smoothstep(0.2, 1.0, pixel);
  Detail crags = faded(triplanar(rockNoise, at, weights, ${turns[1]}), beyond * (1.0 - smoothstep(4.0, 14.0, pixel)));
  Detail crowns = faded(triplanar(soilNoise, at, weights, ${turns[2]}), beyond * (1.0 - smoothstep(1.6, 5.0, pixel)));
  fineTone += rocky * crags.height * 0.8 + (1.0 - rocky) * (crowns.height * 0.8 + beyond * wide.height * 0.5);
  bump += rocky * crags.slope * 0.9 + (1.0 - rocky) * crowns.slope * 0.28 * (1.0 - 0.7 * snow);
#endif
  bump *= ${SLOPE_MAX}.0 * roughness;
  bump -= dot(bump, normal) * normal;
  vec3 face = normalize(normal - bump * 0.35);
#else
  vec3 face = normal;
#endif
  float touch = clamp(0.5 + 0.5 * fineTone, 0.0, 1.0);

  vec3 rock = mix(rockColour, rockLayerColour, clamp(0.5 + 0.4 * layers * strata - 0.35 * patches, 0.0, 1.0));
  rock *= mix(1.0, 0.55 + 0.8 * touch, roughness);
  vec3 meadow = mix(grassColour, grassDryColour, clamp(0.32 + patches * 1.1 + fineTone * 0.2 + height * DRYER, 0.0, 1.0));
  meadow = mix(meadow, sandColour, smoothstep(0.12, 0.42, vast.height + 0.25 * wide.height));
  meadow *= mix(1.0, 0.40 + 1.15 * touch, max(roughness, 0.5));
#ifdef CLIMATE
  meadow = clad(meadow, up, height, weather, 1.0 - smoothstep(4.0, 16.0, pixel), touch);
#endif
  vec3 earth = soilColour * mix(1.0, 0.65 + 0.6 * touch, max(roughness, 0.4)) * (1.0 + 0.25 * patches);
  vec3 bottom = lowColour * mix(1.0, 0.65 + 0.6 * touch, max(roughness, 0.4)) * (1.0 + 0.25 * patches);
  vec3 colour = mix(rock, earth, bare);
  colour = mix(colour, mix(meadow, bottom, low), grass);
  colour = mix(colour, snowColour * (0.92 + 0.08 * touch), snow);

#ifdef CITY
  float glass = dress(colour, building, normal, far / voxelSize);
  face = normalize(mix(face, normal, glass));
#endif
  float lit = dot(face, sunDirection);
  float shadow = lit > 0.0 ? sunlight(place, normal, far) : 0.0;
#ifdef PLANET
  vec3 sun = sunLight * sunThrough(place - airCentre);
  float clearSky = 1.0;
#ifdef CLOUDS
  clearSky = unclouded(place - airCentre);
  sun *= clearSky;
#endif
  float day = smoothstep(-0.25, 0.35, dot(up, sunDirection));
#else
  vec3 sun = sunLight * sunThrough(vec3(0.0, airShape.x + 50.0, 0.0));
  float day = 1.0;
  float clearSky = 1.0;
#endif
  vec3 ambience = vec3(2.5 * day);
#ifdef SEA
#ifdef PLANET
  float shallow = sea.x - rise;
#else
  float shallow = cameraPosition.y - sea.y - place.y;
#endif
  if (sea.y == 0.0) shallow = -1e3;
  vec3 dimmed = sunken(shallow);
  sun *= dimmed;
  ambience *= dimmed;
  colour *= 1.0 - 0.4 * smoothstep(-1.6, -0.3, shallow + mid.height * 0.4);
#endif
  float facing = 0.5 + 0.5 * dot(face, up);
  vec3 ambient = mix(vec3(0.62, 0.52, 0.42), vec3(0.72, 1.0, 1.45), facing) * ambience + 0.02;
  vec3 bounce = sun * 0.045 * (1.0 - facing) * vec3(1.0, 0.9, 0.75);
  float crevice = mix(1.0, 0.45 + 0.85 * touch, 0.6 * roughness);
  vec3 light = sun * max(lit, 0.0) * shadow + (ambient + bounce) * open * crevice;
  // whoever goes underground carries a lamp
  float lamp = (1.0 - open) * buried() * max(dot(face, view), 0.0) / (1.0 + far * far * 0.012);
  light += vec3(1.0, 0.8, 0.55) * 1.6 * lamp * crevice;
  colour *= light * 0.31831;
#ifdef CITY
  vec3 mirrored = reflect(-view, normal);
  mirrored.y = abs(mirrored.y) + 0.02;
  float fresnel = 0.08 + 0.7 * pow(1.0 - max(dot(view, normal), 0.0), 4.0);
  colour = mix(colour, skyAt(normalize(mirrored)).rgb * (0.25 + 0.75 * open), glass * fresnel);
#endif

#ifdef SEA
  colour = drowned(colour, -view, skyUp, far, max(shallow, 0.0), clearSky);
#endif
#ifdef CLOUDS
  colour = overcast(colour, cameraPosition - airCentre, -view, far);
#endif
  colour = hazed(colour, -view, far);
  gl_FragColor = vec4(colour, 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
  #include <dithering_fragment>
}
`;
