// SPDX-License-Identifier: Apache-2.0
// What the light weights need from the basis file: which terms, in which order, with what
// factors, and a bound on what is left out. The arithmetic is relight/basis/relight.cpp's.

function transform(basis, values, one) {
  const size = basis.grid.rows * basis.grid.cols || values.length;  // no grid: nothing to transform
  for (let start = 0; start < values.length; start += size) {
    one(values, start, basis.grid);
  }
  return values;
}

/** ||sum of l_i P_i|| at most, ||P_i|| <= norms[i], by a bound of the file (relight/basis/light_query.cpp). */
function pictureBound({block, factors, rests, vectors}, norms, light, order) {
  let sum = 0;
  factors.forEach((factor, b) => {
    const end = Math.min(light.length, (b + 1) * block);
    let [energy, size] = [0, 0];
    const products = new Float64Array(vectors.length);
    for (let i = b * block; i < end; ++i) {
      const k = order[i];
      const x = norms[k] * light[k];
      energy += x * x;
      size += Math.abs(light[k]);
      vectors.forEach((v, j) => (products[j] += v[i] * x));
    }
    sum += Math.sqrt(factor * energy + products.reduce((s, p) => s + p * p, 0)) + rests[b] * size;
  });
  return sum * (1 + 1e-9);
}

/** One output channel: the light weights of one colour on one channel of the file. */
class Query {
  constructor(basis, channel, given) {
    this.basis = basis;
    this.channel = channel;
    this.given = given;
    this.light = transform(basis, Float64Array.from(given), basis.transform.forward);
    const norms = basis.coefficientNorms[channel];
    this.reach = this.light.map((l, i) => Math.abs(l) * norms[i]);
    this.ranked = Int32Array.from(this.reach.keys()).filter(i => this.reach[i] > 0);
    this.ranked.sort((a, b) => this.reach[b] - this.reach[a] || a - b);
    this.plate = Float64Array.from(basis.plateVectors, vector => {
      let product = 0;
      for (let k = 0; k < given.length; ++k) {
        product += given[k] * vector[k];
      }
      return basis.gainStep * product;
    });
    this.coded = this.codedBound();
  }

  /** Each tile's polynomial of what a gain of 1 gives: sum over j of plate_j a_j; null: no plate (yet). */
  get polynomials() {
    const {basis, plate} = this;
    if (!this.summed && basis.hasPlate && basis.rank > 0) {
      const all = basis.polynomials[this.channel];
      const n = basis.plateSide ** 2;
      this.summed = new Float64Array(basis.nTiles * n);
      for (let tile = 0, at = 0; tile < basis.nTiles; ++tile) {
        for (let j = 0; j < basis.rank; ++j) {
          for (let t = 0; t < n; ++t, ++at) {
            this.summed[tile * n + t] += plate[j] * all[at];
          }
        }
      }
    }
    return this.summed ?? null;
  }

  codedBound() {
    const errors = this.basis.coefficientErrors[this.channel];
    const lightErrors = this.basis.lightErrors[this.channel];
    let [byCoefficient, byLight, energy, weightEnergy] = [0, 0, 0, 0];
    for (let i = 0; i < this.given.length; ++i) {
      byCoefficient += Math.abs(this.light[i]) * errors[i];
      byLight += Math.abs(this.given[i]) * lightErrors[i];
      energy += lightErrors[i] ** 2;
      weightEnergy += this.given[i] ** 2;
    }
    const least = Math.min(byCoefficient, byLight, Math.sqrt(energy) * Math.sqrt(weightEnergy));
    const bound = this.basis.codedBounds?.[this.channel];
    return bound ? Math.min(least, pictureBound(bound, errors, this.light, this.basis.about.order)) : least;
  }

  /** The first K terms' pictures as far as they are loaded, and what the others add at most. */
  take(terms) {
    const {basis, channel, ranked, reach} = this;
    const kept = [];
    let dropped = 0;
    ranked.forEach((i, rank) => {
      if (rank < terms && (basis.isLossless || basis.hasPicture(channel, i))) {
        kept.push(i);
      } else {
        dropped += reach[i];
      }
    });
    const bound = basis.termBounds?.[channel];
    if (bound && dropped > 0) {
      const left = Float64Array.from(this.light);
      kept.forEach(i => (left[i] = 0));
      dropped = Math.min(dropped, pictureBound(bound, basis.coefficientNorms[channel], left, basis.about.order));
    }
    let [pictures, factors, worth] = [Int32Array.from(kept), this.light, reach];
    if (basis.isLossless) {
      // sum over kept i of l_i C_i = sum over k of (H^-1 l)_k T_k
      factors = this.given;
      if (terms < ranked.length) {
        const light = new Float64Array(this.light.length);
        kept.forEach(i => (light[i] = this.light[i]));
        factors = transform(basis, light, basis.transform.inverse);
      }
      const norms = basis.lightNorms[channel];
      worth = factors.map((w, k) => Math.abs(w) * norms[k]);
      pictures = Int32Array.from(factors.keys()).filter(k => factors[k] !== 0 && basis.hasPicture(channel, k));
      pictures.sort((a, b) => worth[b] - worth[a] || a - b);
      factors.forEach((w, k) => {
        if (w !== 0 && !basis.hasPicture(channel, k)) {
          dropped += worth[k];
        }
      });
    }
    return {channel, pictures, factors, worth, polynomials: this.polynomials, dropped, terms: Math.min(terms, ranked.length)};
  }
}

export class Lighting {
  /** @param columns  one or three arrays with one weight per light */
  constructor(basis, columns) {
    const outputs = Math.max(columns.length, basis.channels);
    this.basis = basis;
    this.queries = Array.from({length: outputs}, (_, c) =>
      new Query(basis, basis.channels === 1 ? 0 : c, columns[columns.length === 1 ? 0 : c]));
    this.termsAll = Math.max(...this.queries.map(query => query.ranked.length));
  }

  /** The sums to make for the first K terms of every colour: one element per output channel. */
  job(terms = Infinity) {
    return this.queries.map(query => query.take(terms));
  }

  /** Relative L2 error at most, as `haarlight relight` tells it; for the norm of the picture. */
  bound(job, norm) {
    const size = values => Math.sqrt(values.reduce((sum, v) => sum + v * v, 0));
    const error = size(job.map(part => part.dropped)) + size(this.queries.map(query => query.coded));
    if (error === 0) {
      return 0;
    }
    return norm > error ? error / (norm - error) : Infinity;
  }
}

/**
 * The most important pictures of a job.
 * @param pages  as many as have these, together
 * @param most   or these, as long as there are fewer pictures than `enough`
 */
export function limited(job, basis, pages, most, enough) {
  return job.map(part => {
    const {pagesOf} = basis.pages[part.channel];
    let [n, used] = [0, 0];
    while (n < part.pictures.length) {
      used += job.length * pagesOf[part.pictures[n]];
      if (used > (n < enough ? Math.max(pages, most) : pages)) {
        break;
      }
      ++n;
    }
    return n === part.pictures.length ? part : {...part, pictures: part.pictures.subarray(0, n)};
  });
}
