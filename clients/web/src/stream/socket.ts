/** One WebSocket, from its opening to its end. */

import type { WireFrame } from "./messages.js";

const SUBPROTOCOL = "chunkserver.v1";
export const OPEN_SECONDS = 5;
/** How often somebody looks whether a connection has fallen silent. */
const WATCH_SECONDS = 0.25;
/** The code of whoever leaves. */
export const LEFT = 1000;
/** A close event's code where there was no closing frame. */
const NO_CODES: readonly number[] = [1005, 1006];

/** Whoever a socket is for. */
export interface Carried {
  /** Whether the connection is of no use any more. */
  readonly isBroken: boolean;
  opened(send: (frame: WireFrame) => void): void;
  received(frame: string | ArrayBuffer): void;
}

/** How a connection has ended. */
export interface End {
  /** null if there was no closing frame. */
  readonly code: number | null;
  /** Whether there was one at all. */
  readonly isOpened: boolean;
}

/** Carries messages until the socket is closed, of no use any more, or `left` is aborted. It never rejects. */
export function carry(url: URL, carried: Carried, left: AbortSignal): Promise<End> {
  const socket = new WebSocket(url, SUBPROTOCOL);
  socket.binaryType = "arraybuffer";
  return new Promise((resolve) => {
    let isOpened = false;
    const opening = setTimeout(() => over(null), 1000 * OPEN_SECONDS);
    const watching = setInterval(() => carried.isBroken && over(null), 1000 * WATCH_SECONDS);
    const leave = () => over(LEFT);
    const over = (code: number | null) => {
      clearTimeout(opening);
      clearInterval(watching);
      left.removeEventListener("abort", leave);
      socket.onmessage = socket.onclose = socket.onerror = null;
      socket.onopen = () => socket.close(LEFT); // if it comes after all
      if (socket.readyState === WebSocket.OPEN) {
        socket.close(LEFT);
      }
      resolve({ code, isOpened });
    };
    left.addEventListener("abort", leave);
    socket.onopen = () => {
      isOpened = true;
      clearTimeout(opening);
      carried.opened((frame) => socket.readyState === WebSocket.OPEN && socket.send(frame));
    };
    socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
      carried.received(data);
      if (carried.isBroken) {
        over(null);
      }
    };
    socket.onerror = () => isOpened || over(null); // one that is open is closed next, with a code
    socket.onclose = ({ code }) => over(NO_CODES.includes(code) ? null : code);
  });
}
