import { WebGLRenderer } from "three";

import { App } from "./app.js";
import { element } from "./element.js";
import { Notice } from "./notice.js";
import { scripting, type Scripting } from "./scripting.js";

declare global {
  interface Window {
    chunkserver?: Scripting;
  }
}

function rendererOf(canvas: HTMLCanvasElement): WebGLRenderer | null {
  try {
    return new WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
  } catch {
    return null;
  }
}

const canvas = element("view", HTMLCanvasElement);
const renderer = rendererOf(canvas);
if (renderer === null) {
  document.querySelectorAll<HTMLElement>("header, footer, #aim").forEach((part) => (part.hidden = true));
  new Notice().hold(
    "This browser shows no WebGL 2, which draws the world: it may be switched off, or the graphics card is not supported.",
  );
} else {
  try {
    const app = new App(canvas, renderer);
    window.chunkserver = scripting(app);
    void app.start();
  } catch (error) {
    new Notice().hold(`This page cannot run here: ${String(error)}`);
    throw error;
  }
}
