// SPDX-License-Identifier: Apache-2.0
// Sums of pictures on the processor, for browsers without a graphics processor: software GL spends
// several times as long on them, since it emulates each fetch of a texel.

import {FullError} from './page_store.js';

const kBlockBytes = 1 << 20;
const kLevels = 1 << 18;  // of light between black and white, for the display's curve: a step is below 0.013 of 1/255
const kAtOnce = 4;  // pages in one pass: fewer passes over the sum

/** Pages in the page's own memory: page p stands in block p >> bits. */
class BlockStore {
  constructor(View, values, budget) {
    Object.assign(this, {View, values, budget});
    this.bits = Math.max(0, Math.floor(Math.log2(kBlockBytes / (values * View.BYTES_PER_ELEMENT))));
    this.blocks = [];
    this.n = 0;
  }

  /** Keeps n pages that stand at `offset` of `buffer`. @return  the first one's number */
  add(buffer, offset, n) {
    const first = this.n;
    const given = new this.View(buffer, offset, n * this.values);
    const perBlock = 1 << this.bits;
    for (let done = 0; done < n;) {
      const place = this.n & (perBlock - 1);
      if (place === 0) {
        const size = perBlock * this.values;
        this.budget.take(size * this.View.BYTES_PER_ELEMENT);
        this.blocks.push(new this.View(size));
      }
      const part = Math.min(perBlock - place, n - done);
      this.blocks.at(-1).set(given.subarray(done * this.values, (done + part) * this.values), place * this.values);
      done += part;
      this.n += part;
    }
    return first;
  }

  blockOf(page) {
    return this.blocks[page >> this.bits];
  }

  offsetOf(page) {
    return (page & ((1 << this.bits) - 1)) * this.values;
  }
}

/** Half-precision numbers, by their bits. */
function halves() {
  return Float32Array.from({length: 1 << 16}, (_, bits) => {
    const exponent = (bits >> 10) & 31;
    const fraction = bits & 1023;
    const magnitude = exponent === 0 ? fraction * 2 ** -24 : (1024 + fraction) * 2 ** (exponent - 25);
    return bits & 0x8000 ? -magnitude : magnitude;
  });
}

function addFour(sum, a, i, f, b, j, g, c, k, h, d, l, e) {
  for (let p = 0; p < sum.length; ++p) {
    sum[p] += f * a[i + p] + g * b[j + p] + h * c[k + p] + e * d[l + p];
  }
}

function addFourHalves(value, sum, a, i, f, b, j, g, c, k, h, d, l, e) {
  for (let p = 0; p < sum.length; ++p) {
    sum[p] += f * value[a[i + p]] + g * value[b[j + p]] + h * value[c[k + p]] + e * value[d[l + p]];
  }
}

function addOne(sum, page, from, factor) {
  for (let p = 0; p < sum.length; ++p) {
    sum[p] += factor * page[from + p];
  }
}

/** T_0 … T_(terms - 1) at n points that divide [-1, 1] evenly, polynomial by polynomial. */
function chebyshev(n, terms) {
  const all = new Float64Array(n * terms);
  for (let i = 0; i < n; ++i) {
    const x = (2 * i + 1) / n - 1;
    for (let t = 0; t < terms; ++t) {
      const at = t * n + i;
      all[at] = t === 0 ? 1 : t === 1 ? x : 2 * x * all[at - n] - all[at - 2 * n];
    }
  }
  return all;
}

/** The display's byte of each level of light: sRGB. */
function displayBytes() {
  return Uint8Array.from({length: kLevels + 1}, (_, i) => {
    const v = i / kLevels;
    return Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055));
  });
}

export class ProcessorSums {
  constructor(gl, basis, budget) {
    Object.assign(this, {gl, basis, bytes: null, shown: null});
    const {side} = basis.about;
    this.stores = {
      small: new BlockStore(basis.isLossless ? Uint16Array : Int8Array, side ** 2, budget),
      gains: new BlockStore(Int16Array, side ** 2, budget),
    };
    this.add = basis.isLossless ? addFourHalves.bind(null, halves()) : addFour;
    this.four = [];
    this.pageSum = new Float64Array(side ** 2);
    this.gain = new Float64Array(side ** 2);
    this.direction = new Float64Array(side);  // of the plate, along a row
    this.points = new Map();  // T_0 … along tiles of a size
  }

  pointsAlong(size) {
    if (!this.points.has(size)) {
      this.points.set(size, chebyshev(size, this.basis.plateSide));
    }
    return this.points.get(size);
  }

  /** Adds the pages of four factors, as soon as there are four. */
  addPage(page, factor) {
    const {small} = this.stores;
    this.four.push(small.blockOf(page), small.offsetOf(page), factor);
    if (this.four.length === 3 * kAtOnce) {
      this.add(this.pageSum, ...this.four);
      this.four.length = 0;
    }
  }

  addPictures({channel, pictures, factors}, tile) {
    const {entries, nTiles} = this.basis.pages[channel];
    this.pageSum.fill(0);
    let some = -1;
    for (const picture of pictures) {
      const entry = entries[picture * nTiles + tile];
      if (entry < 0) {
        continue;
      }
      some = entry >> 3;
      let factor = factors[picture];
      for (let page = some, digits = entry & 7; digits >= 0; --digits, ++page, factor *= 256) {
        this.addPage(page, factor);
      }
    }
    while (this.four.length > 0) {
      this.addPage(some, 0);  // any page, to make them four
    }
  }

