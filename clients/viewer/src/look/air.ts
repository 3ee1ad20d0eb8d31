/**
 * Air that scatters light: what the sky and the haze before distant ground are made of.
 *
 * Single scattering by molecules (Rayleigh) and by haze (Mie), along a ray in steps; the way of the light to each step is
 * not walked but taken from an approximation of the Chapman function (C. Schueler, "An Approximation to the Chapman
 * Grazing-Incidence Function for Atmospheric Scattering", GPU Pro 3). What is scattered more than once is added as if it
 * came from everywhere.
 */

import { Vector3 } from "three";

/** What a shader knows of the air; as uniforms. Metres, in the scene. */
export interface AirUniforms {
  [name: string]: { value: unknown };
  airCentre: { value: Vector3 };
  /** Radius of the ground, of the air's upper end, scale heights of molecules and of haze. */
  airShape: { value: [number, number, number, number] };
  airRayleigh: { value: Vector3 };
  airMie: { value: number };
  sunDirection: { value: Vector3 };
  sunLight: { value: Vector3 };
}

const EARTH_RADIUS = 6360e3;
/** Optical depth of the whole air straight up, for red, green and blue, and of haze. */
const RAYLEIGH_UP = [0.046, 0.108, 0.265] as const;
const MIE_UP = 0.022;
const SUN = 20;

/**
 * The air of a flat world is that of a ball as large as the Earth under it.
 *
 * @param radius metres, null for a flat world
 * @param begins, height of a planet's air, in radii: where it is as dense as it gets, and how far on it is a e-th of that
 */
export function airUniforms(
  radius: number | null,
  airless: boolean,
  [begins, height]: readonly [number, number],
): AirUniforms {
  const ground = radius === null ? EARTH_RADIUS : radius * begins;
  const [molecules, haze] = radius === null ? [8000, 1200] : [radius * height, radius * height * 0.45];
  const thickness = airless ? 0 : radius === null ? 1 : 1.15;
  const [red, green, blue] = RAYLEIGH_UP;
  return {
    airCentre: { value: new Vector3() },
    airShape: { value: [ground, ground + molecules * (radius === null ? 10 : 7), molecules, haze] },
    airRayleigh: { value: new Vector3(red, green, blue).multiplyScalar(thickness / molecules) },
    airMie: { value: (thickness * MIE_UP) / haze },
    sunDirection: { value: new Vector3(0, 1, 0) },
    sunLight: { value: new Vector3(1, 0.97, 0.92).multiplyScalar(SUN) },
  };
}

/**
 * `scatter` walks from a point, counted from the air's centre, `far` metres along a direction, and says what light is
 * added on the way and what share of the light behind comes through. `sunThrough` is the share of sunlight that reaches a
 * point.
 */
export const AIR = /* glsl */ `
uniform vec3 airCentre;
uniform vec4 airShape;
uniform vec3 airRayleigh;
uniform float airMie;
uniform vec3 sunDirection;
uniform vec3 sunLight;

float chapman(float x, float mu) {
  float c = sqrt(1.5707963 * x);
  float up = c / ((c - 1.0) * abs(mu) + 1.0);
  if (mu >= 0.0) return up;
  float grazing = sqrt(max(1.0 - mu * mu, 0.0)) * x;
  return 2.0 * sqrt(1.5707963 * grazing) * exp(min(x - grazing, 40.0)) - up;
}

vec3 sunThrough(vec3 from) {
  float r = length(from);
  float mu = dot(from, sunDirection) / r;
  vec2 height = vec2(max(r - airShape.x, 0.0)) / airShape.zw;
  vec2 deep = airShape.zw * exp(-height) * vec2(chapman(r / airShape.z, mu), chapman(r / airShape.w, mu));
  return exp(-min(airRayleigh * deep.x + airMie * 1.1 * deep.y, 60.0));
}

/** The way of a ray within the air: from, to; to < from if it misses. */
vec2 withinAir(vec3 from, vec3 direction, float far) {
  float along = dot(from, direction);
  float r = length(from);
  float room = along * along - (r - airShape.y) * (r + airShape.y);
  if (room < 0.0) return vec2(0.0, -1.0);
  float root = sqrt(room);
  float least = max(-along - root, 0.0);
  float most = min(-along + root, far);
  float floorRoom = along * along - (r - airShape.x) * (r + airShape.x);
  if (along < 0.0 && floorRoom > 0.0 && r > airShape.x) most = min(most, -along - sqrt(floorRoom));
  return vec2(least, most);
}

void scatter(vec3 from, vec3 direction, float far, int steps, out vec3 light, out vec3 through) {
  light = vec3(0.0);
  through = vec3(1.0);
  vec2 way = withinAir(from, direction, far);
  if (way.y <= way.x) return;
  float mu = dot(direction, sunDirection);
  float rayleigh = 0.0596831 * (1.0 + mu * mu);
  float g = 0.78;
  float mie = 0.0795775 * (1.0 - g * g) / pow(1.0 + g * g - 2.0 * g * mu, 1.5);
  float before = 0.0;
  for (int i = 1; i <= steps; i++) {
    float share = float(i) / float(steps);
    // short steps near the viewer in thick air, even ones from outside
    float end = way.x > 0.0 ? share : share * share;
    float width = (end - before) * (way.y - way.x);
    vec3 at = from + direction * (way.x + mix(before, end, 0.5) * (way.y - way.x));
    before = end;
    float height = max(length(at) - airShape.x, 0.0);
    vec2 density = exp(-height / airShape.zw) * width;
    vec3 molecules = airRayleigh * density.x;
    float haze = airMie * density.y;
    vec3 lit = sunThrough(at);
    vec3 own = exp(-(molecules + haze * 1.1));
    vec3 more = 0.06 * (molecules + haze) * sqrt(lit);
    light += through * (lit * (molecules * rayleigh + haze * mie) + more);
    through *= own;
  }
  light *= sunLight;
}
`;
