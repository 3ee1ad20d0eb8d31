import "./look.test.mjs";
import "./terrain.test.mjs";
