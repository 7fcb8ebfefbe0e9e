// SPDX-License-Identifier: Apache-2.0
// Keeps the receiver's light up to date: at once with as many rays as workers cast within the time of a
// frame, the lights taken together in groups; when nothing moves, step by step with more, and at last every
// light by itself, as `haarlight shadow --method hull` does.

import {kBlock, countOf, groupSources} from './hull_shadow.js';
import {Measured} from './measured.js';

const kFrameMs = 33;     // of a movement, for rays
const kRestMs = 120;     // without a movement: time for more rays
const kUnitMs = 25;      // of a worker, before it can turn to something newer
const kMostWorkers = 8;
const kFirstNs = 150;    // per ray, until it is measured
const kExactRays = 2;    // of a light and point, on the mean, until it is measured
const kWorthIt = 1.2;    // rays of a point, for each light: a level of more is left out: it takes a third of the exact one's time, or more

/** Levels on the way: every how many points, groups times rays. */
const kLevels = [[2, 16], [1, 64], [1, 256]];

export class ShadowEngine {
  /**
   * @param shown  called with a picture: {cols, rows, sums (6 numbers per point), sheet (where it stands), level, ms}
   * @param failed  called with what went wrong in a worker
   */
  constructor(hull, shape, shown, failed) {
    Object.assign(this, {hull, shape, shown, failed, columns: null, latencies: [], waiting: []});
    this.sources = new Float64Array(0);
    this.nsOf = {grouped: new Measured(kFirstNs), exact: new Measured(kFirstNs * kExactRays)};
    this.isStale = false;
    this.running = null;   // the level under way
    this.done = -1;        // the finest level shown of what there is now
    this.movedAt = 0;
    this.plans = new Map();
    const n = Math.max(1, Math.min(kMostWorkers, (navigator.hardwareConcurrency || 2)));
    this.workers = Array.from({length: n}, () => this.makeWorker());
  }

  makeWorker() {
    const worker = new Worker(new URL('./shadow_worker.js', import.meta.url), {type: 'module'});
    const state = {worker, unit: null, isBusy: true, plan: null};
    worker.postMessage({hull: {size: this.hull.about.grid.size, voxels: this.hull.voxels}});
    worker.addEventListener('message', ({data}) => {
      state.isBusy = false;
      if (data.sums) {
        this.take(state.unit, data);
      }
      this.feed();
    });
    worker.addEventListener('error', event => this.failed(new Error(event.message || 'a worker did not start')));
    return state;
  }

  /** @param columns  one or three arrays of light weights */
  setWeights(columns, at) {
    this.columns = columns;
    this.sources = this.hull.sources(columns);
    this.plans.clear();
    this.touch(at);
  }

  /** Light or receiver has changed. @param at  when the user moved */
  touch(at = performance.now()) {
    this.isStale = true;
    this.movedAt ||= at;
    this.touchedAt = performance.now();
    this.request ??= requestAnimationFrame(() => {
      this.request = null;
      this.feed();
    });
  }

  /** When the exact picture of what was set last is shown. */
  settled() {
    return new Promise(resolve => {
      this.waiting.push(resolve);
      this.feed();
    });
  }

  /** What is computed on the way, coarsest first; the last one is exact. */
  levels() {
    const n = countOf({sources: this.sources});
    const points = this.shape.cols * this.shape.rows;
    const exact = {coarse: 1, isExact: true, lights: n, ms: 1e-6 * this.nsOf.exact.value * points * n};
    // By counts, not by times: a level that was slow once would never be measured again.
    const levels = kLevels.map(([coarse, most]) => {
      const groups = Math.min(n, most);
      const rays = Math.floor(most / Math.max(1, groups));
      return {coarse, groups, rays, lights: n,
              ms: 1e-6 * this.nsOf.grouped.value * points / coarse ** 2 * groups * rays};
    }).filter(({coarse, groups, rays}) => groups * rays / coarse ** 2 < kWorthIt * n);
    return [...levels, exact];
  }

  /** The finest level that a frame has time for. */
  firstLevel(levels) {
    let first = 0;
    levels.forEach(({ms}, i) => {
      if (ms <= kFrameMs * this.workers.length) {
        first = i;
      }
    });
    return first;
  }

