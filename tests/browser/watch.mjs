/**
 * Looks at each frame that a page draws, before it is shown: how many of its pixels are background, which chunks came
 * and went. It stands in front of the page's own scripts: `context.addInitScript(watch)`, and sees the scene by what
 * three.js tells its developer tools.
 *
 * `watched.begin()` starts, `watched.end()` returns `{frames, holes, swaps}`: holes are the counts of frames that have
 * background pixels, swaps `{came, went}` of frames in which chunks changed, as `[lod, x, y, z, coarser]`.
 */
export function watch() {
  /** Of every view but the shaded one: clients/viewer/src/look/views.ts. */
  const [BACKGROUND, NEAR] = [[17, 22, 29], 12];
  const scenes = [];
  let draws = 0;
  let seen = null;
  let before = new Map();

  globalThis.__THREE_DEVTOOLS__ = new EventTarget();
  __THREE_DEVTOOLS__.addEventListener("observe", ({ detail }) => detail.isScene && scenes.push(detail));
  for (const name of ["drawElements", "drawElementsInstanced", "drawArrays", "drawArraysInstanced"]) {
    const real = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...given) {
      draws += 1;
      return real.apply(this, given);
    };
  }

  function chunks() {
    const found = new Map();
    const visit = ({ chunk, uuid }) => chunk?.key && found.set(uuid, chunk);
    scenes.forEach((scene) => scene.traverse(visit));
    return found;
  }

  function background() {
    const gl = document.querySelector("canvas").getContext("webgl2");
    const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    let count = 0;
    for (let at = 0; at < pixels.length; at += 4) {
      count += BACKGROUND.every((part, channel) => Math.abs(pixels[at + channel] - part) < NEAR);
    }
    return count;
  }

  const nameOf = ({ key: { lod, x, y, z }, coarser }) => [lod, x, y, z, coarser];
  const without = (one, other) => [...one].filter(([uuid]) => !other.has(uuid)).map(([, chunk]) => nameOf(chunk));

  function look() {
    const now = chunks();
    const [came, went] = [without(now, before), without(before, now)];
    before = now;
    seen.frames += 1;
    if (came.length + went.length > 0) {
      seen.swaps.push({ came, went });
    }
    const count = background();
    if (count > 0) {
      seen.holes.push(count);
    }
  }

  const real = globalThis.requestAnimationFrame.bind(globalThis);
  globalThis.requestAnimationFrame = (call) =>
    real((now) => {
      draws = 0;
      call(now);
      if (seen !== null && draws > 0) {
        look();
      }
    });

  globalThis.watched = {
    begin() {
      before = chunks();
      seen = { frames: 0, holes: [], swaps: [] };
    },
    /** What is in the scene, counted there. */
    totals() {
      const all = [...chunks().values()];
      const sum = (of) => all.reduce((before, chunk) => before + of(chunk), 0);
      return {
        objects: all.length,
        triangles: sum(({ indices }) => indices.length / 3),
        bytes: sum(({ positions, normals, indices }) => positions.byteLength + normals.byteLength + indices.byteLength),
      };
    },
    end() {
      const all = seen;
      seen = null;
      return all;
    },
  };
}
