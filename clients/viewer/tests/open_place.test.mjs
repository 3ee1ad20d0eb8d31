import assert from "node:assert/strict";
import { test } from "node:test";

import { openPlace } from "../src/open_place.ts";

const distance = (one, other) => Math.hypot(...one.map((at, axis) => at - other[axis]));

/** Rock with one round cave in it. */
function cave(centre, radius) {
  const ray = (origin, way, longest) => {
    const from = origin.map((at, axis) => at - centre[axis]);
    const half = from.reduce((sum, at, axis) => sum + at * way[axis], 0);
    const root = Math.sqrt(half * half - distance(from, [0, 0, 0]) ** 2 + radius * radius);
    const along = [-half - root, -half + root].find((each) => each > 0);
    if (along === undefined || along > longest) {
      return null;
    }
    const normal = from.map((at, axis) => -(at + way[axis] * along) / radius); // out of the rock
    return { along, normal };
  };
  return { ray };
}

test("who begins in rock is put into the open behind the nearest surface", () => {
  for (const [radius, deep] of [
    [30, 8],
    [3, 3],
  ]) {
    for (const from of [
      [0, 40, 0],
      [25, -25, 25],
    ]) {
      const open = openPlace(cave([0, 0, 0], radius), from, [0, 1, 0]);
      assert.ok(distance(open, [0, 0, 0]) < radius, `${open} is in a cave of radius ${radius}`);
      assert.ok(radius - distance(open, [0, 0, 0]) > deep - 0.5, `${open} is not at its wall`);
    }
  }
});

test("who begins in the open stays there, and so does who has nothing open nearby", () => {
  assert.equal(openPlace(cave([0, 0, 0], 30), [3, 4, 5], [0, 1, 0]), null);
  assert.equal(openPlace(cave([0, 0, 0], 30), [0, 1000, 0], [0, 1, 0]), null);
});
