/** The worked examples of docs/, and what the surroundings of a test hand over. */

import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

/** Tests run in the folder of the package. */
const DOCS = new URL("../../docs/", pathToFileURL(`${process.cwd()}/`));

export function page(name: string): string {
  return readFileSync(new URL(name, DOCS), "utf8");
}

/** The bytes of the one block that is fenced as ```hex name. */
export function hexdump(page: string, name: string): Uint8Array<ArrayBuffer> {
  const rows = block(page, `hex ${name}`)
    .trim()
    .split("\n")
    .map((row) => row.trim().replace(/^\S+\s+/, ""));
  return bytesOf(rows.join(" ").replaceAll(/\s/g, ""));
}

/** The JSON of the one block that is fenced as ```json name. */
export function stated(page: string, name: string): any {
  return JSON.parse(block(page, `json ${name}`));
}

export function bytesOf(hex: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(hex.match(/../g) ?? [], (byte) => parseInt(byte, 16));
}

/** What pytest hands over. A test that cannot have it fails. */
export function given(name: string): string {
  const value = process.env[name];
  if (value === undefined) {
    throw new Error(`${name} is not set: these tests are run by pytest, tests/web`);
  }
  return value;
}

function block(page: string, fence: string): string {
  const found = [...page.matchAll(new RegExp(`^\`\`\`${fence}\\n(.*?)^\`\`\`$`, "gms"))];
  if (found.length !== 1) {
    throw new Error(`${found.length} blocks are fenced as ${fence}`);
  }
  return found[0]![1]!;
}
