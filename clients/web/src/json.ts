/**
 * JSON that somebody else wrote: what is asked of it is there and of the right type, or the error says where.
 *
 *     Json.parse(text, BadChunk).at("nodes").at(0).at("extras").at("lod").text()
 */

import { BadAnswer } from "./errors.js";

const SHOWN_CHARACTERS_MAX = 80;

/** One value of a JSON text, and the way to it. */
export class Json {
  private constructor(
    readonly value: unknown,
    private readonly error: typeof BadAnswer,
    private readonly above: Json | null,
    private readonly name: string | number,
  ) {}

  /** @throws `error` if it is no JSON. */
  static parse(text: string, error: typeof BadAnswer = BadAnswer): Json {
    try {
      return new Json(JSON.parse(text), error, null, "$");
    } catch (cause) {
      throw new error(`no JSON: ${String(cause).slice(0, SHOWN_CHARACTERS_MAX)}`);
    }
  }

  /** Throws the error that says what was expected here. */
  refuse(expected: string): never {
    throw new this.error(`${this.path()}: expected ${expected}, found ${shown(this.value)}`);
  }

  at(name: string | number): Json {
    return this.get(name) ?? new Json(null, this.error, this, name).refuse("a value");
  }

  /** A member of an object or an element of a list; null if it is not there, or null. */
  get(name: string | number): Json | null {
    const holder = typeof name === "string" ? this.members() : this.list();
    const found = Object.hasOwn(holder, name) ? (holder as Record<string | number, unknown>)[name] : null;
    return found === null || found === undefined ? null : new Json(found, this.error, this, name);
  }

  elements(): Json[] {
    return this.list().map((value, at) => new Json(value, this.error, this, at));
  }

  members(): Readonly<Record<string, unknown>> {
    const value = this.value;
    const isObject = typeof value === "object" && value !== null && !Array.isArray(value);
    return isObject ? (value as Record<string, unknown>) : this.refuse("an object");
  }

  text(): string {
    return typeof this.value === "string" ? this.value : this.refuse("a string");
  }

  texts(): string[] {
    return this.elements().map((element) => element.text());
  }

  oneOf<Known extends string>(...known: readonly Known[]): Known {
    const text = this.text();
    return known.find((value) => value === text) ?? this.refuse(`one of ${known.join(", ")}`);
  }

  boolean(): boolean {
    return typeof this.value === "boolean" ? this.value : this.refuse("true or false");
  }

  number(): number {
    const value = this.value;
    return typeof value === "number" && Number.isFinite(value) ? value : this.refuse("a finite number");
  }

  /** An integer, low and high included. */
  integer(low: number, high: number): number {
    const value = this.value;
    const fits = typeof value === "number" && Number.isSafeInteger(value) && low <= value && value <= high;
    return fits ? value : this.refuse(`an integer from ${low} to ${high}`);
  }

  /** The integer whose decimal string this is: no sign but a minus, no leading zeros. */
  decimal(low: bigint, high: bigint): bigint {
    const text = this.text();
    const value = /^(0|-?[1-9][0-9]{0,18})$/.test(text) ? BigInt(text) : null;
    return value !== null && low <= value && value <= high
      ? value
      : this.refuse(`a decimal string from ${low} to ${high}`);
  }

  private list(): readonly unknown[] {
    return Array.isArray(this.value) ? this.value : this.refuse("a list");
  }

  private path(): string {
    return this.above === null ? String(this.name) : `${this.above.path()}.${this.name}`;
  }
}

function shown(value: unknown): string {
  if (Array.isArray(value)) {
    return `a list of ${value.length}`;
  }
  return (JSON.stringify(value) ?? "nothing").slice(0, SHOWN_CHARACTERS_MAX);
}
