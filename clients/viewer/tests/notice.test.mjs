import assert from "node:assert/strict";
import { test } from "node:test";

import { Notice } from "../src/notice.ts";

test("what is said is seen for its time, whatever holds meanwhile", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  globalThis.HTMLDivElement = class {
    classList = { toggle() {} };
  };
  const box = new HTMLDivElement();
  globalThis.document = { getElementById: () => box };
  const notice = new Notice();
  const shown = () => (box.hidden ? null : box.textContent);
  notice.hold("away");
  assert.equal(shown(), "away");
  notice.say("lost");
  assert.equal(shown(), "lost");
  notice.hold(null);
  assert.equal(shown(), "lost");
  t.mock.timers.tick(2000);
  notice.say("lost again");
  notice.hold("starting");
  t.mock.timers.tick(2000);
  assert.equal(shown(), "lost again");
  t.mock.timers.tick(2000);
  assert.equal(shown(), "starting");
  notice.hold(null);
  assert.equal(shown(), null);
});
