// SPDX-License-Identifier: Apache-2.0
// Keeps the canvas up to date: at once with as many terms as fit the time of a frame, then with all
// of them, one slice per frame, so that the next movement never waits for the last one's details.

import {displayExposure} from './exposure.js';
import {Lighting, limited} from './lighting.js';
import {Measured} from './measured.js';

const kSmoothMs = 14;      // for a picture at a movement: 60 a second
const kFrameMs = 28;       // if that is too little for so many terms; two of them, the one under way and its
const kEnoughTerms = 64;   // own, are what a movement waits for
const kLeastTermsMs = 12;  // of it for terms, however slow the rest is: without any there is no shadow
const kSliceMs = 16;       // of sums between two frames, when nothing moves
const kFirstNs = 40;       // a texel and page, until it is measured: a slow processor
const kSampled = 1 << 15;  // values, about, that the exposure of a moving picture is taken from

export class Engine {
  /** @param changed  called when there is something new to tell: status() */
  constructor(renderer, basis, changed) {
    Object.assign(this, {renderer, basis, changed});
    this.columns = [new Float64Array(basis.nLights)];
    this.lighting = null;
    this.terms = Infinity;     // of the picture
    this.isComparing = false;
    this.isStacked = false;
    this.amplify = 8;
    this.heldExposure = null;  // or the factor that is kept
    this.stops = 0;
    this.baseExposure = 1;
    this.nsPerTexel = new Measured(kFirstNs);
    this.otherMs = new Measured(0);  // of a picture at a movement, beside its sums
    this.sums = Array.from({length: 4}, () => renderer.makeSum());  // shown and in work, picture and reference
    this.norm = 0;
    this.isStale = true;       // the picture shown is of something else
    this.plan = null;          // the sums still to make
    this.isMoving = false;    // more movement is on its way: no time for all terms
    this.isShown = false;
    this.movedAt = 0;
    this.waiting = [];
    this.latencies = [];       // ms from a movement to its picture
    this.termsDrawn = [];      // in that picture
    this.frameMs = kFrameMs;
  }

  /** The light weights: one or three arrays. @param at  when the user moved, performance.now() */
  setWeights(columns, at = performance.now()) {
    this.columns = columns;
    this.lighting = null;
    this.touch(at);
  }

  /** Something else of the picture has changed. */
  touch(at = performance.now()) {
    this.isStale = true;
    this.movedAt ||= at;
    this.wake();
  }

  /** The picture is the same, but shown otherwise. */
  show() {
    this.isReshown = true;
    this.wake();
  }

  wake() {
    this.request ??= requestAnimationFrame(() => this.frame());
  }

  /** Whether another movement is on its way. */
  setMoving(isMoving) {
    this.isMoving = isMoving;
    this.wake();
  }

  /** When everything requested is on the canvas. */
  settled() {
    return new Promise(resolve => {
      this.waiting.push(resolve);
      this.wake();
    });
  }

  get exposure() {
    return (this.heldExposure ?? this.baseExposure) * 2 ** this.stops;
  }

  frame() {
    this.request = null;
    if (this.renderer.gl.isContextLost()) {
      return;
    }
    if (this.latencyFrom) {  // the frame after the picture: it is with the browser's compositor
      this.latencies.push(performance.now() - this.latencyFrom);
      this.latencyFrom = 0;
    }
    if (this.isStale) {
      this.isStale = false;
      this.drawQuick();
    } else {
      if (this.isReshown) {
        this.present();
      }
      if (this.plan && !this.isMoving) {
        this.refine();
      }
    }
    this.isReshown = false;
    if (this.isStale || (this.plan && !this.isMoving) || this.latencyFrom) {
      this.wake();
    } else if (!this.plan && this.waiting.length > 0) {
      this.waiting.splice(0).forEach(resolve => resolve());
    }
  }

  /** Time of a sum of these pages, in ms, as measured so far. */
  timeOf(pages) {
    return 1e-6 * this.nsPerTexel.value * pages * this.renderer.pageTexels;
  }

  measured(pages, ms) {
    if (pages > 50) {
      this.nsPerTexel.add(1e6 * ms / (pages * this.renderer.pageTexels));
    }
  }

