/** The page: one world after another on one canvas, and what people do with it. */

import {
  WorkerClient,
  WorkerFailed,
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
import { Pulse } from "./pulse.js";
import { Session } from "./session.js";
import { startOf, type Start } from "./starts.js";
import { isOwn, serverUrl, type Source } from "./world.js";
import { Worlds, type Page } from "./worlds.js";

const RADIUS_MIN = 1;
const RADIUS_MAX = 32;
const PIXEL_RATIO_MAX = 1.5;
const SMOOTHING = 0.1;
/** Milliseconds. */
const FIGURES_MS = 250;
const LINK_MS = 700;
/** Of the worker, each `FIGURES_MS` apart: half a minute. */
const SILENT_LOOKS_MAX = 120;
/** Recipes that somebody wrote of which it is known what they look like. */
const LIKES_MAX = 64;
/** How patient the client is: the page says what is wrong, and tries again by itself. */
const RETRY = { attemptsMax: 3, secondsMax: 20, backoffSecondsMax: 1 };

export class App {
  /** Of the client, as it was a moment ago. */
  traffic: Traffic = { requests: 0, bytes: 0, cached: 0 };
  frames = 0;
  view: View = "shaded";
  private readonly worlds: Worlds<Session>;
  private readonly notice = new Notice();
  private readonly figures = new Figures();
  private readonly pulse = new Pulse<Traffic>(SILENT_LOOKS_MAX, (isSilent) =>
    this.worlds.recovery.note("worker", isSilent ? "Reload the page: its worker does not answer any more." : null),
  );
  private readonly chooser: Chooser;
  private readonly input: Input;
  private readonly walkButton = element("walk", HTMLButtonElement);
  private readonly radius = element("radius", HTMLInputElement);
  /** Of the page's thread in a frame, and from frame to frame. Smoothed. */
  private threadMs = 0;
  private frameMs = 0;
  private shownAt = -Infinity;
  private linkedAt = -Infinity;
  private before = performance.now();
  /** By the digest of a recipe that somebody wrote, the one that it was made of: it looks like that. */
  private readonly likes = new Map<string, string>();
  /** In which an own edit is on its way. */
  private striking: Session | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    readonly renderer: WebGLRenderer,
  ) {
    this.input = new Input(canvas, {
      strike: (op) => void this.strike(op),
      isSeen: () => this.striking === null && this.session?.terrain.isOutdated !== true,
      resize: (times) => this.setRadius(Number(this.radius.value) * times),
      toggleWalk: () => this.setWalking(this.session?.motion.isWalking !== true),
      setView: (number) => this.setView(VIEWS[number]!),
      toggleFigures: () => this.figures.toggle(),
      toggleHelp: () => this.toggleHelp(),
    });
    this.chooser = new Chooser(
      (tree) => this.worlds.client.postRecipe(tree),
      (source, keepsPlace) => this.go(source, keepsPlace),
    );
    const page = {
      connect: () => new WorkerClient(serverUrl(), optionsOf(apiKey())),
      make: this.make.bind(this),
      arrived: this.arrived.bind(this),
      offer: this.chooser.offer.bind(this.chooser),
      askForKey: this.askForKey.bind(this),
      say: (message: string) => this.notice.say(message),
      hold: (message: string | null) => this.notice.hold(message),
    };
    this.worlds = new Worlds<Session>(page, readLink(location.hash));
    this.connect();
    addEventListener("resize", () => this.resize());
    addEventListener("hashchange", () => this.follow(readLink(location.hash)));
  }

  /** The world on the screen. */
  get session(): Session | null {
    return this.worlds.current;
  }

  /** Whether another world is to be shown, and is not yet. */
  get isOpening(): boolean {
    return this.worlds.isOpening;
  }

  get isAway(): boolean {
    return this.worlds.recovery.isAway;
  }

  /** Opens what the link names. */
  async start(): Promise<void> {
    this.renderer.setAnimationLoop(() => {
      try {
        this.frame();
      } catch (error) {
        this.worlds.recovery.failed("page", error);
      }
    });
    await this.worlds.start();
  }

  setView(view: View): void {
    this.view = view;
    this.worlds.all.forEach((session) => session.setView(view));
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
    this.worlds.all.forEach((session) => session.moveTo(position, ahead));
  }

  async edit(strokes: readonly Stroke[]): Promise<void> {
    const { newest } = this.worlds;
    if (newest === null || newest.isRetired) {
      throw new Error("no world is shown that can be changed");
    }
    await newest.edit(strokes);
  }

  /** Digs or builds where the crosshair is. Returns whether there was anything. */
  async strike(op: "carve" | "fill"): Promise<boolean> {
    const { session } = this;
    if (session === null || session.isRetired || this.striking === session) {
      return false;
    }
    this.striking = session;
    try {
      const isHit = await session.strike(op, Number(this.radius.value));
      if (!isHit) {
        this.notice.say("Nothing within reach.");
      }
      return isHit;
    } catch (error) {
      this.worlds.refused(error, session);
      return false;
    } finally {
      this.striking = this.striking === session ? null : this.striking;
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
      const message = "The graphics card has let go of the picture. It comes back by itself, or when you reload.";
      this.worlds.recovery.note("picture", message);
    });
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.worlds.recovery.note("picture", null);
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
  private go(source: Source, keepsPlace: boolean): void {
    const { session, view } = this;
    const recipe = source.kind === "seed" ? source.recipe : "";
    if (keepsPlace && session !== null) {
      const like = isOwn(recipe) && !isOwn(session.likeness) ? session.likeness : null;
      void this.worlds.show({ ...session.place, source, like }, true);
      return;
    }
    const link: Link = {
      source,
      like: this.likes.get(recipe) ?? null,
      position: null,
      ahead: null,
      isWalking: false,
      view,
    };
    this.leave(link);
    void this.worlds.show(link);
  }

  /** The browser's button back leads to where the viewer is now. */
  private leave(link: Link): void {
    if (this.session !== null && !this.isOpening) {
      if (isSame(link.source, this.worlds.source)) {
        return;
      }
      history.replaceState(null, "", this.link());
    }
    history.pushState(null, "", writeLink(link));
  }

  private make(...[client, world, link, troubles]: Parameters<Page<Session>["make"]>): Session {
    const start = (name: string, shape: Parameters<typeof startOf>[1]): Start => {
      const { position, ahead } = startOf(name, shape);
      return { position: link.position ?? position, ahead: link.ahead ?? ahead };
    };
    this.remember(world.recipe.name, link.like);
    const session = new Session(this.renderer, client, world, link.like, start, innerHeight, troubles);
    session.setView(link.view);
    session.isPlaced = link.position !== null;
    return session;
  }

  private remember(recipe: string, like: string | null): void {
    if (like !== null) {
      this.likes.delete(recipe);
      this.likes.set(recipe, like);
    }
    if (this.likes.size > LIKES_MAX) {
      this.likes.delete(this.likes.keys().next().value!);
    }
  }

  private askForKey(entered: () => void, why: string): void {
    this.chooser.open();
    askForKey(() => {
      this.chooser.close();
      entered();
    }, why);
  }

  private arrived(_session: Session, link: Link, before: Session | null): void {
    this.setWalking(before?.motion.isWalking ?? link.isWalking);
    this.setView(before === null ? link.view : this.view);
    this.resize();
    this.linkedAt = -Infinity;
  }

  /** Somebody has changed the address. */
  private follow(link: Link): void {
    if (this.session === null || this.session.isRetired || this.isOpening || !isSame(link.source, this.worlds.source)) {
      void this.worlds.show(link);
    } else if (location.hash !== this.link()) {
      this.setWalking(link.isWalking);
      this.setView(link.view);
      if (link.position !== null) {
        this.moveTo(link.position, link.ahead);
      }
    }
  }

  private link(): string {
    return writeLink({ ...this.session!.place, source: this.worlds.source, view: this.view });
  }

  private frame(): void {
    const now = performance.now();
    const elapsed = Math.min((now - this.before) / 1000, 1);
    this.before = now;
    this.worlds.update();
    const { session } = this;
    if (session === null) {
      return;
    }
    session.pose.turn(...this.input.turn(elapsed));
    session.frame(this.input.wish, elapsed);
    this.frames += 1;
    this.threadMs += (performance.now() - now - this.threadMs) * SMOOTHING;
    this.frameMs += (1000 * elapsed - this.frameMs) * SMOOTHING;
    if (now - this.shownAt > FIGURES_MS) {
      this.shownAt = now;
      this.count();
      if (this.figures.isShown) {
        this.showFigures(session);
      }
    }
    if (now - this.linkedAt > LINK_MS && !this.isOpening) {
      this.linkedAt = now;
      const link = this.link();
      if (link !== location.hash) {
        history.replaceState(null, "", link);
      }
    }
  }

  private count(): void {
    const { client, recovery } = this.worlds;
    this.pulse
      .look(() => client.traffic())
      .then(
        (traffic) => (this.traffic = traffic ?? this.traffic),
        (error: unknown) => error instanceof WorkerFailed && recovery.failed("page", error),
      );
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
      "Frame to frame": `${this.frameMs.toFixed(1)} ms`,
      "Of it, scripts": `${this.threadMs.toFixed(1)} ms`,
    });
  }

  private resize(): void {
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, PIXEL_RATIO_MAX));
    this.renderer.setSize(innerWidth, innerHeight, false);
    this.worlds.all.forEach((session) => session.resize(innerWidth, innerHeight));
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
}

function isSame(one: Source, other: Source): boolean {
  return one.kind === "world"
    ? other.kind === "world" && one.id === other.id
    : other.kind === "seed" && one.seed === other.seed && one.recipe === other.recipe;
}

function optionsOf(key: string | null): ClientOptions {
  return key === null ? { retry: RETRY } : { retry: RETRY, apiKey: key };
}
