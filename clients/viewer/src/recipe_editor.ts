/** The recipe as JSON: checked by the server as it is typed, and shown as soon as it is right. */

import { BadRequest, type Recipe, type RecipeTree } from "chunkserver-client";

import { element } from "./element.js";
import { isOpen, verdictOn } from "./failures.js";
import { lineOf, lineOfError } from "./json_place.js";

/** Milliseconds without a key before the server is asked. */
const PAUSE_MS = 350;
/** Before the server is asked again, if it was away. */
const AGAIN_MS = 3000;
const LINE_PIXELS = 18;
/** From the top of the box to that of the first line. */
const PADDING_PIXELS = 12;

export class RecipeEditor {
  private readonly text = element("json", HTMLTextAreaElement);
  private readonly error = element("json-error", HTMLParagraphElement);
  private readonly mark = element("marked", HTMLDivElement);
  private timer: ReturnType<typeof setTimeout> | undefined;
  private line: number | null = null;
  private asked = 0;
  private digest = "";

  /**
   * @param server makes a recipe known to the server, which may refuse it
   * @param changed called with a recipe that can be built
   */
  constructor(
    private readonly server: (tree: RecipeTree) => Promise<Recipe>,
    private readonly changed: (recipe: Recipe) => void,
  ) {
    this.text.addEventListener("input", () => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => void this.check(), PAUSE_MS);
    });
    this.text.addEventListener("scroll", () => this.placeMark());
    this.say("", null);
  }

  /** What is shown now. Text that makes it stays as it is. */
  show(recipe: Recipe): void {
    if (recipe.digest !== this.digest) {
      this.digest = recipe.digest;
      this.text.value = JSON.stringify(recipe.expression, null, 2);
      this.say("", null);
    }
  }

  private async check(): Promise<void> {
    const [text, number] = [this.text.value, ++this.asked];
    let tree: RecipeTree;
    try {
      tree = JSON.parse(text) as RecipeTree;
    } catch (error) {
      this.say((error as Error).message, lineOfError(text, error as SyntaxError));
      return;
    }
    try {
      const recipe = await this.server(tree);
      if (number === this.asked) {
        this.say("", null);
        if (recipe.digest !== this.digest) {
          this.digest = recipe.digest;
          this.changed(recipe);
        }
      }
    } catch (error) {
      if (number === this.asked) {
        this.refuse(text, error);
      }
    }
  }

  private refuse(text: string, error: unknown): void {
    if (error instanceof BadRequest && typeof error.values["path"] === "string") {
      const path = error.values["path"];
      this.say(`${path || "At the root"}: ${expectedOf(error)}`, lineOf(text, path));
    } else if (error instanceof RangeError) {
      this.say(error.message, null); // nothing that can be sent: a number that is infinite
    } else {
      this.say(verdictOn(error).message, null);
      if (isOpen(error)) {
        this.timer = setTimeout(() => void this.check(), AGAIN_MS);
      }
    }
  }

  private say(message: string, line: number | null): void {
    this.line = line;
    this.error.textContent = line === null ? message : `Line ${line + 1}. ${message}`;
    this.text.setAttribute("aria-invalid", String(message !== ""));
    this.placeMark();
  }

  private placeMark(): void {
    this.mark.hidden = this.line === null;
    this.mark.style.top = `${PADDING_PIXELS + (this.line ?? 0) * LINE_PIXELS - this.text.scrollTop}px`;
  }
}

/** What should be there, as a whole: a server cuts off what is long in a value, but not in the detail that has it too. */
function expectedOf({ detail, values }: BadRequest): string {
  const expected = String(values["expected"] ?? detail);
  const at = detail.indexOf(expected);
  return at < 0 ? expected : detail.slice(at);
}
