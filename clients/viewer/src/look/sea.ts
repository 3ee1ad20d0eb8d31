/**
 * The sea: a ball or a plane that rays meet, worked out where the ground and the sky are drawn. It has no mesh, so nothing
 * is cut off by the near plane or flickers against the shore, and what is seen of the bottom fades with the way of the
 * light through the water.
 *
 * Water takes red from light first (R. M. Pope and E. S. Fry, "Absorption spectrum of pure water", Applied Optics 36, 1997;
 * here with a little of what grows in it). The sun's glitter is that of slopes spread as C. Cox and W. Munk measured them
 * ("Measurement of the Roughness of the Sea Surface from Photographs of the Sun's Glitter", JOSA 44, 1954), and so is the
 * mean reflection (E. Bruneton, F. Neyret and N. Holzschuch, "Real-time Realistic Ocean Lighting using Seamless
 * Transitions from Geometry to BRDF", 2010).
 */

import { Vector2, type Vector3 } from "three";

import { PERIOD, TURNS } from "./period.js";

/** What a shader knows of the sea. */
export interface SeaUniforms {
  [name: string]: { value: unknown };
  /** Radius of its ball in metres, unless the world is flat; how high the viewer is above it, 0 in a dry cave below. */
  sea: { value: Vector2 };
  /** How far its waves have gone, in periods of their texture, and the width of a pixel one metre away. */
  waves: { value: Vector3 };
}

/** Periods of a wave's texture a second. */
const DRIFT = 0.011;

/** Lets time pass. */
export function blow({ waves }: SeaUniforms, seconds: number): void {
  waves.value.x = (waves.value.x + Math.min(seconds, 1) * DRIFT) % 1;
}

const turns = TURNS.map(([a, b]) => `mat2(${a}.0, ${b}.0, ${-b}.0, ${a}.0) / ${PERIOD}.0`);

/**
 * `drowned` lays the sea over the light from a ray's end, and says where the way through the air ends; `sunken` is the
 * share of sunlight that comes down to a depth. Needs AIR, SKY, `anchorLeft` and `soilNoise`.
 */
