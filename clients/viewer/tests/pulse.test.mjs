import assert from "node:assert/strict";
import { test } from "node:test";

import { Pulse } from "../src/pulse.ts";

test("who does not answer so many looks is silent, until an answer comes", async () => {
  const told = [];
  const pulse = new Pulse(3, (isSilent) => told.push(isSilent));
  assert.equal(await pulse.look(async () => 7), 7);
  let answer;
  let asked = 0;
  const ask = () => {
    asked += 1;
    return new Promise((resolve) => (answer = resolve));
  };
  const first = pulse.look(ask);
  assert.deepEqual([await pulse.look(ask), await pulse.look(ask)], [null, null]);
  assert.deepEqual(told, []);
  await pulse.look(ask);
  await pulse.look(ask);
  assert.deepEqual(told, [true]);
  answer(8);
  assert.equal(await first, 8);
  assert.deepEqual(told, [true, false]);
  assert.equal(asked, 1, "questions do not pile up");
  await assert.rejects(pulse.look(() => Promise.reject(new Error("no"))));
  assert.equal(await pulse.look(async () => 9), 9);
});
