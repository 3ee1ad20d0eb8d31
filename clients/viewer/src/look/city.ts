/** What is built in the recipe `city`: where its streets and windows are is known from chunkserver/recipe/library/city.py. */

/** From street to street, voxels. */
const BLOCK = 88;
/** Tints of blocks repeat after as many. */
const BLOCKS = 64;

/** Voxels. */
export const STREETS_PERIOD = BLOCK * BLOCKS;

/**
 * `dress` colours a place of the city, in voxels, and says whether there is glass. Windows are walls 26, 18 or 10 voxels
 * from the middle of a block; a bay is 8 wide, a storey 10 high.
 */
export const CITY = /* glsl */ `
#ifdef CITY
float chance(vec3 cell) {
  return fract(sin(dot(mod(cell, ${BLOCKS}.0), vec3(12.9898, 78.233, 37.719))) * 43758.5453);
}

float dress(inout vec3 colour, vec3 at, vec3 normal, float far) {
  vec2 block = floor(at.xz / ${BLOCK}.0 + 0.5);
  vec2 inside = at.xz - block * ${BLOCK}.0;
  float tint = chance(vec3(block, 1.0));
  vec3 stone = tint < 0.3 ? vec3(1.0, 0.93, 0.83) : tint < 0.55 ? vec3(0.86, 0.88, 0.92) : tint < 0.8 ? vec3(1.05, 1.02, 0.98) : vec3(0.93, 0.72, 0.6);
  if (at.y > 3.6) colour *= stone;

  // a line along the middle of each street
  vec2 aside = ${BLOCK / 2}.0 - abs(inside);
  vec2 dash = step(0.5, fract(at.zx / 10.0)) * step(12.0, aside.yx);
  vec2 line = (1.0 - smoothstep(0.2, 0.35 + far * 0.001, aside)) * dash;
  float street = 1.0 - smoothstep(0.6, 1.0, at.y);
  colour = mix(colour, vec3(0.6), max(line.x, line.y) * street * 0.8 * (1.0 - smoothstep(150.0, 500.0, far)));

  vec3 away = abs(vec3(abs(inside), 0.0).xzy);
  vec2 wall = min(min(abs(away.xz - 26.0), abs(away.xz - 18.0)), abs(away.xz - 10.0));
  vec2 faces = smoothstep(0.94, 0.985, abs(normal.xz)) * (1.0 - smoothstep(0.5, 0.8, wall));
  float glass = max(faces.x, faces.y) * smoothstep(3.6, 4.2, at.y);
  float pane = chance(floor(vec3(at.x / 8.0 + 0.5, at.y / 10.0, at.z / 8.0 + 0.5)));
  colour = mix(colour, mix(vec3(0.012, 0.02, 0.028), vec3(0.05, 0.055, 0.06), pane), glass);
  return glass;
}
#endif
`;
