/** The page: one world after another on one canvas, and what people do with it. */

import {
  ClientError,
  Gone,
  NotAllowed,
  NotFound,
  StreamEnded,
  Unavailable,
  Unreachable,
  WorkerClient,
  type ClientOptions,
  type Stroke,
  type Traffic,
  type Triple,
} from "chunkserver-client";
import { WebGLRenderer } from "three";

import { apiKey, askForKey } from "./api_key.js";
import { Chooser } from "./chooser.js";
import { element } from "./element.js";
import { Figures, bytesAsText } from "./figures.js";
import { Input } from "./input.js";
import { VIEWS, readLink, writeLink, type Link } from "./link.js";
import type { View } from "./look/index.js";
import { Notice } from "./notice.js";
import { Session } from "./session.js";
import { startOf, type Start } from "./starts.js";
import { open, serverUrl, type Source } from "./world.js";

const RADIUS_MIN = 1;
const RADIUS_MAX = 32;
const PIXEL_RATIO_MAX = 1.5;
/** Milliseconds. */
const FIGURES_MS = 250;
const LINK_MS = 700;
/** How patient the client is: the page says what is wrong, and tries again by itself. */
const RETRY = { attemptsMax: 3, secondsMax: 20, backoffSecondsMax: 1 };
const AWAY_MS = 700;
/** Ends of a stream that another one would have too: somebody has no key that is good for it. */
const KEEPS_OUT = new Set([4401, 4403]);

