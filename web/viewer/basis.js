// SPDX-License-Identifier: Apache-2.0
// The basis file as the server gives it: what it says of itself, its tables, and its pictures as
// pages, which come bit by bit, the most important ones first. docs/reference/http-api.md has the layouts.

import {haarForward, haarInverse} from './haar.js';
import {dctForward, dctInverse, standardHaarForward, standardHaarInverse} from './separable.js';
import {ask, askAbout, askBytes, askJson} from './server.js';

// About: small enough that one decodes in some milliseconds. apps/viewer/publish_basis.cpp cuts its files so, too.
const kRequestBytes = 2 << 20;
const kAtOnce = 3;              // requests under way

const kNothing = () => {};
const kTransforms = {
  haar: {forward: haarForward, inverse: haarInverse},
  'haar-standard': {forward: standardHaarForward, inverse: standardHaarInverse},
  dct: {forward: dctForward, inverse: dctInverse},
  direct: {forward: kNothing, inverse: kNothing},
};

/** The pages of each picture: page * 8 + digits - 1, or -1 where it is empty, by picture and tile. */
class PageTable {
  constructor(nPictures, nTiles) {
    this.nTiles = nTiles;
    this.entries = new Int32Array(nPictures * nTiles).fill(-1);
    this.pagesOf = new Uint32Array(nPictures);  // how many a picture has in all
  }

  add(picture, tile, digit, page) {
    const at = picture * this.nTiles + tile;
    this.entries[at] = digit === 0 ? page * 8 : this.entries[at] + 1;
    ++this.pagesOf[picture];
  }
}

export class Basis {
  /** @throws ServerError */
  static async open() {
    const about = await askAbout('/v1/basis');
    return new Basis(about, await askBytes(`/v1/basis/${about.hash}/tables`));
  }

  constructor(about, tableBytes) {
    this.about = about;
    const {width, height, channels} = about.picture;
    Object.assign(this, {width, height, channels});
    this.nLights = about.lights.count;
    this.grid = {rows: about.lights.rows, cols: about.lights.cols};
    this.transform = kTransforms[about.basis];  // of each grid of lights
    if (!this.transform) {
      throw new Error(`The basis '${about.basis}' is not known to this page: use a newer haarlight.`);
    }
    this.isLossless = about.coding === 'lossless';
    this.rank = about.plate.rank;
    this.plateSide = about.plate.degree + 1;
    this.gainStep = about.plate.gain_step;
    this.step = this.isLossless ? about.half_scale : about.step;
    this.nTiles = about.n_tiles;
    this.tilesX = Math.ceil(width / about.tile);
    this.tilesY = Math.ceil(height / about.tile);

    const floats = new Float32Array(tableBytes);
    let at = 0;
    const take = (rows, n = this.nLights) => {
      const found = [];
      for (let r = 0; r < rows; ++r, at += n) {
        found.push(floats.subarray(at, at + n));
      }
      return found;
    };
    this.plateVectors = take(this.rank);
    this.coefficientNorms = take(channels);
    this.coefficientErrors = take(channels);
    this.lightNorms = take(channels);
    this.lightErrors = take(channels);
    // One per channel; docs/reference/basis-format.md, "Sections".
    const takeBounds = said => {
      if (!said) {
        return null;
      }
      const blocks = Math.ceil(this.nLights / said.block);
      const factors = take(channels, blocks);
      const rests = take(channels, blocks);
      return factors.map((factor, c) =>
        ({block: said.block, factors: factor, rests: rests[c], vectors: take(said.vectors)}));
    };
    this.codedBounds = takeBounds(about.coded_bound);
    this.termBounds = takeBounds(about.term_bound);

    this.groupOf = new Int32Array(this.nLights);
    about.groups.forEach(([begin, end], g) => {
      for (let place = begin; place < end; ++place) {
        this.groupOf[about.order[place]] = g;
      }
    });
    // A published folder may leave pictures out; whole groups of them have no files.
    this.isLeftOut = new Uint8Array(this.nLights);
    about.published?.left_out.forEach(picture => (this.isLeftOut[picture] = 1));
    this.groups = about.published?.groups ?? about.groups.map((_, g) => g);
    const tables = n => Array.from({length: channels}, () => new PageTable(n, this.nTiles));
    this.pages = tables(this.nLights);
    this.gains = tables(1);
    this.shifts = tables(1);
    // a[tile][j][t] of docs/reference/basis-format.md
    this.polynomials = Array.from({length: channels}, () =>
      new Float32Array(this.nTiles * this.rank * this.plateSide ** 2));
    this.isLoaded = Array.from({length: channels}, () => about.groups.map(() => false));
    this.hasPlate = false;
    this.wanted = 0;
    this.arrived = 0;
  }

  get isComplete() {
    return this.isLoaded.every(channel => this.groups.every(g => channel[g]));
  }

  /** Bytes of textures, at most, if no page were empty. */
  get mostBytes() {
    return this.channels * this.nTiles * this.about.side ** 2 *
      ((this.isLossless ? 2 : 1) * this.nLights + (this.rank > 0 ? 2 : 0));
  }

