/** In which line of a JSON text the value at a path is: "a.b.0" as the server writes it. */

/** The line, from 0, in which the value at `path` begins; of the nearest value around it if there is none. */
export function lineOf(text: string, path: string): number {
  const wanted = path.split(/[./[\]]+/).filter(Boolean);
  let at = 0;
  let best = { depth: -1, at: 0 };
  const blank = () => {
    while (/\s/.test(text[at] ?? "")) {
      at += 1;
    }
  };
  const word = () => {
    const found = /"(?:[^"\\]|\\.)*"|[^\s,:[\]{}]+/y;
    found.lastIndex = at;
    const [token = ""] = found.exec(text) ?? [];
    at += token.length || 1;
    return token;
  };
  const value = (depth: number, isOnPath: boolean): void => {
    blank();
    if (isOnPath && depth > best.depth) {
      best = { depth, at };
    }
    const open = text[at];
    if (open !== "{" && open !== "[") {
      word();
      return;
    }
    at += 1;
    for (let index = 0; at < text.length; index++) {
      blank();
      if (text[at] === "}" || text[at] === "]") {
        at += 1;
        return;
      }
      let name = String(index);
      if (open === "{") {
        name = word().slice(1, -1);
        blank();
        at += 1;
      }
      value(depth + 1, isOnPath && wanted[depth] === name);
      blank();
      at += text[at] === "," ? 1 : 0;
    }
  };
  value(0, true);
  return text.slice(0, best.at).split("\n").length - 1;
}

/** The line of which a parser complains; null if its message does not say. */
export function lineOfError(text: string, error: SyntaxError): number | null {
  const [, position] = /position (\d+)/.exec(error.message) ?? [];
  const [, line] = /line (\d+)/.exec(error.message) ?? [];
  return position !== undefined
    ? text.slice(0, Number(position)).split("\n").length - 1
    : line === undefined
      ? null
      : Number(line) - 1;
}
