/** Whether somebody still answers. A machine may sleep: what counts are looks of a page that is awake, not time. */
export class Pulse<Value> {
  private looks = 0;
  private isAsked = false;
  private isSilent = false;

  /**
   * @param looksMax without an answer
   * @param told called when there were so many, and when an answer has come after all
   */
  constructor(
    private readonly looksMax: number,
    private readonly told: (isSilent: boolean) => void,
  ) {}

  /** Asks, unless an answer is still to come; resolves with null then. */
  async look(ask: () => Promise<Value>): Promise<Value | null> {
    if (this.isAsked) {
      this.looks += 1;
      this.tell(this.looks >= this.looksMax);
      return null;
    }
    this.isAsked = true;
    this.looks = 0;
    try {
      return await ask();
    } finally {
      this.isAsked = false;
      this.tell(false);
    }
  }

  private tell(isSilent: boolean): void {
    if (isSilent !== this.isSilent) {
      this.isSilent = isSilent;
      this.told(isSilent);
    }
  }
}
