/** The panel of figures. */

import { element } from "./element.js";

export class Figures {
  private readonly panel = element("figures", HTMLElement);
  private readonly opens = element("show-figures", HTMLButtonElement);
  private readonly values = new Map<string, HTMLElement>();

  constructor() {
    this.opens.addEventListener("click", () => this.toggle());
  }

  get isShown(): boolean {
    return !this.panel.hidden;
  }

  toggle(): void {
    this.panel.hidden = !this.panel.hidden;
    this.opens.setAttribute("aria-expanded", String(this.isShown));
  }

  show(rows: Readonly<Record<string, string>>): void {
    for (const [name, value] of Object.entries(rows)) {
      let cell = this.values.get(name);
      if (cell === undefined) {
        const term = document.createElement("dt");
        term.textContent = name;
        cell = document.createElement("dd");
        this.panel.querySelector("dl")!.append(term, cell);
        this.values.set(name, cell);
      }
      if (cell.textContent !== value) {
        cell.textContent = value;
      }
    }
  }
}

export function bytesAsText(bytes: number): string {
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}
