/** One world after another: which one is shown, and what becomes of it when something fails. It knows no page. */

import { NotFound, type AnyWorld, type ChunkClient, type Recipe } from "chunkserver-client";

import { CLOCK, type Clock } from "./clock.js";
import { verdictOn } from "./failures.js";
import type { Link } from "./link.js";
import { Recovery, type Part } from "./recovery.js";
import { EditFailed } from "./sending.js";
import { Showing, type Shown } from "./showing.js";
import { open, type Source } from "./world.js";

/** Whoever is told what goes wrong with a world. */
export interface Troubles {
  /** Nothing more is fetched until it is resumed. */
  chunksFailed(error: unknown): void;
  /** The world is not what it was, or nothing of it is heard: nothing more is done until it is resumed. */
  failed(error: unknown): void;
  /** Edits of others come late from now on, and why; null: at once again. */
  late(error: unknown): void;
  /** An own edit is sent once more, and why; null: all are through. */
  delayed(error: unknown): void;
}

/** A world on the screen, or on its way there. */
export interface WorldShown<Self> extends Shown<Self> {
  readonly world: AnyWorld;
  /** From where it is seen, and how. */
  readonly place: Omit<Link, "source">;
  resume(part: Part): void;
}

export type Server = ChunkClient & { close(): void };

/** Where worlds are shown. */
export interface Page<World> {
  /** Another client each time. */
  connect(): Server;
  make(client: Server, world: AnyWorld, link: Link, troubles: Troubles): World;
  /** A world is on the screen from now on. before: the one in whose place it is, if it is seen from there too */
  arrived(world: World, link: Link, before: World | null): void;
  /** What there is to choose from, and what is chosen; nothing if no world is shown. */
  offer(recipes: readonly Recipe[], chosen: AnyWorld | null): void;
  askForKey(entered: () => void, why: string): void;
  /** For a few seconds. */
  say(message: string): void;
  /** For as long as it is so; null is nothing. */
  hold(message: string | null): void;
}

export class Worlds<World extends WorldShown<World>> {
  client: Server;
  readonly recovery: Recovery;
  /** What is on the screen. */
  source: Source;
  private readonly showing: Showing<World>;
  private recipes: readonly Recipe[] = [];
  /** Whether the viewer stays where they are when that comes. */
  private keepsPlace = false;
  /** What was shown last: it goes on where what is wanted cannot be had. */
  private begun: Link | null = null;
  /** How many were to be shown; which of them the last was that has come of it, or never will. */
  private asked = 0;
  private answered = 0;

  /** @param wanted what is to be shown: `start` does */
  constructor(
    private readonly page: Page<World>,
    private wanted: Link,
    clock: Clock = CLOCK,
  ) {
    this.client = page.connect();
    this.source = wanted.source;
    this.showing = new Showing(clock);
    const host = {
      ready: () => this.client.waitUntilReady(0),
      resume: (part: Part) => this.resume(part),
      reopen: () => this.reopen(),
      askForKey: (why: string) => this.askForKey(why),
      tell: (message: string | null) => page.hold(message),
    };
    this.recovery = new Recovery(host, clock);
  }

  /** The one on the screen. */
  get current(): World | null {
    return this.showing.current;
  }

  /** The one that was shown last: that, or the one which takes its place. */
  get newest(): World | null {
    return this.showing.newest;
  }

  /** Both of them. */
  get all(): World[] {
    return this.showing.all;
  }

  /** Whether another world is to be shown, and is not yet. */
  get isOpening(): boolean {
    return this.answered < this.asked || this.showing.isChanging;
  }

  start(): Promise<void> {
    return this.show(this.wanted);
  }

  /** Once a frame, before anything is drawn. */
  update(): void {
    this.showing.update();
  }

