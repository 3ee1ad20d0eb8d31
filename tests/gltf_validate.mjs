// node gltf_validate.mjs a.glb b.glb ...
// Prints one JSON array: the Khronos validator's report on each file, in the order of the arguments.
import { readFile } from "node:fs/promises";
import { validateBytes } from "gltf-validator";

const validate = async (path) =>
  // The format is given: a file that is no GLB at all gets a report with an error in it, too.
  validateBytes(new Uint8Array(await readFile(path)), { uri: path, format: "glb", writeTimestamp: false });

console.log(JSON.stringify(await Promise.all(process.argv.slice(2).map(validate))));
