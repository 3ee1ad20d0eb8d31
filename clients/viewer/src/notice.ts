/** What people are told: for a few seconds, or for as long as it holds. */

import { element } from "./element.js";

const SHOWN_MS = 3500;

export class Notice {
  private readonly box = element("notice", HTMLDivElement);
  private lasting: string | null = null;
  /** While something is said. */
  private timer: ReturnType<typeof setTimeout> | null = null;

  /** For a few seconds, whatever holds meanwhile. */
  say(message: string): void {
    clearTimeout(this.timer ?? undefined);
    this.show(message, false);
    this.timer = setTimeout(() => {
      this.timer = null;
      this.show(this.lasting, true);
    }, SHOWN_MS);
  }

  /** Until something else holds; null is nothing. */
  hold(message: string | null): void {
    this.lasting = message;
    if (this.timer === null) {
      this.show(message, true);
    }
  }

  private show(message: string | null, isLasting: boolean): void {
    this.box.hidden = message === null;
    this.box.textContent = message;
    this.box.classList.toggle("lasting", isLasting);
  }
}
