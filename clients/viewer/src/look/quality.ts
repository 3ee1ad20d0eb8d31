/** How much a picture may cost. */

/** "low" is for renderers in software: no shadows, no detail. */
export type Quality = "high" | "low";

const IN_SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** What the address asks for (`?quality=high`), or what the renderer is up to. */
export function qualityOf(context: WebGLRenderingContext | WebGL2RenderingContext, search: string): Quality {
  const asked = new URLSearchParams(search).get("quality");
  return asked === "high" || asked === "low" ? asked : IN_SOFTWARE.test(rendererOf(context)) ? "low" : "high";
}

function rendererOf(context: WebGLRenderingContext | WebGL2RenderingContext): string {
  const extension = context.getExtension("WEBGL_debug_renderer_info");
  return String(context.getParameter(extension?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER));
}
