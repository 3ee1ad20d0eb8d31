/** The key of a server that wants one: kept in this tab, and sent nowhere else. */

import { element } from "./element.js";

const KEPT_AS = "chunkserver.key";

/** Where the browser keeps nothing, until the page is left. */
let inMemory: string | null = null;

/** Null without one that a header can have. */
export function apiKey(): string | null {
  const key = inMemory ?? kept();
  return key !== null && /^[!-~]+$/.test(key) ? key : null;
}

/** Shows where a key can be entered. entered: called when there is another one */
export function askForKey(entered: () => void): void {
  element("world", HTMLElement).hidden = false;
  const form = element("unlock", HTMLFormElement);
  form.hidden = false;
  form.onsubmit = (event) => {
    event.preventDefault();
    form.hidden = true;
    keep(element("key", HTMLInputElement).value.trim());
    entered();
  };
}

function kept(): string | null {
  try {
    return sessionStorage.getItem(KEPT_AS);
  } catch {
    return null; // storage is switched off
  }
}

function keep(key: string): void {
  inMemory = key;
  try {
    sessionStorage.setItem(KEPT_AS, key);
  } catch {
    // then it is in memory alone
  }
}
