/** Counts, in a worker, what comes over the network: to be imported before anything that fetches. */

/** What the worker says beside the answers to calls. */
export interface Traffic {
  readonly traffic: { readonly bytes: number; readonly chunks: number };
}

const fetchPlain = globalThis.fetch;

globalThis.fetch = async (input, init) => {
  if (typeof init?.body === "string" && String(input).includes("/chunks")) {
    tell({ bytes: 0, chunks: (JSON.parse(init.body) as { chunks: unknown[] }).chunks.length });
  }
  const response = await fetchPlain(input, init);
  if (response.body === null) {
    return response;
  }
  const counted = response.body.pipeThrough(
    new TransformStream<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>({
      transform(piece, controller) {
        tell({ bytes: piece.byteLength, chunks: 0 });
        controller.enqueue(piece);
      },
    }),
  );
  const { status, statusText, headers } = response;
  return new Response(counted, { status, statusText, headers });
};

function tell(traffic: Traffic["traffic"]): void {
  postMessage({ traffic } satisfies Traffic);
}