  hasPicture(channel, picture) {
    return this.isLoaded[channel][this.groupOf[picture]] && !this.isLeftOut[picture];
  }

  /** Groups of pictures, those first that add most light to pictures. */
  groupsByWorth() {
    const worth = this.about.groups.map(() => 0);
    const norms = this.isLossless ? this.lightNorms : this.coefficientNorms;
    for (const ofChannel of norms) {
      ofChannel.forEach((norm, picture) => (worth[this.groupOf[picture]] += norm * norm));
    }
    return [...this.groups].sort((a, b) => worth[b] - worth[a]);
  }

  /** Runs of tiles whose pages make about kRequestBytes. */
  runs(pictures, bytesPerPage) {
    const tiles = Math.max(1, Math.floor(kRequestBytes / Math.max(1, pictures * bytesPerPage)));
    const runs = [];
    for (let first = 0; first < this.nTiles; first += tiles) {
      runs.push(`${first}-${Math.min(first + tiles, this.nTiles) - 1}`);
    }
    return runs;
  }

  /** Every request that brings the pictures, in order, as lists that belong together. */
  stages() {
    const {side, groups, hash} = this.about;
    const small = side * side * (this.isLossless ? 2 : 1);
    const path = (kind, rest) => `/v1/basis/${hash}/${kind}/${rest}`;
    const stages = [{requests: [], done: () => (this.hasPlate = true)}];
    for (let c = 0; c < this.channels; ++c) {
      if (this.rank > 0) {
        for (const run of this.runs(1, 2 * side * side)) {
          stages[0].requests.push({path: path('gains', `${c}/${run}`), store: 'gains', table: this.gains[c]});
        }
        const numbers = this.rank * this.plateSide ** 2;
        for (const run of this.runs(1, 4 * numbers)) {
          const at = parseInt(run, 10) * numbers;
          stages[0].requests.push({path: path('polynomials', `${c}/${run}`),
                                   keep: bytes => this.polynomials[c].set(new Float32Array(bytes), at)});
        }
      }
      if (!this.isLossless) {
        for (const run of this.runs(1, side * side)) {
          stages[0].requests.push({path: path('shifts', `${c}/${run}`), store: 'small', table: this.shifts[c]});
        }
      }
    }
    for (const g of this.groupsByWorth()) {
      const stage = {requests: [], done: () => this.isLoaded.forEach(channel => (channel[g] = true))};
      for (let c = 0; c < this.channels; ++c) {
        for (const run of this.runs(groups[g][1] - groups[g][0], small)) {
          stage.requests.push({path: path('pages', `${c}/${g}/${run}`), store: 'small', table: this.pages[c]});
        }
      }
      stages.push(stage);
    }
    return stages;
  }

  /**
   * Loads everything into `stores` ({small, gains}: add(bytes) gives the first page's number).
   * @param changed  called after each part
   * @param abort  an AbortController: ends it from outside, and is used when a part fails
   * @throws ServerError, or what a store throws when it is full
   */
  async load(stores, changed, abort) {
    try {
      await this.loadStages(stores, changed, abort.signal);
    } catch (error) {
      abort.abort();  // the other requests under way
      throw error;
    }
  }

  async loadStages(stores, changed, signal) {
    const stages = this.stages();
    this.wanted = stages.reduce((sum, stage) => sum + stage.requests.length, 0);
    this.arrived = 0;
    for (const stage of stages) {
      const left = [...stage.requests];
      const work = async () => {
        for (let request = left.shift(); request; request = left.shift()) {
          const bytes = await askBytes(request.path, {signal});
          signal.throwIfAborted();
          if (request.keep) {
            request.keep(bytes);
          } else {
            this.store(bytes, stores[request.store], request.table);
          }
          ++this.arrived;
        }
      };
      await Promise.all(Array.from({length: kAtOnce}, work));
      stage.done();
      changed();
    }
  }

  store(bytes, store, table) {
    const [magic, n] = new Uint32Array(bytes, 0, 2);
    if (magic !== 0x50564c48) {  // "HLVP"
      throw new Error('The server sent something that is no page of a basis file.');
    }
    if (n === 0) {
      return;
    }
    const records = new Uint32Array(bytes, 16, 2 * n);
    const first = store.add(bytes, 16 + 8 * n, n);
    for (let p = 0; p < n; ++p) {
      table.add(records[2 * p], records[2 * p + 1] >>> 8, records[2 * p + 1] & 0xff, first + p);
    }
  }
}

/** Sends an environment's file. @return  its number */
export async function sendEnvironment(file) {
  const response = await ask(`/v1/environments?name=${encodeURIComponent(file.name)}`,
                             {method: 'POST', body: file});
  return (await response.json()).id;
}

/** Weights of an environment: {is_ready, weights: columns, missing_share, layout}. */
export const askWeights = (id, degrees, quality, signal) =>
  askJson(`/v1/environments/${id}/weights?rotate=${degrees}&quality=${quality}`, {signal});
