/** Keys, mouse and fingers, as one wish: where to go, how far to turn, what to do. */

import type { Wish } from "./motion.js";

/** What is done once, at the touch of a key, a button or a finger. */
export interface Commands {
  strike(op: "carve" | "fill"): void;
  /** Whether what was struck before is seen. */
  isSeen(): boolean;
  resize(times: number): void;
  toggleWalk(): void;
  setView(number: number): void;
  toggleFigures(): void;
  toggleHelp(): void;
}

/** Radians for a pixel of the mouse or of a finger, and a second of an arrow key. */
const MOUSE_RADIANS = 0.0023;
const FINGER_RADIANS = 0.0055;
const KEY_RADIANS = 1.7;
/** Pixels from the middle of the stick to its edge. */
const STICK_PIXELS = 52;
const BALL_STEP = 1.15;
/** Milliseconds between two strokes while a button is held. */
const REPEAT_MS = 220;
/** The same while the one before is not seen yet: faster ones would outdate each other's chunks on their way. */
const UNSEEN_MS = 1_000;
/** A move of the mouse that is larger is an error of the browser's. */
const MOVE_MAX = 400;

const MOVES: Readonly<Record<string, readonly [axis: "onwards" | "right" | "up", sign: number]>> = {
  KeyW: ["onwards", 1],
  KeyS: ["onwards", -1],
  KeyD: ["right", 1],
  KeyA: ["right", -1],
  Space: ["up", 1],
  KeyC: ["up", -1],
};
const TURNS: Readonly<Record<string, readonly [right: number, up: number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
};
const STRIKES: Readonly<Record<string, "carve" | "fill">> = { KeyE: "carve", KeyQ: "fill" };
/** What presses a button that has the focus. */
const PRESSES: ReadonlySet<string> = new Set(["Enter", "NumpadEnter", "Space"]);