  /** The plate and all that every frame needs, counted as pictures' pages. */
  get fixedPages() {
    return this.basis.nTiles * (this.basis.rank > 0 ? 4 : 1) * this.lighting.queries.length;
  }

  drawQuick() {
    const {basis, renderer} = this;
    this.lighting ??= new Lighting(basis, this.columns);
    const jobs = [this.lighting.job(this.terms)];
    if (this.isComparing) {
      jobs.push(this.lighting.job());
    }
    const fixedMs = this.otherMs.value + this.timeOf(this.fixedPages) * jobs.length;
    const pagesIn = ms => Math.max(kLeastTermsMs, ms - fixedMs) / this.timeOf(1) / jobs.length;
    const quick = jobs.map(job => limited(job, basis, pagesIn(kSmoothMs), pagesIn(this.frameMs), kEnoughTerms));
    const isWhole = quick.every((job, i) =>
      job.every((part, c) => part.pictures.length === jobs[i][c].pictures.length));
    const begun = performance.now();
    let pages = 0;
    quick.forEach((job, i) => {
      renderer.sum(this.sums[i], job);
      pages += renderer.cost(job) + this.fixedPages;
    });
    renderer.finish();
    const summed = performance.now();
    this.measured(pages, summed - begun);
    this.shownJob = quick[0];
    this.shownLighting = this.lighting;
    this.isWhole = isWhole;
    this.plan = isWhole ? null : {jobs, job: 0, unit: 0};
    this.takeExposure(isWhole);
    this.present();
    renderer.finish();
    this.otherMs.add(performance.now() - summed);
    if (this.movedAt) {
      this.latencyFrom = this.movedAt;
      this.movedAt = 0;
      this.termsDrawn.push(Math.max(...quick[0].map(part => part.pictures.length)));
    }
  }

  /** One more slice of the sums with all their terms; they are shown when they are complete. */
  refine() {
    const {renderer, plan, basis} = this;
    const job = plan.jobs[plan.job];
    const units = job.length * basis.nTiles;
    const perUnit = (renderer.cost(job) + this.fixedPages) / units;
    const n = Math.max(1, Math.floor(kSliceMs / this.timeOf(perUnit)));
    const last = Math.min(units, plan.unit + n);
    const begun = performance.now();
    renderer.sum(this.sums[2 + plan.job], job, plan.unit, last);
    renderer.finish();
    this.measured(perUnit * (last - plan.unit), performance.now() - begun);
    plan.unit = last;
    if (last === units) {
      [this.sums[plan.job], this.sums[2 + plan.job]] = [this.sums[2 + plan.job], this.sums[plan.job]];
      plan.unit = 0;
      if (++plan.job === plan.jobs.length) {
        this.shownJob = plan.jobs[0];
        this.plan = null;
        this.isWhole = true;
        this.takeExposure(true);
        this.present();
      }
    }
  }

  takeExposure(isFinal) {
    const {basis, renderer} = this;
    const step = isFinal ? 1 : Math.max(1, Math.floor(basis.width * basis.height * this.sums[0].channels / kSampled));
    const values = renderer.read(this.sums[0], step);
    if (isFinal) {
      let energy = 0;
      for (let i = 0; i < values.length; ++i) {
        energy += values[i] * values[i];
      }
      this.norm = Math.sqrt(energy);
    }
    if (this.heldExposure === null) {
      this.baseExposure = displayExposure(values);
    }
  }

  present() {
    const [first, second] = this.sums;
    const panels = [{first, second, amplify: 0}];
    if (this.isComparing) {
      panels.push({first: second, second, amplify: 0}, {first, second, amplify: this.amplify});
    }
    this.renderer.show(panels, this.exposure, this.isStacked);
    this.isShown = true;
    this.changed();
  }

  /** What is on the canvas. */
  status() {
    // A lossless file's pictures are lights, whatever the number of terms.
    const countsTerms = this.basis.isLossless && this.isWhole;
    return {
      isWhole: this.isWhole,
      terms: Math.max(...this.shownJob.map(part => countsTerms ? part.terms : part.pictures.length)),
      termsAll: this.shownLighting?.termsAll ?? 0,
      bound: this.isWhole ? this.shownLighting.bound(this.shownJob, this.norm) : null,
      exposure: this.exposure,
    };
  }
}
