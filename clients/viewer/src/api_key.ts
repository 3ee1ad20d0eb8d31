/** The key of a server that wants one: kept in this tab, and sent nowhere else. */

import { element } from "./element.js";

const KEPT_AS = "chunkserver.key";

/** Null without one that a header can have. */
export function apiKey(): string | null {
  const key = sessionStorage.getItem(KEPT_AS);
  return key !== null && /^[!-~]+$/.test(key) ? key : null;
}

/** Shows where a key can be entered; with another one, the page begins anew. */
export function askForKey(): void {
  element("world", HTMLElement).hidden = false;
  const form = element("unlock", HTMLFormElement);
  form.hidden = false;
  form.onsubmit = (event) => {
    event.preventDefault();
    sessionStorage.setItem(KEPT_AS, element("key", HTMLInputElement).value.trim());
    location.reload();
  };
}