  /** Takes the pixels' own shifts. */
  shift(channel, tile) {
    const entry = this.basis.shifts[channel].entries[tile];
    if (entry < 0) {
      return;
    }
    const {pageSum, stores: {small}} = this;
    const shifts = small.blockOf(entry >> 3);
    const from = small.offsetOf(entry >> 3);
    for (let p = 0; p < pageSum.length; ++p) {
      pageSum[p] *= 2 ** -shifts[from + p];
    }
  }

  /** @return  whether the tile sees the plate */
  takeGains(channel, tile) {
    const {gain, basis, stores: {gains}} = this;
    const entry = basis.gains[channel].entries[tile];
    if (entry < 0) {
      return false;
    }
    gain.fill(0);
    for (let page = entry >> 3, digits = entry & 7, factor = 1; digits >= 0; --digits, ++page, factor *= 65536) {
      addOne(gain, gains.blockOf(page), gains.offsetOf(page), factor);
    }
    return true;
  }

  /** Puts the tile of `pageSum` into `values` from `to` on, the plate added. */
  finish({channel, polynomials}, tile, values, to) {
    const {basis, pageSum, gain, direction} = this;
    const {tile: tileSide, side} = basis.about;
    const width = Math.min(tileSide, basis.width - tile % basis.tilesX * tileSide);
    const height = Math.min(tileSide, basis.height - Math.floor(tile / basis.tilesX) * tileSide);
    const {step} = basis;
    const hasPlate = polynomials !== null && this.takeGains(channel, tile);
    const n = basis.plateSide;
    const across = this.pointsAlong(width);
    const down = this.pointsAlong(height);
    for (let y = 0; y < height; ++y, to += basis.width) {
      const from = y * side;
      if (!hasPlate) {
        for (let x = 0; x < width; ++x) {
          values[to + x] = step * pageSum[from + x];
        }
        continue;
      }
      direction.fill(0);
      for (let a = 0; a < n; ++a) {
        let coefficient = 0;
        for (let b = 0; b < n; ++b) {
          coefficient += polynomials[(tile * n + b) * n + a] * down[b * height + y];
        }
        for (let x = 0; x < width; ++x) {
          direction[x] += coefficient * across[a * width + x];
        }
      }
      for (let x = 0; x < width; ++x) {
        values[to + x] = step * pageSum[from + x] + gain[from + x] * direction[x];
      }
    }
  }

  /** Gives a sum so many channels: one below the other, one number per pixel. */
  shape(sum, channels) {
    sum.values = new Float32Array(this.basis.width * this.basis.height * channels);
    sum.inTexture = null;
  }

  /** As Renderer.sum() says, into sum's values. */
  sum(sum, job, first, last) {
    const {basis} = this;
    const {tile: tileSide} = basis.about;
    const rowOf = unit => Math.floor(unit / basis.nTiles) * basis.height +
      Math.floor(unit % basis.nTiles / basis.tilesX) * tileSide;
    for (let unit = first; unit < last; ++unit) {
      const part = job[Math.floor(unit / basis.nTiles)];
      const tile = unit % basis.nTiles;
      this.addPictures(part, tile);
      this.shift(part.channel, tile);
      this.finish(part, tile, sum.values, rowOf(unit) * basis.width + tile % basis.tilesX * tileSide);
    }
    sum.inTexture = null;
  }

  /** Puts a sum's values into its texture, one channel below the other: what differences are made of. */
  load(sum) {
    if (sum.inTexture === 'values') {
      return;
    }
    const {gl, basis} = this;
    gl.bindTexture(gl.TEXTURE_2D, sum.texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, basis.width, basis.height * sum.channels, 0, gl.RED, gl.FLOAT, sum.values);
    sum.inTexture = 'values';
  }

  /** Puts what the display shows of a sum into its texture: software GL takes several times as long for the curve. */
  loadDisplay(sum, exposure) {
    if (sum.inTexture === exposure) {
      return;
    }
    const {gl, basis} = this;
    const n = basis.width * basis.height;
    this.bytes ??= displayBytes();
    this.shown ??= new Uint8Array(4 * n);
    const {bytes, shown} = this;
    const factor = exposure * kLevels;
    for (let c = 0; c < 3; ++c) {
      const values = sum.channels === 1 ? sum.values : sum.values.subarray(c * n, (c + 1) * n);
      for (let p = 0, to = c; p < n; ++p, to += 4) {
        shown[to] = bytes[Math.max(0, Math.min(kLevels, values[p] * factor + 0.5)) | 0];
      }
    }
    gl.bindTexture(gl.TEXTURE_2D, sum.texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, basis.width, basis.height, 0, gl.RGBA, gl.UNSIGNED_BYTE, shown);
    sum.inTexture = exposure;
  }

  /** As Renderer.read() says. */
  read(sum, step) {
    const {width, height} = this.basis;
    const values = new Float32Array(width * Math.ceil(height / step) * sum.channels);
    let at = 0;
    for (let channel = 0; channel < sum.channels; ++channel) {
      for (let y = 0; y < height; y += step, at += width) {
        const from = (channel * height + y) * width;
        values.set(sum.values.subarray(from, from + width), at);
      }
    }
    return values;
  }
}
