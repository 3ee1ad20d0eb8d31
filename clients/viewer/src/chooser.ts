/** The panel in which a world is chosen: its recipe, its seed, its recipe's text. */

import type { AnyWorld, Recipe, RecipeTree } from "chunkserver-client";

import { element } from "./element.js";
import { SEED_FIRST, seedOf } from "./link.js";
import { RecipeEditor } from "./recipe_editor.js";
import { SEED_MAX, type Source } from "./world.js";

const CHANCE_MAX = 1_000_000;

export class Chooser {
  private readonly panel = element("world", HTMLElement);
  private readonly opens = element("show-world", HTMLButtonElement);
  private readonly recipe = element("recipe", HTMLSelectElement);
  private readonly seed = element("seed", HTMLInputElement);
  private readonly error = element("seed-error", HTMLParagraphElement);
  private readonly describes = element("describes", HTMLParagraphElement);
  private readonly editor: RecipeEditor;
  private readonly described = new Map<string, string>();
  /** By digest, of recipes that have a name. */
  private readonly names = new Map<string, string>();
  /** Whether the seed that is in the field was entered since the last one was chosen. */
  private isSeedTyped = false;

  /**
   * @param check makes a recipe known to the server, which may refuse it
   * @param chosen called with the world to show. keepsPlace: the viewer stays where they are
   */
  constructor(
    check: (tree: RecipeTree) => Promise<Recipe>,
    private readonly chosen: (source: Source, keepsPlace: boolean) => void,
  ) {
    this.editor = new RecipeEditor(check, ({ digest }) => this.choose(this.names.get(digest) ?? digest, true));
    this.seed.addEventListener("input", () => {
      this.isSeedTyped = true;
      this.refuse(null);
    });
    this.opens.addEventListener("click", () => this.toggle());
    this.panel.addEventListener("keydown", ({ key }) => {
      if (key === "Escape") {
        this.toggle();
        this.opens.focus();
      }
    });
    element("choose", HTMLFormElement).addEventListener("submit", (event) => {
      event.preventDefault();
      this.choose(this.recipe.value, false);
    });
    this.recipe.addEventListener("change", () => this.choose(this.recipe.value, false));
    element("chance", HTMLButtonElement).addEventListener("click", () => {
      this.seed.value = String(Math.floor(Math.random() * CHANCE_MAX));
      this.isSeedTyped = false;
      this.choose(this.recipe.value, false);
    });
  }

  /** What there is to choose from, and what is chosen: nothing if no world is shown. */
  offer(recipes: readonly Recipe[], chosen: AnyWorld | null): void {
    this.recipe.replaceChildren(...recipes.map(({ name }) => new Option(titled(name), name)));
    for (const { name, digest, description } of recipes) {
      this.described.set(name, description);
      this.names.set(digest, name);
    }
    if (chosen !== null) {
      this.show(chosen);
    } else {
      this.seed.value ||= String(SEED_FIRST);
      this.open();
    }
  }

  private show(world: AnyWorld): void {
    const { name } = world.recipe;
    if (![...this.recipe.options].some(({ value }) => value === name)) {
      this.recipe.append(new Option(`Your own, ${name.slice(0, 8)}`, name));
    }
    this.recipe.value = name;
    if (!this.isSeedTyped) {
      this.seed.value = String(world.seed); // else somebody is about to enter another one
      this.refuse(null);
    }
    this.describes.textContent = this.described.get(name) ?? "";
    this.editor.show(world.recipe);
    const title = `${this.recipe.selectedOptions[0]?.text ?? name}, seed ${world.seed}`;
    element("title", HTMLSpanElement).textContent = title;
    document.title = `${title} · chunkserver`;
  }

  private choose(recipe: string, keepsPlace: boolean): void {
    const seed = seedOf(this.seed.value);
    this.refuse(seed === null ? `A seed is a whole number from ${-SEED_MAX - 1n} to ${SEED_MAX}.` : null);
    if (seed !== null) {
      this.isSeedTyped = false;
      this.chosen({ kind: "seed", seed, recipe }, keepsPlace);
    }
  }

  /** Says what is wrong with the seed; null is nothing. */
  private refuse(why: string | null): void {
    this.seed.setAttribute("aria-invalid", String(why !== null));
    this.error.textContent = why;
  }

  open(): void {
    if (this.panel.hidden) {
      this.toggle();
    }
  }

  close(): void {
    if (!this.panel.hidden) {
      this.toggle();
    }
  }

  private toggle(): void {
    this.panel.hidden = !this.panel.hidden;
    this.opens.setAttribute("aria-expanded", String(!this.panel.hidden));
    if (!this.panel.hidden) {
      this.recipe.focus();
    }
  }
}

function titled(name: string): string {
  return name.charAt(0).toUpperCase() + name.slice(1).replaceAll("-", " ");
}
