// SPDX-License-Identifier: Apache-2.0
// An environment's quick weights at angles all the way round, fetched ahead of time: turning then
// does not wait. Between two angles they are taken to change linearly. The server's quick weights
// are of a picture of 128 texels around: two angles per texel.

const kAngles = 256;
const kPollMs = 60;

export class Turntable {
  /** @param ask  degrees → {is_ready, weights: columns, ...}; is_ready may be false for a while */
  constructor(ask) {
    this.ask = ask;
    this.found = new Array(kAngles).fill(null);
    this.isOver = false;
  }

  /** Asks for one angle after the other, while nobody else asks. @param mayAsk  () → whether it may now */
  async fill(mayAsk) {
    for (let stride = kAngles; stride >= 1; stride /= 2) {
      for (let i = 0; i < kAngles; i += stride) {
        while (!this.isOver && !this.found[i]) {
          const answer = mayAsk() ? await this.ask(360 / kAngles * i) : {is_ready: false};
          if (answer.is_ready) {
            this.found[i] = answer;
          } else {
            await new Promise(resolve => setTimeout(resolve, kPollMs));
          }
        }
      }
    }
  }

  /** Another environment has come. */
  end() {
    this.isOver = true;
  }

  get isFull() {
    return this.found.every(Boolean);
  }

  /** The answer at an angle, its columns new arrays; null as long as its neighbours are not known. */
  at(degrees) {
    const position = (degrees / 360 - Math.floor(degrees / 360)) * kAngles;
    const i = Math.floor(position) % kAngles;
    const fraction = position - Math.floor(position);
    const low = this.found[i];
    const high = this.found[(i + 1) % kAngles];
    if (!low || !high) {
      return null;
    }
    const weights = low.weights.map((column, c) =>
      Float64Array.from(column, (w, k) => (1 - fraction) * w + fraction * high.weights[c][k]));
    return {...low, weights};
  }
}