  planOf(level) {
    const key = level.isExact ? 0 : level.groups * 1000 + level.rays;
    if (!this.plans.has(key)) {
      this.plans.set(key, level.isExact ? {sources: this.sources}
        : {...groupSources(this.sources, level.groups), rays: level.rays});
    }
    return this.plans.get(key);
  }

  /** Cuts a level into units of work. @param isQuick  the first picture of something new: it is finished in any case */
  begin(level, number, isQuick) {
    const face = this.shape.face(this.hull, level.coarse);
    const plan = this.planOf(level);
    const n = countOf(plan);
    const rowMs = level.ms / face.rows;
    const wanted = Math.min(kUnitMs / rowMs, face.rows / this.workers.length);
    const rows = kBlock * Math.max(1, Math.round(wanted / kBlock));
    const atOnce = Math.max(1, Math.min(n, Math.ceil(n * kUnitMs / (rowMs * rows))));
    const units = [];
    for (let from = 0; from < n; from += atOnce) {
      for (let top = 0; top < face.rows; top += rows) {
        units.push({face, begin: top, end: Math.min(face.rows, top + rows), from, to: Math.min(n, from + atOnce)});
      }
    }
    this.running = {level, number, isQuick, face, plan, units, left: units.length, all: units.length, ms: 0,
                    begun: performance.now(), sheet: this.shape.sheet(), sums: new Float32Array(6 * face.cols * face.rows), movedAt: this.movedAt};
    units.forEach(unit => (unit.run = this.running));
    if (this.movedAt) {
      this.movedAt = 0;
    }
    if (units.length === 0) {
      this.finish();
    }
  }

  /** Gives idle workers something to do. */
  feed() {
    if (!this.columns || this.isHidden) {
      return;
    }
    if (this.isStale && !this.running?.isQuick) {
      this.running = null;  // a finer picture of what was before: no longer wanted
      this.isStale = false;
      this.done = -1;
      const levels = this.levels();
      const first = this.firstLevel(levels);
      this.begin(levels[first], first, true);
    }
    if (!this.running && !this.isStale) {
      this.refine();  // also at once, where no light is on: nothing was to be computed
    }
    for (const state of this.workers) {
      const unit = state.isBusy ? null : this.running?.units.shift();
      if (unit) {
        if (state.plan !== unit.run.plan) {
          state.plan = unit.run.plan;
          state.worker.postMessage({plan: state.plan});
        }
        state.isBusy = true;
        state.unit = unit;
        const {face, begin, end, from, to} = unit;
        state.worker.postMessage({unit: {face, begin, end, from, to}});
      }
    }
  }

  /** The next finer level, once nothing has moved for a while. */
  refine() {
    const levels = this.levels();
    if (this.done >= 0 && this.isExact) {
      this.waiting.splice(0).forEach(resolve => resolve());
      return;
    }
    const rest = this.touchedAt + kRestMs - performance.now();
    if (rest > 0) {
      this.resting ??= setTimeout(() => {
        this.resting = null;
        this.feed();
      }, rest);
      return;
    }
    const next = Math.min(levels.length - 1, this.done + 1);
    this.begin(levels[next], next, false);
  }

  take(unit, {sums, ms}) {
    const run = unit.run;
    if (run !== this.running) {
      return;
    }
    const to = 6 * run.face.cols * unit.begin;
    for (let i = 0; i < sums.length; ++i) {
      run.sums[to + i] += sums[i];
    }
    run.ms += ms;
    if (--run.left === 0) {
      this.finish();
    } else {
      this.progress?.(1 - run.left / run.all, run.level);
    }
  }

  finish() {
    const run = this.running;
    const {level, face} = run;
    const rays = face.cols * face.rows * (level.isExact ? level.lights : level.groups * level.rays);
    if (run.ms > 2 && rays > 0) {
      this.nsOf[level.isExact ? 'exact' : 'grouped'].add(1e6 * run.ms / rays);
    }
    this.running = null;
    this.done = run.number;
    this.isExact = level.isExact === true;
    this.shown({cols: face.cols, rows: face.rows, sums: run.sums, sheet: run.sheet, level, ms: performance.now() - run.begun});
    if (run.movedAt) {
      requestAnimationFrame(() => this.latencies.push(performance.now() - run.movedAt));
    }
  }
}
