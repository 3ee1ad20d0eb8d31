import assert from "node:assert/strict";
import { test } from "node:test";

import { Vector3, Vector4 } from "three";

import { drift } from "../src/look/clouds.ts";
import { definesOf } from "../src/look/ground.ts";
import { NOISE_SIZE, inTasks, rockNoise, soilNoise } from "../src/look/noise.ts";
import { LEVELS, groundOf, srgb } from "../src/look/palette.ts";
import { PERIOD, TURNS, periodOf, remainder } from "../src/look/period.ts";
import { qualityOf } from "../src/look/quality.ts";
import { blow } from "../src/look/sea.ts";
import { sunFor } from "../src/look/sun.ts";
import { startOf } from "../src/starts.ts";
import { extentOf } from "../src/world.ts";

/** Where a texture is read at a point, as the shader does it: from its place in the scene and what is left of the anchor. */
function texel(point, anchor, voxelSize, [a, b]) {
  const left = remainder(anchor, voxelSize);
  const [x, y] = [0, 1].map((axis) => (point[axis] - anchor[axis]) * voxelSize + left[axis]);
  return [(a * x - b * y) / PERIOD, (b * x + a * y) / PERIOD].map((at) => at - Math.floor(at));
}

test("textures stay where they are when the anchor moves, also 2^40 voxels away", () => {
  for (const voxelSize of [1, 0.25]) {
    for (const far of [0, -(2 ** 40), 2 ** 40]) {
      const point = [far + 37, far - 1234, 5];
      const anchors = [
        [far, far, 0],
        [far + 32, far - 4096, 96],
        [far - 2048, far + 1056, -64],
      ];
      for (const turn of TURNS) {
        const [first, ...others] = anchors.map((anchor) => texel(point, anchor, voxelSize, turn));
        for (const other of others) {
          for (const axis of [0, 1]) {
            const off = Math.abs(first[axis] - other[axis]);
            assert.ok(Math.min(off, 1 - off) < 1e-9, `${turn} at ${far}: ${first} and ${other}`);
          }
        }
      }
    }
  }
});

test("what is left of an anchor is small, and never negative", () => {
  const left = remainder([-1, 2 ** 40 + 5, -(2 ** 40) - 3], 0.5);
  assert.deepEqual(left, [PERIOD - 0.5, 2.5, PERIOD - 1.5]);
});

test("textures are not parallel, and each is smaller than the one before", () => {
  const angles = TURNS.map(([a, b]) => Math.atan2(b, a));
  for (const [number, angle] of angles.entries()) {
    for (const other of angles.slice(number + 1)) {
      const quarter = Math.abs(angle - other) % (Math.PI / 2);
      assert.ok(Math.min(quarter, Math.PI / 2 - quarter) > 0.04, `${angle} and ${other}`);
    }
  }
  const periods = TURNS.map(periodOf);
  assert.deepEqual(
    periods,
    [...periods].sort((one, other) => other - one),
  );
  assert.equal(Math.round(periods.at(-1) * 100), 205);
});

test("levels beside each other have colours that are told apart", () => {
  const split = (hex) => [hex >> 16, (hex >> 8) & 255, hex & 255];
  for (const [lod, hex] of LEVELS.entries()) {
    const next = split(LEVELS[(lod + 1) % LEVELS.length]);
    const off = Math.hypot(...split(hex).map((part, place) => part - next[place]));
    assert.ok(off > 80, `levels ${lod} and ${lod + 1}: ${off}`);
  }
  assert.equal(new Set(LEVELS).size, LEVELS.length);
});

test("colours are linear, and unknown recipes look like meadows", () => {
  assert.deepEqual(srgb(0xff0000), [1, 0, 0]);
  assert.ok(Math.abs(srgb(0x808080)[1] - 0.2159) < 1e-3);
  assert.equal(groundOf("city").isCity, true);
  assert.equal(groundOf("moon").airless, true);
  assert.equal(groundOf("0123456789abcdef"), groundOf("terrain"));
});

test("renderers in software get less to do, unless the address says otherwise", () => {
  const context = (name) => ({
    RENDERER: 1,
    getExtension: () => ({ UNMASKED_RENDERER_WEBGL: 2 }),
    getParameter: (which) => (which === 2 ? name : "WebKit WebGL"),
  });
  const software = context("ANGLE (Google, Vulkan 1.3.0 (SwiftShader Device (LLVM 10.0.0)), SwiftShader driver)");
  assert.equal(qualityOf(software, ""), "low");
  assert.equal(qualityOf(context("llvmpipe (LLVM 15.0.6, 256 bits)"), ""), "low");
  assert.equal(qualityOf(context("ANGLE (NVIDIA GeForce RTX 3060)"), ""), "high");
  assert.equal(qualityOf(software, "?quality=high"), "high");
  assert.equal(qualityOf(context("Mali-G78"), "?quality=low"), "low");
});

