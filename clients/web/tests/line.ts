/** A TCP proxy in front of the server, which a test cuts and holds still. */

import { createServer, connect, type AddressInfo, type Server, type Socket } from "node:net";

export class Line {
  /** How many connections there were. */
  opened = 0;
  private readonly open = new Set<Socket>();

  private constructor(
    private readonly listening: Server,
    readonly url: string,
  ) {}

  static async to(target: string): Promise<Line> {
    const { hostname, port } = new URL(target);
    const listening = createServer();
    await new Promise<void>((resolve) => listening.listen(0, "127.0.0.1", resolve));
    const line = new Line(listening, `http://127.0.0.1:${(listening.address() as AddressInfo).port}`);
    listening.on("connection", (near) => line.join(near, connect(Number(port), hostname)));
    return line;
  }

  /** Breaks all connections as they are, without a word. */
  cut(): void {
    this.open.forEach((socket) => socket.destroy());
  }

  /** Hands nothing on any more on the connections that there are; new ones are as always. */
  hold(): void {
    this.open.forEach((socket) => socket.unpipe().pause());
  }

  close(): void {
    this.cut();
    this.listening.close();
  }

  private join(near: Socket, far: Socket): void {
    this.opened += 1;
    for (const [socket, other] of [
      [near, far],
      [far, near],
    ] as const) {
      this.open.add(socket);
      socket.pipe(other);
      socket.on("error", () => {});
      socket.on("close", () => {
        this.open.delete(socket);
        other.destroy();
      });
    }
  }
}
