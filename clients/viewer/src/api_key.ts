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

/** Shows where a key can be entered, and why. entered: called when there is another one */
export function askForKey(entered: () => void, why: string): void {
  const error = element("key-error", HTMLParagraphElement);
  error.textContent = why;
  const form = element("unlock", HTMLFormElement);
  if (form.hidden) {
    form.hidden = false;
    document.exitPointerLock();
    element("key", HTMLInputElement).focus();
  }
  form.onsubmit = (event) => {
    event.preventDefault();
    form.hidden = true;
    error.textContent = "";
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