test("the sun is up wherever the viewer is, and stays while they stay", () => {
  const sun = new Vector3();
  for (let step = 0; step < 500; step++) {
    const up = new Vector3(Math.sin(step * 0.7), Math.cos(step * 0.31), Math.sin(step * 0.13 + 1)).normalize();
    const angle = sunFor(sun, up, (step % 5) / 2).angleTo(up);
    assert.ok(angle > 0.44 && angle < 1.26, `${angle} at step ${step}`);
    const before = sun.clone();
    sunFor(sun, up, (step % 5) / 2);
    assert.ok(before.distanceTo(sun) < 1e-6);
  }
});

test("noise repeats without an edge, and is as light as dark", async () => {
  for (const bytes of [await inTasks(soilNoise(2)), await inTasks(rockNoise(1))]) {
    const at = (column, row) => bytes[4 * (row * NOISE_SIZE + column)];
    let [edge, within, sum] = [0, 0, 0];
    for (let row = 0; row < NOISE_SIZE; row++) {
      edge += Math.abs(at(0, row) - at(NOISE_SIZE - 1, row));
      within += Math.abs(at(101, row) - at(100, row));
      for (let column = 0; column < NOISE_SIZE; column++) {
        sum += at(column, row);
      }
    }
    assert.ok(edge < 2 * within, `${edge} and ${within}`);
    assert.ok(Math.abs(sum / NOISE_SIZE ** 2 - 128) < 1);
  }
});

test("noise is made octave by octave, and other tasks have their turn", async () => {
  let turns = 0;
  const timer = setInterval(() => (turns += 1), 0);
  await inTasks(rockNoise(1));
  clearInterval(timer);
  assert.ok(turns >= 3, `${turns} turns`);
});

test("each world is told what it has: sea, clouds, climates; machines that are slow no waves", () => {
  const has = (name, isPlanet, quality) => Object.keys(definesOf(groundOf(name), isPlanet, quality)).sort();
  assert.deepEqual(has("terrain", false, "low"), ["AIR_STEPS", "DRYER"]);
  assert.deepEqual(has("islands", false, "high"), ["AIR_STEPS", "DRYER", "FINE", "SEA"]);
  assert.deepEqual(has("moon", true, "low"), ["AIR_STEPS", "DRYER", "PLANET"]);
  assert.deepEqual(has("continents", true, "low"), ["AIR_STEPS", "CLIMATE", "CLOUDS", "DRYER", "PLANET", "SEA"]);
});

test("clouds and waves go on for hours, and stay what they are", () => {
  const uniforms = { clouds: { value: new Vector4(10_600, 1, 0, 3) }, waves: { value: new Vector3() } };
  let turned = 0;
  for (let second = 0; second < 20_000; second++) {
    drift(uniforms, 1);
    blow(uniforms, 1);
    const { x, y, z, w } = uniforms.clouds.value;
    assert.deepEqual([x, w], [10_600, 3]);
    assert.ok(Math.abs(Math.hypot(y, z) - 1) < 1e-9);
    assert.ok(uniforms.waves.value.x >= 0 && uniforms.waves.value.x < 1);
    turned += y < 0 ? 1 : 0;
  }
  assert.ok(turned > 5_000 && turned < 15_000, `${turned} seconds on the other side`);
});

test("a planet is first seen whole", () => {
  for (const [name, radius] of [
    ["continents", 10_000],
    ["planet", 200],
  ]) {
    const { position, ahead } = startOf(name, { centre: [5, -3, 7], radius });
    const away = Math.hypot(...ahead);
    assert.ok(Math.asin(radius / away) < Math.PI / 6, `${name} from ${away}`);
    assert.deepEqual(
      position.map((at, axis) => Math.round(at + ahead[axis])),
      [5, -3, 7],
    );
  }
});

test("levels suffice to see a large planet whole, and its coasts are finer than hills are elsewhere", () => {
  const world = { lods: 21, chunkCells: 32 };
  const large = extentOf(world, { centre: [0, 0, 0], radius: 10_000 });
  const small = extentOf(world, { centre: [0, 0, 0], radius: 200 });
  assert.ok(32 * 2 ** (large.lods - 1) >= 30_000 && large.lods < 13);
  assert.ok(large.reach > 100_000);
  assert.ok(large.errorPixels < small.errorPixels);
  assert.equal(extentOf(world, { centre: null, radius: null }).errorPixels, small.errorPixels);
});

test("a ring is level where it looks at its axis, and is seen from one end to the other", () => {
  const ring = groundOf("ring");
  assert.equal(definesOf(ring, false, "low").RING, 1);
  assert.ok(!("RING" in definesOf(groundOf("terrain"), false, "low")));
  assert.ok(ring.clear > 4 * 640);
});