export class Input {
  /** Shown where fingers are. */
  onTouch: () => void = () => {};
  onStick: (right: number, down: number) => void = () => {};
  private readonly held = new Set<string>();
  private turnedRight = 0;
  private turnedUp = 0;
  private stick: { id: number; x: number; y: number; right: number; down: number } | null = null;
  private finger: { id: number; x: number; y: number } | null = null;
  private striking: "carve" | "fill" | null = null;
  private struckAt = -Infinity;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly commands: Commands,
  ) {
    addEventListener("keydown", (event) => this.keyDown(event));
    addEventListener("keyup", (event) => this.keyUp(event.code));
    addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => this.release());
    document.addEventListener("pointerlockchange", () => this.isLocked || (this.striking = null));
    canvas.addEventListener("pointerdown", (event) => this.pointerDown(event));
    canvas.addEventListener("pointermove", (event) => this.pointerMove(event));
    for (const type of ["pointerup", "pointercancel"] as const) {
      canvas.addEventListener(type, (event) => this.pointerUp(event));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  get isLocked(): boolean {
    return document.pointerLockElement === this.canvas;
  }

  /** What is wished for now. */
  get wish(): Wish {
    const wish = { onwards: 0, right: 0, up: 0, isFast: this.held.has("ShiftLeft") || this.held.has("ShiftRight") };
    for (const [code, [axis, sign]] of Object.entries(MOVES)) {
      wish[axis] += this.held.has(code) ? sign : 0;
    }
    wish.right += this.stick?.right ?? 0;
    wish.onwards -= this.stick?.down ?? 0;
    return wish;
  }

  /** How far to turn, in radians, since it was asked before; strikes again while a button is held. */
  turn(elapsed: number): readonly [right: number, up: number] {
    let [right, up] = [this.turnedRight, this.turnedUp];
    this.turnedRight = this.turnedUp = 0;
    for (const [code, [rightwards, upwards]] of Object.entries(TURNS)) {
      if (this.held.has(code)) {
        right += rightwards * KEY_RADIANS * elapsed;
        up += upwards * KEY_RADIANS * elapsed;
      }
    }
    const waited = performance.now() - this.struckAt;
    if (this.striking !== null && waited > REPEAT_MS && (waited > UNSEEN_MS || this.commands.isSeen())) {
      this.strike(this.striking);
    }
    return [right, up];
  }

  /** A button of the page is held like a key. */
  hold(button: HTMLElement, code: string): void {
    const down = () => this.held.add(code);
    const up = () => this.held.delete(code);
    button.addEventListener("pointerdown", down);
    button.addEventListener("keydown", (event) => PRESSES.has(event.code) && down());
    button.addEventListener("keyup", (event) => PRESSES.has(event.code) && up());
    for (const type of ["pointerup", "pointercancel", "pointerleave", "blur"] as const) {
      button.addEventListener(type, up);
    }
    button.addEventListener("contextmenu", (event) => event.preventDefault()); // of a finger that stays
  }

  /** Nothing is held any more: what comes up from now on may be told to others. */
  private release(): void {
    this.held.clear();
    this.striking = this.stick = this.finger = null;
    this.onStick(0, 0);
  }

  private strike(op: "carve" | "fill"): void {
    this.struckAt = performance.now();
    this.commands.strike(op);
  }

  private keyDown(event: KeyboardEvent): void {
    if (event.key === "Meta") {
      this.release(); // a Mac tells of no key that comes up while Cmd is down
    }
    if (!this.isOurs(event) || event.ctrlKey || event.metaKey || event.altKey) {
      return;
    }
    const { code } = event;
    if (code in MOVES || code in TURNS || code.startsWith("Shift")) {
      this.held.add(code);
    } else if (code in STRIKES) {
      this.striking = STRIKES[code]!;
      if (!event.repeat) {
        this.strike(this.striking);
      }
    } else if (!this.press(event)) {
      return;
    }
    event.preventDefault();
  }

  /** Whether a key is for the world: of the buttons around it, those that no button has a use for are as well. */
  private isOurs({ target, code }: KeyboardEvent): boolean {
    const isAround = target instanceof Element && target.closest("header, footer, #touch") !== null;
    return target === document.body || target === this.canvas || (isAround && /^(Key|Shift|Digit)/.test(code));
  }

  private press({ code, key, repeat }: KeyboardEvent): boolean {
    if (key === "+" || key === "=" || key === "-") {
      this.commands.resize(key === "-" ? 1 / BALL_STEP : BALL_STEP);
    } else if (repeat) {
      return false;
    } else if (/^Digit[1-4]$/.test(code)) {
      this.commands.setView(Number(code.at(-1)) - 1);
    } else if (code === "KeyF") {
      this.commands.toggleWalk();
    } else if (code === "KeyP") {
      this.commands.toggleFigures();
    } else if (code === "KeyH" || key === "?") {
      this.commands.toggleHelp();
    } else {
      return false;
    }
    return true;
  }

  private keyUp(code: string): void {
    this.held.delete(code);
    if (STRIKES[code] === this.striking) {
      this.striking = null;
    }
  }

  private pointerDown(event: PointerEvent): void {
    this.canvas.focus({ preventScroll: true });
    if (event.pointerType === "touch") {
      this.fingerDown(event);
    } else if (this.isLocked) {
      this.striking = event.button === 0 ? "carve" : event.button === 2 ? "fill" : null;
      if (this.striking !== null) {
        this.strike(this.striking);
      }
    } else {
      void this.lock();
    }
  }

  private async lock(): Promise<void> {
    try {
      await this.canvas.requestPointerLock();
    } catch {
      // not allowed here, or too soon after Esc: the keys turn as well
    }
  }

  private pointerMove(event: PointerEvent): void {
    if (event.pointerType === "touch") {
      this.fingerMove(event);
    } else if (this.isLocked && Math.abs(event.movementX) + Math.abs(event.movementY) < MOVE_MAX) {
      this.turnedRight += event.movementX * MOUSE_RADIANS;
      this.turnedUp -= event.movementY * MOUSE_RADIANS;
    }
  }

  private pointerUp(event: PointerEvent): void {
    if (event.pointerId === this.stick?.id) {
      this.stick = null;
      this.onStick(0, 0);
    } else if (event.pointerId === this.finger?.id) {
      this.finger = null;
    } else if (event.pointerType !== "touch") {
      this.striking = null;
    }
  }

  /** The left half of the canvas moves, the right half looks around. */
  private fingerDown({ pointerId: id, clientX: x, clientY: y }: PointerEvent): void {
    this.onTouch();
    if (x < innerWidth / 2 && this.stick === null) {
      this.stick = { id, x, y, right: 0, down: 0 };
    } else if (this.finger === null) {
      this.finger = { id, x, y };
    }
  }

  private fingerMove({ pointerId, clientX, clientY }: PointerEvent): void {
    if (pointerId === this.stick?.id) {
      const [x, y] = [(clientX - this.stick.x) / STICK_PIXELS, (clientY - this.stick.y) / STICK_PIXELS];
      const length = Math.max(1, Math.hypot(x, y));
      [this.stick.right, this.stick.down] = [x / length, y / length];
      this.onStick(this.stick.right, this.stick.down);
    } else if (pointerId === this.finger?.id) {
      this.turnedRight += (clientX - this.finger.x) * FINGER_RADIANS;
      this.turnedUp -= (clientY - this.finger.y) * FINGER_RADIANS;
      [this.finger.x, this.finger.y] = [clientX, clientY];
    }
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    this.commands.resize(event.deltaY < 0 ? BALL_STEP : 1 / BALL_STEP);
  }
}
