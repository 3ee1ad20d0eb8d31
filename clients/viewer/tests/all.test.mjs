import "./bins.test.mjs";
import "./following.test.mjs";
import "./look.test.mjs";
import "./notice.test.mjs";
import "./pulse.test.mjs";
import "./recovery.test.mjs";
import "./terrain.test.mjs";
import "./worlds.test.mjs";
