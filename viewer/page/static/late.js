// What waits on a slow link is old when it comes: how much later an event came than the quickest one, in seconds.
const DRIFT = 0.001; // so much faster or slower than this device's clock the server's may go

export class Late {
  constructor() {
    this.leastS = Infinity;
    this.atS = 0;
  }

  // `sentS`: when it was sent, by the server's clock.
  of(sentS) {
    const nowS = performance.now() / 1000;
    this.leastS = Math.min(nowS - sentS, this.leastS + DRIFT * (nowS - this.atS));
    this.atS = nowS;
    return nowS - sentS - this.leastS;
  }
}