export const SEA = /* glsl */ `
#ifdef SEA
uniform vec2 sea;
uniform vec3 waves;
const vec3 ABSORBED = vec3(0.30, 0.058, 0.034);
const vec3 DEEP = vec3(0.005, 0.026, 0.050);

/** Where a ray from the viewer meets the surface; negative if it does not. */
float surfaceAlong(vec3 direction, vec3 up) {
  if (sea.y == 0.0) return -1.0;
  float rising = dot(up, direction);
#ifdef PLANET
  float along = (sea.x + sea.y) * rising;
  float power = (2.0 * sea.x + sea.y) * sea.y;
  float aside = length(up * (sea.x + sea.y) - direction * along);
  float room = sea.y > 0.1 * sea.x ? (sea.x - aside) * (sea.x + aside) : along * along - power;
  if (room < 0.0) return -1.0;
  if (sea.y < 0.0) return -along + sqrt(room);
  return along < 0.0 ? power / (-along + sqrt(room)) : -1.0;
#else
  float found = -sea.y / rising;
  return found < 1e7 ? found : -1.0;
#endif
}

vec3 sunken(float depth) {
  return exp(-ABSORBED * 1.15 * max(depth, 0.0));
}

#ifdef FINE
/** Slopes of the waves of one size, in the plane that is most level. size: of a pixel, in metres */
vec3 wave(vec3 at, vec3 weights, mat2 turn, float size, vec2 shift) {
  float period = 1.0 / length(turn[0]);
  float level = log2(max(size / period * 256.0, 1.0));
  vec3 slope = vec3(0.0);
  if (weights.x > 0.01) slope.yz += weights.x * (textureLod(soilNoise, turn * at.yz + shift, level).gb * 2.0 - 1.0039) * turn;
  if (weights.y > 0.01) slope.zx += weights.y * (textureLod(soilNoise, turn * at.zx + shift, level).gb * 2.0 - 1.0039) * turn;
  if (weights.z > 0.01) slope.xy += weights.z * (textureLod(soilNoise, turn * at.xy + shift, level).gb * 2.0 - 1.0039) * turn;
  return slope * period;
}

vec3 levelled(vec3 up) {
  vec3 weights = max(abs(up) - 0.45, 0.0);
  return weights / (weights.x + weights.y + weights.z);
}
#endif

/** What the sky sends down to a point of the sea from a direction: near the viewer, what they see of it themselves. */
vec3 skyOver(vec3 up, vec3 mirrored) {
  float day = smoothstep(-0.2, 0.35, dot(up, sunDirection));
  vec3 far = vec3(0.42, 0.62, 0.95) * (0.55 + 0.9 * pow(1.0 - max(dot(up, mirrored), 0.0), 3.0)) * day;
#ifdef PLANET
  float near = 1.0 - smoothstep(0.15, 1.2, sea.y / airShape.z);
  if (near <= 0.0) return far;
  return mix(far, skyAt(mirrored).rgb, near);
#else
  return skyAt(mirrored).rgb;
#endif
}

/**
 * under: the light from the ray's end, which is \`far\` metres away. shallow: how deep that end lies, metres.
 * open: the share of sunlight that reaches the surface. Shortens \`far\` to where the air ends.
 */
vec3 drowned(vec3 under, vec3 direction, vec3 upHere, inout float far, float shallow, float open) {
  float along = surfaceAlong(direction, upHere);
  bool isUnder = sea.y < 0.0;
  if (!isUnder && (along <= 0.0 || along >= far)) return under;
  float met = isUnder ? (along > 0.0 ? min(along, far) : far) : along;
  vec3 place = cameraPosition + direction * met;
#ifdef PLANET
  vec3 from = place - airCentre;
  vec3 up = normalize(from);
  vec3 sun = sunLight * sunThrough(from) * open;
#else
  vec3 up = vec3(0.0, 1.0, 0.0);
  vec3 sun = sunLight * sunThrough(vec3(0.0, airShape.x + 50.0, 0.0)) * open;
#endif
  float high = dot(up, sunDirection);
  float day = smoothstep(-0.2, 0.35, high);
  vec3 within = DEEP * (sun * max(high, 0.0) * 0.31831 + vec3(0.7, 1.0, 1.4) * day);

  if (isUnder) {
    vec3 through = exp(-ABSORBED * (0.6 * met + 1.5));
    vec3 fog = within * 2.6 * exp(0.02 * sea.y);
    if (met < far) {
      // beyond some angle the surface is a mirror from below
      float window = smoothstep(0.62, 0.74, dot(up, direction));
      under = mix(fog, under, window);
    }
    far = 0.0;
    return under * through + fog * (1.0 - through);
  }

  float slant = max(-dot(up, direction), 1e-4);
  vec3 through = exp(-ABSORBED * (far - met));
  vec3 normal = up;
  float spread = 0.03;
  float brightest = 0.07;
#ifdef FINE
  float size = met * waves.z / max(slant, 0.06);
  vec3 weights = levelled(up);
  vec3 at = place + anchorLeft;
  float drift = waves.x;
  vec3 slopes = 0.11 * wave(at, weights, ${turns[2]}, size, vec2(drift, 2.0 * drift));
  slopes += 0.16 * wave(at, weights, ${turns[3]}, size, vec2(-5.0 * drift, 3.0 * drift));
  slopes += 0.16 * wave(at, weights, ${turns[4]}, size, vec2(9.0 * drift, -13.0 * drift));
  float calm = smoothstep(0.0, 2.5, shallow) * 0.7 + 0.3;
  normal = normalize(up - (slopes - up * dot(slopes, up)) * calm);
  float blurred = smoothstep(0.02, 3.0, size);
  spread = mix(0.004, 0.03, blurred);
  brightest = mix(3.0, 0.07, blurred);
#endif
  float facing = max(dot(normal, -direction), 1e-3);
  float rough = sqrt(spread);
  float fresnel = 0.02 + 0.98 * pow(1.0 - facing, 5.0 * exp(-2.69 * rough)) / (1.0 + 22.7 * pow(rough, 1.5));
  vec3 mirrored = reflect(direction, normal);
  mirrored += up * (max(0.02 - dot(mirrored, up), 0.0) * 1.6);
  vec3 light = under * through + within * (1.0 - through);
  light = mix(light, skyOver(up, normalize(mirrored)), fresnel);

  vec3 middle = normalize(sunDirection - direction);
  float lean = max(dot(middle, normal), 1e-3);
  float tilt = (1.0 - lean * lean) / (lean * lean);
  float density = exp(-tilt / spread) / (3.14159 * spread * lean * lean * lean * lean);
  float mirror = 0.02 + 0.98 * pow(1.0 - max(dot(middle, sunDirection), 0.0), 5.0);
  float glitter = mirror * density / (4.0 * max(facing, 0.12));
  light += sun * brightest * (1.0 - exp(-glitter / brightest)) * smoothstep(0.0, 0.12, high);

#ifdef FINE
  // foam where waves run out
  float run = textureLod(soilNoise, ${turns[2]} * at.zx * 3.0 + drift, 0.0).r - 0.5 + 0.35 * sin(40.0 * drift + shallow * 3.0);
  float foam = smoothstep(0.55, 0.1, shallow + run * 0.5) * (1.0 - smoothstep(0.3, 1.5, size));
  light = mix(light, (sun * max(high, 0.0) * 0.2 + vec3(0.5, 0.6, 0.7) * day) * 0.8, foam * 0.65);
#endif
#ifdef CLIMATE
  // the poles are frozen
  float mixed = texture(globe, up).b;
  float ice = smoothstep(0.865, 0.885, abs(up.y) + (mixed - 0.5) * 0.16);
  vec3 white = vec3(0.50, 0.56, 0.62) * (0.8 + 0.4 * mixed);
  light = mix(light, white * (sun * max(high, 0.0) + vec3(0.72, 1.0, 1.45) * 2.5 * day) * 0.31831, ice);
#endif
  far = met;
  return light;
}
#endif
`;