export class App {
  session: Session | null = null;
  /** Of the client, as it was a moment ago. */
  traffic: Traffic = { requests: 0, bytes: 0, cached: 0 };
  isAway = false;
  frames = 0;
  view: View = "shaded";
  private readonly client = new WorkerClient(serverUrl(), optionsOf(apiKey()));
  private readonly notice = new Notice();
  private readonly figures = new Figures();
  private readonly chooser: Chooser;
  private readonly input: Input;
  private readonly walkButton = element("walk", HTMLButtonElement);
  private readonly radius = element("radius", HTMLInputElement);
  private source: Source;
  private opening = 0;
  private frameMs = 0;
  private shownAt = -Infinity;
  private linkedAt = -Infinity;
  private before = performance.now();
  private isStriking = false;
  /** What is done when the server is back; null goes on with the world that is shown. */
  private reopen: (() => void) | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly renderer: WebGLRenderer,
  ) {
    this.input = new Input(canvas, {
      strike: (op) => void this.strike(op),
      resize: (times) => this.setRadius(Number(this.radius.value) * times),
      toggleWalk: () => this.setWalking(this.session?.motion.isWalking !== true),
      setView: (number) => this.setView(VIEWS[number]!),
      toggleFigures: () => this.figures.toggle(),
      toggleHelp: () => this.toggleHelp(),
    });
    this.chooser = new Chooser(this.client, (source, keepsPlace) => void this.go(source, keepsPlace));
    this.source = readLink(location.hash).source;
    this.connect();
    addEventListener("resize", () => this.resize());
    addEventListener("hashchange", () => this.follow(readLink(location.hash)));
  }

  /** Opens what the link names. */
  async start(): Promise<void> {
    this.renderer.setAnimationLoop(() => this.frame());
    await this.show(readLink(location.hash));
  }

  setView(view: View): void {
    this.view = view;
    this.session?.setView(view);
    for (const radio of element("views", HTMLFieldSetElement).querySelectorAll("input")) {
      radio.checked = radio.value === view;
    }
  }

  setWalking(isWalking: boolean): void {
    if (this.session !== null) {
      this.session.motion.isWalking = isWalking;
    }
    this.walkButton.setAttribute("aria-pressed", String(isWalking));
  }

  moveTo(position: Triple, ahead: Triple | null): void {
    this.session?.moveTo(position, ahead);
  }

  async edit(strokes: readonly Stroke[]): Promise<void> {
    await this.session?.edit(strokes);
  }

  /** Digs or builds where the crosshair is. Returns whether there was anything. */
  async strike(op: "carve" | "fill"): Promise<boolean> {
    const { session } = this;
    if (session === null || this.isStriking) {
      return false;
    }
    this.isStriking = true;
    try {
      const isHit = await session.strike(op, Number(this.radius.value));
      if (!isHit) {
        this.notice.say("Nothing within reach.");
      }
      return isHit;
    } catch (error) {
      if (session === this.session) {
        this.failed(error);
      }
      return false;
    } finally {
      this.isStriking = false;
    }
  }

  private connect(): void {
    element("views", HTMLFieldSetElement).addEventListener("change", ({ target }) => {
      this.setView((target as HTMLInputElement).value as View);
    });
    this.walkButton.addEventListener("click", () => this.setWalking(this.session?.motion.isWalking !== true));
    this.radius.addEventListener("input", () => this.setRadius(Number(this.radius.value)));
    element("share", HTMLButtonElement).addEventListener("click", () => void this.share());
    element("show-help", HTMLButtonElement).addEventListener("click", () => this.toggleHelp());
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.notice.hold("The graphics card has let go of the picture. It comes back by itself, or when you reload.");
    });
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.notice.hold(null);
      this.session?.touch();
    });
    document.addEventListener("pointerlockchange", () => {
      const hint = this.input.isLocked ? "Left digs, right builds, Esc frees the mouse" : "Click to look around";
      element("hint", HTMLParagraphElement).textContent = hint;
    });
    const touch = element("touch", HTMLDivElement);
    const knob = touch.querySelector("i")!;
    this.input.onTouch = () => {
      touch.hidden = false;
      element("hint", HTMLParagraphElement).hidden = true;
    };
    this.input.onStick = (right, down) => (knob.style.translate = `${right * 36}px ${down * 36}px`);
    if (matchMedia("(pointer: coarse)").matches) {
      this.input.onTouch();
    }
    for (const button of touch.querySelectorAll("button")) {
      const { hold, do: act } = button.dataset;
      if (hold !== undefined) {
        this.input.hold(button, hold === "up" ? "Space" : "KeyC");
      } else {
        button.addEventListener("click", () => void this.strike(act === "dig" ? "carve" : "fill"));
      }
    }
  }

  /** Shows another world. keepsPlace: from where the viewer is */
  private async go(source: Source, keepsPlace: boolean): Promise<void> {
    const place = keepsPlace ? this.session?.pose : undefined;
    const isWalking = keepsPlace && this.session?.motion.isWalking === true;
    const { view } = this;
    await this.show({ source, position: place?.position ?? null, ahead: place?.ahead ?? null, isWalking, view });
  }

  private async show(link: Link): Promise<void> {
    const number = ++this.opening;
    try {
      const [world, recipes] = await Promise.all([open(this.client, link.source), this.client.recipes()]);
      if (number !== this.opening) {
        return;
      }
      this.source = link.source;
      this.session?.dispose();
      const start = (name: string, shape: Parameters<typeof startOf>[1]): Start => {
        const { position, ahead } = startOf(name, shape);
        return { position: link.position ?? position, ahead: link.ahead ?? ahead };
      };
      this.session = null; // what is disposed of is drawn no more, even if there is no other
      const session = new Session(this.renderer, this.client, world, start, innerHeight, (error) => this.failed(error));
      this.session = session;
      this.setWalking(link.isWalking);
      this.setView(link.view);
      this.resize();
      this.chooser.offer(recipes);
      this.chooser.show(world);
      this.linkedAt = -Infinity;
      this.notice.hold(null);
    } catch (error) {
      if (number === this.opening) {
        this.failed(error, () => (number === this.opening ? void this.show(link) : this.resume()));
        if (this.session === null) {
          await this.client.recipes().then(
            (recipes) => this.session ?? this.chooser.offer(recipes),
            () => {}, // then there is nothing to choose from
          );
        }
      }
    }
  }

  /** Somebody has changed the address. */
  private follow(link: Link): void {
    if (this.session === null || !isSame(link.source, this.source)) {
      void this.show(link);
    } else if (location.hash !== this.link()) {
      this.setWalking(link.isWalking);
      this.setView(link.view);
      if (link.position !== null) {
        this.moveTo(link.position, link.ahead);
      }
    }
  }

  private link(): string {
    const { pose, motion } = this.session!;
    return writeLink({
      source: this.source,
      position: pose.position,
      ahead: pose.ahead,
      isWalking: motion.isWalking,
      view: this.view,
    });
  }

  private frame(): void {
    const now = performance.now();
    const elapsed = Math.min((now - this.before) / 1000, 1);
    this.before = now;
    const { session } = this;
    if (session === null) {
      return;
    }
    session.pose.turn(...this.input.turn(elapsed));
    session.frame(this.input.wish, elapsed);
    this.frames += 1;
    this.frameMs += (performance.now() - now - this.frameMs) * 0.1;
    if (now - this.shownAt > FIGURES_MS) {
      this.shownAt = now;
      this.client.traffic().then(
        (traffic) => (this.traffic = traffic),
        () => {}, // the worker has failed: whoever asks it for chunks says so
      );
      if (this.figures.isShown) {
        this.showFigures(session);
      }
    }
    if (now - this.linkedAt > LINK_MS) {
      this.linkedAt = now;
      const link = this.link();
      if (link !== location.hash) {
        history.replaceState(null, "", link);
      }
    }
  }

  private showFigures(session: Session): void {
    const { terrain, following } = session;
    this.figures.show({
      Chunks: terrain.chunks.toLocaleString("en"),
      "With triangles": session.levels.reduce((sum, count) => sum + count, 0).toLocaleString("en"),
      Triangles: session.triangles.toLocaleString("en"),
      "On their way": terrain.pending.toLocaleString("en"),
      Meshes: bytesAsText(session.bytes),
      Received: bytesAsText(this.traffic.bytes),
      "Per chunk": `${terrain.msPerChunk.toFixed(1)} ms`,
      "Cache hits": this.traffic.cached.toLocaleString("en"),
      Revision: String(following.revision),
      Frame: `${this.frameMs.toFixed(1)} ms`,
    });
  }

  private resize(): void {
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, PIXEL_RATIO_MAX));
    this.renderer.setSize(innerWidth, innerHeight, false);
    this.session?.resize(innerWidth, innerHeight);
  }

  private setRadius(metres: number): void {
    const radius = Math.max(RADIUS_MIN, Math.min(RADIUS_MAX, metres));
    this.radius.value = String(radius);
    element("radius-shown", HTMLOutputElement).value = `${Number(this.radius.value)} m`;
  }

  private toggleHelp(): void {
    const help = element("help", HTMLDialogElement);
    if (help.open) {
      help.close();
    } else {
      document.exitPointerLock();
      help.showModal();
    }
  }

  private async share(): Promise<void> {
    if (this.session !== null) {
      history.replaceState(null, "", this.link());
    }
    try {
      await navigator.clipboard.writeText(location.href);
      this.notice.say("The link is copied: it shows this world from here.");
    } catch {
      this.notice.say("The address of this page is the link: it shows this world from here.");
    }
  }

  /**
   * Says what is wrong; where the server is away, waits until it is back; where the world is not what it was, shows what
   * it is now.
   *
   * @param reopen of a world that could not be opened: tries that once more
   */
  private failed(error: unknown, reopen: (() => void) | null = null): void {
    const isGone = error instanceof StreamEnded && !KEEPS_OUT.has(error.code);
    if (error instanceof Unreachable || error instanceof Unavailable || error instanceof TypeError) {
      void this.wait(error, reopen);
    } else if (reopen === null && this.session !== null && (isGone || isOver(error))) {
      const { pose, motion } = this.session;
      const [source, isWalking] = [this.source, motion.isWalking];
      this.session.terrain.stop();
      void this.show({ source, position: pose.position, ahead: pose.ahead, isWalking, view: this.view });
    } else if (error instanceof NotAllowed || error instanceof StreamEnded) {
      askForKey();
      this.notice.say(error instanceof NotAllowed ? error.detail : error.message);
    } else {
      this.notice.hold(error instanceof ClientError ? error.message : `Something went wrong: ${String(error)}`);
    }
  }

  private async wait(error: unknown, reopen: (() => void) | null): Promise<void> {
    this.reopen = reopen ?? this.reopen;
    if (this.isAway) {
      return;
    }
    this.isAway = true;
    for (let why = error; why !== null; why = await this.whyNotReady()) {
      const isStarting = why instanceof Unavailable;
      this.notice.hold(
        isStarting ? "The server is starting." : "The server is away. This page goes on when it is back.",
      );
      await new Promise((resolve) => setTimeout(resolve, AWAY_MS));
    }
    this.isAway = false;
    this.notice.hold(null);
    const again = this.reopen ?? (() => this.resume());
    this.reopen = null;
    again();
  }

  /** What is wrong with the server; null if it can build chunks. */
  private whyNotReady(): Promise<unknown> {
    return this.client.waitUntilReady(0).then(
      () => null,
      (error: unknown) => error,
    );
  }

  private resume(): void {
    this.session?.following.resume();
    this.session?.terrain.resume();
  }
}

/** Whether the server no longer has what was shown. */
function isOver(error: unknown): boolean {
  return error instanceof Gone || error instanceof NotFound;
}

function isSame(one: Source, other: Source): boolean {
  return one.kind === "world"
    ? other.kind === "world" && one.id === other.id
    : other.kind === "seed" && one.seed === other.seed && one.recipe === other.recipe;
}

function optionsOf(key: string | null): ClientOptions {
  return key === null ? { retry: RETRY } : { retry: RETRY, apiKey: key };
}
