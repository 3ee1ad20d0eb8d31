/** The Chromium of all that opens the viewer: tests, the benchmark, the pictures. It draws without a graphics card. */

export { chromium } from "playwright-core";

/** How it is launched. CHROMIUM in the environment names another one. */
export const CHROMIUM = {
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  headless: true,
  args: [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
  ],
};
