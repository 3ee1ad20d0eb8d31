/** The clouds of a planet: one thin layer at a height of its own, which whoever draws meets along a ray. */

import type { Vector4 } from "three";

/** What a shader knows of the clouds. */
export interface CloudUniforms {
  [name: string]: { value: unknown };
  /**
   * Radius of the layer in metres; cosine and sine of how far it has drifted around the planet's axis; texels of `globe`
   * that a pixel covers of a layer one metre away.
   */
  clouds: { value: Vector4 };
}

/** Radians a second. */
const DRIFT = 0.0011;

/** Lets time pass. */
export function drift({ clouds }: CloudUniforms, seconds: number): void {
  const angle = Math.atan2(clouds.value.z, clouds.value.y) + Math.min(seconds, 1) * DRIFT;
  [clouds.value.y, clouds.value.z] = [Math.cos(angle), Math.sin(angle)];
}

/**
 * `overcast` lays clouds over the light from a ray's end, `unclouded` is the share of sunlight that they let through to a
 * point. Points are counted from the planet's middle. Needs AIR and `globe`.
 */
export const CLOUDS = /* glsl */ `
#ifdef CLOUDS
uniform samplerCube globe;
uniform vec4 clouds;

float thickness(vec3 from, float level) {
  vec3 at = vec3(from.x * clouds.y + from.z * clouds.z, from.y, from.z * clouds.y - from.x * clouds.z);
  return smoothstep(0.52, 1.0, textureLod(globe, at, level).r);
}

/** Where a ray meets the layer first; negative if it does not. */
float meets(vec3 from, vec3 direction) {
  float along = dot(from, direction);
  float r = length(from);
  float aside = length(from - direction * along);
  float room = (clouds.x - aside) * (clouds.x + aside);
  if (room < 0.0) return -1.0;
  return r > clouds.x ? -along - sqrt(room) : -along + sqrt(room);
}

float unclouded(vec3 from) {
  if (length(from) > clouds.x) return 1.0;
  return 1.0 - 0.72 * thickness(from + sunDirection * meets(from, sunDirection), 1.0);
}

vec3 overcast(vec3 behind, vec3 from, vec3 direction, float far) {
  float along = meets(from, direction);
  if (along <= 0.0 || along > far) return behind;
  vec3 at = from + direction * along;
  vec3 up = at / clouds.x;
  float slant = abs(dot(up, direction));
  float level = log2(max(clouds.w * along / max(slant, 0.1), 1.0));
  float thick = thickness(at, level);
  if (thick <= 0.0) return behind;
  bool isBelow = length(from) < clouds.x;
  float share = 1.0 - exp(-thick * 2.2 / (0.3 + slant));
  // a layer that is seen from its edge would look like a shell
  share *= isBelow ? smoothstep(0.02, 0.2, slant) : smoothstep(0.0, 0.4, slant);
  // what faces the sun is lighter than what lies behind thicker clouds
  vec3 towards = sunDirection - up * dot(up, sunDirection);
  float shade = thickness(at + towards * clouds.x * 0.012, level) - thickness(at - towards * clouds.x * 0.004, level);
  float high = dot(up, sunDirection);
  vec3 sun = sunLight * sunThrough(at);
  float through = isBelow ? 0.45 + 0.5 * (1.0 - thick) : 1.0;
  vec3 lit = sun * 0.26 * smoothstep(-0.15, 0.7, high) * clamp(1.0 - 1.1 * shade, 0.45, 1.2) * through;
  lit += vec3(0.30, 0.40, 0.55) * smoothstep(-0.25, 0.3, high) * 0.9 + 0.004;
  // whoever passes through the layer sees it thin out
  return mix(behind, lit, share * smoothstep(0.0, 0.02 * clouds.x, along));
}
#endif
`;
