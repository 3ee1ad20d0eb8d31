/** The element with an id, of the kind that it is in index.html. */
export function element<Kind extends HTMLElement>(id: string, kind: new () => Kind): Kind {
  const found = document.getElementById(id);
  if (!(found instanceof kind)) {
    throw new TypeError(`#${id} is no ${kind.name}`);
  }
  return found;
}
