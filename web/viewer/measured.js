// SPDX-License-Identifier: Apache-2.0
// How long a piece of work takes on this processor.

const kRemembered = 7;  // measurements whose median is believed

/** The median of the last measurements: one that another program disturbed does not count. */
export class Measured {
  constructor(first) {
    this.last = [first];
    this.value = first;
  }

  add(value) {
    this.last.push(value);
    if (this.last.length > kRemembered) {
      this.last.shift();
    }
    this.value = [...this.last].sort((a, b) => a - b)[this.last.length >> 1];
  }
}
