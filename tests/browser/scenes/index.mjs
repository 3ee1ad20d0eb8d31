/** All scenes, by name: each takes what it was given and a context of its own, and returns what it has found. */

import * as failing from "./failing.mjs";
import * as first from "./first.mjs";
import * as frames from "./frames.mjs";
import * as hands from "./hands.mjs";
import * as layout from "./layout.mjs";
import * as others from "./others.mjs";
import * as recovery from "./recovery.mjs";
import * as shown from "./shown.mjs";
import * as worlds from "./worlds.mjs";

export const SCENES = {
  ...shown,
  ...first,
  ...frames,
  ...hands,
  ...worlds,
  ...others,
  ...failing,
  ...layout,
  ...recovery,
};
