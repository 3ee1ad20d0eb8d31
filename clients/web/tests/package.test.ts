/** The package as it would be published: what it exports, what it holds, and the examples of its page. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { test } from "node:test";

import { given } from "./pages.js";

const PACKAGE = JSON.parse(readFileSync("package.json", "utf8"));
const README = readFileSync("README.md", "utf8");

test("every file that is named in exports is packed, and so are types, page and licence", () => {
  const [packed] = JSON.parse(
    execFileSync("npm", ["pack", "--dry-run", "--json", "--ignore-scripts"], {
      encoding: "utf8",
      stdio: ["ignore", "pipe", "ignore"],
    }),
  );
  const paths: string[] = packed.files.map(({ path }: { path: string }) => path);
  for (const entry of Object.values<Record<string, string>>(PACKAGE.exports)) {
    for (const path of Object.values(entry)) {
      assert.ok(paths.includes(path.replace("./", "")), path);
    }
  }
  assert.ok(paths.includes("README.md") && paths.includes("LICENSE"));
  assert.ok(!paths.some((path) => path.startsWith("tests") || path.startsWith(".test")));
});

test("what is asked by name is there, and the base knows no three.js", async () => {
  const base = await import("chunkserver-client" as string);
  const three = await import("chunkserver-client/three" as string);
  assert.equal(typeof base.Client, "function");
  assert.equal(typeof three.ChunkGroup, "function");
  const modules = readdirSync("dist").filter((name) => name.endsWith(".js"));
  const importing = modules.filter((name) => /from "three"/.test(readFileSync(`dist/${name}`, "utf8")));
  assert.deepEqual(importing, ["three.js"]);
  assert.ok(!modules.some((name) => /from "\.\/three\.js"/.test(readFileSync(`dist/${name}`, "utf8"))));
});

test("the calls of the page are those of the client", async () => {
  const { Client, WorkerClient } = await import("chunkserver-client" as string);
  const methods = (kind: { prototype: object }) =>
    Object.getOwnPropertyNames(kind.prototype).filter((name) => name !== "constructor");
  const told = [...README.matchAll(/^\| (`\w+`(?:, `\w+`)*) \|/gm)].flatMap(([, names]) =>
    [...names!.matchAll(/`(\w+)`/g)].map(([, name]) => name!),
  );
  const inner = ["json"];
  assert.ok(told.includes("EditStream"));
  for (const name of methods(Client)) {
    assert.ok(inner.includes(name) || told.includes(name), name);
    assert.ok(inner.includes(name) || methods(WorkerClient).includes(name), name);
  }
});

for (const [at, [, example]] of [...README.matchAll(/^```js.*?\n(.*?)^```$/gms)].entries()) {
  test(`example ${at + 1} of the page runs`, () => {
    mkdirSync(".test/examples", { recursive: true });
    const path = `.test/examples/${at + 1}.mjs`;
    writeFileSync(path, example!.replaceAll("http://127.0.0.1:8000", given("CHUNKSERVER_URL")));
    const told = execFileSync(process.execPath, ["--experimental-websocket", "--no-warnings", path], {
      encoding: "utf8",
      timeout: 60_000,
    });
    assert.ok(told.length > 5, told);
  });
}

test("the page has the examples", () => assert.ok([...README.matchAll(/^```js/gm)].length >= 4));
