import assert from "node:assert/strict";
import { test } from "node:test";

import { Bins } from "../src/bins.ts";

/** Numbers in [0, 1), the same ones each time. */
function randomOf(seed) {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

/** Triangles anywhere in a box, as a mesh of so many chunks. */
function meshOf(random, count, low, high, width) {
  const positions = new Uint16Array(4 * 3 * count);
  for (let triangle = 0; triangle < count; triangle++) {
    const middle = low.map((least, axis) => least + random() * (high[axis] - least));
    for (let corner = 0; corner < 3; corner++) {
      for (let axis = 0; axis < 3; axis++) {
        const at = middle[axis] + (random() - 0.5) * width;
        positions[4 * (3 * triangle + corner) + axis] = Math.max(low[axis], Math.min(high[axis], at));
      }
    }
  }
  return { positions, components: 4, indices: Uint16Array.from({ length: 3 * count }, (_, at) => at), low, high };
}

/** The same triangles, all of them in one bin. */
function inOneBin(mesh) {
  return new Bins({ ...mesh, low: [0, 0, 0], high: [2 ** 21, 2 ** 21, 2 ** 21] });
}

test("a ray meets the same triangle, and a ball is pushed as far, as if all triangles were asked", () => {
  const random = randomOf(7);
  let [met, pushed] = [0, 0];
  for (const [low, high, width] of [
    [[16384, 16384, 16384], [49152, 49152, 49152], 3000],
    [[16384, 16384, 16384], [49152, 49152, 49152], 20000],
    [[16384, 30000, 16384], [49152, 30000, 49152], 9000],
  ]) {
    const mesh = meshOf(random, 60, low, high, width);
    const [bins, plain] = [new Bins(mesh), inOneBin(mesh)];
    const point = () => low.map((least, axis) => least - 3000 + random() * (high[axis] - least + 6000));
    for (let number = 0; number < 400; number++) {
      const [origin, target] = [point(), point()];
      const along = target.map((at, axis) => at - origin[axis]);
      const found = bins.ray(origin, along, 0, 2);
      assert.deepEqual(found, plain.ray(origin, along, 0, 2));
      met += found === null ? 0 : 1;
      const out = bins.push(origin, 2500);
      assert.deepEqual(out, plain.push(origin, 2500));
      pushed += out === null ? 0 : 1;
    }
  }
  assert.ok(met > 100 && pushed > 100, `${met} rays met something, ${pushed} balls were pushed`);
});