  /** keepsPlace: the viewer stays where they are, and moves on meanwhile */
  async show(link: Link, keepsPlace = false): Promise<void> {
    const number = ++this.asked;
    this.wanted = link;
    this.keepsPlace = keepsPlace;
    this.recovery.forget("world");
    try {
      const [world, recipes] = await Promise.all([this.open(link.source), this.client.recipes()]);
      if (number === this.asked) {
        this.recipes = recipes;
        this.begin(link, world, keepsPlace);
        this.answered = number;
      }
    } catch (error) {
      if (number === this.asked) {
        this.notOpened(error, keepsPlace);
      }
    }
  }

  /** An edit is lost, or nobody knows. */
  refused(error: unknown, world: World): void {
    const why = error instanceof EditFailed ? error.cause : error;
    const { remedy, message } = verdictOn(why);
    this.page.say(error instanceof EditFailed ? error.message : message);
    if (remedy === "key") {
      this.askForKey(message);
    } else if (remedy === "reopen" && this.isLive(world)) {
      this.recovery.failed("edits", why);
    }
  }

  /** A server that was started anew has forgotten the recipe of whoever wrote one: what is shown still has it. */
  private async open(source: Source): Promise<AnyWorld> {
    const { client, newest } = this;
    try {
      return await open(client, source);
    } catch (error) {
      const recipe = newest?.world.recipe;
      if (!(error instanceof NotFound) || source.kind !== "seed" || source.recipe !== recipe?.digest) {
        throw error;
      }
      await client.postRecipe(recipe.expression);
      return open(client, source);
    }
  }

  private begin(link: Link, opened: AnyWorld, keepsPlace: boolean): void {
    const { recovery } = this;
    const told = (tell: (error: unknown) => void) => (error: unknown) => this.isLive(world) && tell(error);
    const world: World = this.page.make(this.client, opened, link, {
      chunksFailed: told((error) => recovery.failed("chunks", error)),
      failed: told((error) => recovery.failed("edits", error)),
      late: told((error) => this.late(error)),
      delayed: (error) => recovery.note("own", error === null ? null : "Your last change is sent again."),
    });
    recovery.forget();
    this.begun = link;
    this.showing.begin(world, keepsPlace, (before) => {
      this.source = link.source;
      this.page.arrived(world, link, keepsPlace ? before : null);
      if (link === this.wanted) {
        this.page.offer(this.recipes, opened); // who has chosen another one meanwhile sees that chosen
      }
    });
  }

  private isLive(world: World): boolean {
    return world === this.showing.newest && !world.isRetired;
  }

  private notOpened(error: unknown, keepsPlace: boolean): void {
    const { newest, begun } = this;
    const { remedy, message } = verdictOn(error, true);
    if (remedy === "stop" && newest !== null && begun !== null && this.isLive(newest)) {
      this.answered = this.asked; // what is shown goes on
      this.wanted = begun;
      this.page.say(message);
      if (!keepsPlace) {
        this.page.offer(this.recipes, newest.world); // whose recipe is edited goes on with it
      }
      return;
    }
    this.recovery.failed("world", error);
    if (newest === null) {
      this.client.recipes().then(
        (recipes) => this.current ?? this.page.offer(recipes, null),
        () => {}, // then there is nothing to choose from
      );
    }
  }

  private late(error: unknown): void {
    if (error !== null) {
      const why = error instanceof Error ? ` (${error.message})` : "";
      this.page.say(`What others change is seen a little later: no stream tells of it${why}.`);
    }
  }

  /** A world that is left stays as it is. */
  private resume(part: Part): void {
    const { newest } = this;
    if (part === "world") {
      void this.show(this.wanted, this.keepsPlace);
    } else if (newest?.isRetired === false) {
      newest.resume(part);
    }
  }

  /** The world is not what it was: its last picture stays until there is one of what it is now. */
  private reopen(): void {
    const { newest } = this.showing;
    newest?.retire();
    if (newest === null || this.answered < this.asked) {
      void this.show(this.wanted, this.keepsPlace);
    } else {
      void this.show({ ...newest.place, source: this.wanted.source }, true);
    }
  }

  private askForKey(why: string): void {
    this.page.askForKey(() => {
      this.all.forEach((world) => world.retire());
      this.client.close();
      this.client = this.page.connect();
      this.recovery.forget();
      this.reopen();
    }, why);
  }
}
