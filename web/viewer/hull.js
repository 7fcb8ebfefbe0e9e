// SPDX-License-Identifier: Apache-2.0
// The object's shadow hull as the server gives it. docs/reference/http-api.md has the layouts.

import {kSourceNumbers} from './hull_shadow.js';
import {ServerError, ask, askJson} from './server.js';

const kPollMs = 250;

const pause = ms => new Promise(resolve => setTimeout(resolve, ms));

/** What `haarlight view` says of the hull: {state, problem}. */
export const askHull = () => askJson('/v1/hull');

/** Has it carved or read, and waits for it. @throws ServerError  why there is none */
export async function openHull() {
  let about = await askJson('/v1/hull', {method: 'POST'});
  while (about.state === 'carving') {
    await pause(kPollMs);
    about = await askHull();
  }
  if (about.state !== 'ready') {
    throw new ServerError(0, about.problem);
  }
  const bytesOf = async part => (await ask(`/v1/hull/${about.hash}/${part}`)).arrayBuffer();
  const [voxels, surface] = await Promise.all([bytesOf('voxels'), bytesOf('surface')]);
  return new Hull(about, new Uint8Array(voxels), surface);
}

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const sum = (...terms) => terms.reduce((all, [factor, v]) => all.map((x, i) => x + factor * v[i]), [0, 0, 0]);

export class Hull {
  constructor(about, voxels, surface) {
    Object.assign(this, {about, voxels});
    const {vertices, triangles} = about.surface;
    this.vertices = new Float32Array(surface, 0, 3 * vertices);
    this.normals = new Float32Array(surface, 12 * vertices, 3 * vertices);
    this.triangles = new Uint32Array(surface, 24 * vertices, 3 * triangles);
    this.colours = new Uint8Array(surface, 24 * vertices + 12 * triangles, 3 * vertices);
    this.box = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];  // of its vertices
    this.vertices.forEach((v, i) => {
      this.box[0][i % 3] = Math.min(this.box[0][i % 3], v);
      this.box[1][i % 3] = Math.max(this.box[1][i % 3], v);
    });
  }

  /** A world direction, in voxels. */
  directionInGrid(v) {
    const {axes, voxel_mm: side} = this.about.grid;
    return axes.map(axis => dot(axis, v) / side);
  }

  /** Grid coordinates of a world point. */
  pointInGrid(p) {
    const {origin, low_mm: low, voxel_mm: side} = this.about.grid;
    return this.directionInGrid(sum([1, p], [-1, origin])).map((x, i) => x - low[i] / side);
  }

  /** The world point of grid coordinates. */
  pointInWorld(at) {
    const {origin, axes, low_mm: low, voxel_mm: side} = this.about.grid;
    return sum([1, origin], ...axes.map((axis, i) => [low[i] + side * at[i], axis]));
  }

  directionInWorld(v) {
    return sum(...this.about.grid.axes.map((axis, i) => [v[i], axis]));
  }

  /** Lights of some weight, for hull_shadow.js. @param columns  one or three arrays of weights */
  sources(columns) {
    const {lights} = this.about;
    const on = [...lights.keys()].filter(k => columns.some(column => column[k] > 0));
    const sources = new Float64Array(kSourceNumbers * on.length);
    on.forEach((k, place) => {
      const {centre, u, v, emits, size, radiance, lobe_mu: lobe} = lights[k];
      sources.set([
        ...this.pointInGrid(centre),
        ...this.directionInGrid(u).map(x => x * size[0]), ...this.directionInGrid(v).map(x => x * size[1]),
        ...this.directionInGrid(emits).map(x => x * this.about.grid.voxel_mm), lobe,
        ...[0, 1, 2].map(c => radiance * Math.max(0, columns[columns.length === 1 ? 0 : c][k])),
      ], kSourceNumbers * place);
    });
    return sources;
  }
}
