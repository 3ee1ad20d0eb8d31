/** What grows where on a planet that is large enough for climates: by latitude, moisture and height. */

/** `clad` colours a place that is not rock. Needs `globe`. */
export const CLIMATE = /* glsl */ `
#ifdef CLIMATE
const vec3 FOREST = vec3(0.020, 0.043, 0.014);
const vec3 JUNGLE = vec3(0.018, 0.050, 0.010);
const vec3 STEPPE = vec3(0.165, 0.135, 0.062);
const vec3 DESERT = vec3(0.36, 0.235, 0.125);
const vec3 TUNDRA = vec3(0.105, 0.092, 0.060);

/** How far snow comes down, voxels, where the land is mixed like that. */
float snowLineAt(float latitude, float mixed) {
  return mix(330.0, -30.0, smoothstep(0.30, 0.93, latitude + (mixed - 0.5) * 0.22));
}

vec3 clad(vec3 meadow, vec3 up, float height, vec4 weather, float near, float touch) {
  float latitude = abs(up.y) + (weather.b - 0.5) * 0.10;
  float dry = smoothstep(0.52, 0.80, 0.9 - 0.9 * weather.g + 0.24 * exp(-pow((latitude - 0.38) * 5.5, 2.0)) - 0.2 * (1.0 - smoothstep(0.0, 0.22, latitude)));
  float woods = smoothstep(0.42, 0.62, weather.g + (weather.b - 0.5) * 0.8 + 0.12 * (1.0 - near) * touch);
  vec3 trees = mix(JUNGLE, FOREST, smoothstep(0.1, 0.4, latitude));
  touch = mix(touch, clamp(1.5 * weather.b - 0.25, 0.0, 1.0), 1.0 - near);
  vec3 land = mix(meadow, trees * (0.5 + 1.0 * touch), woods * 0.85);
  land = mix(land, STEPPE * (0.6 + 0.8 * touch), smoothstep(0.0, 0.5, dry));
  land = mix(land, DESERT * (0.75 + 0.5 * touch), smoothstep(0.45, 1.0, dry));
  float cold = smoothstep(0.62, 0.80, latitude + height * 0.0009);
  return mix(land, TUNDRA * (0.6 + 0.8 * touch), cold);
}
#endif
`;
