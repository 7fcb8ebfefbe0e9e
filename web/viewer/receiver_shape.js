// SPDX-License-Identifier: Apache-2.0
// Where the receiver stands and what it looks like: a flat sheet over the plane of the capture, moved
// along the plane's normal, turned about it and tilted.

import {sum} from './hull.js';

const kPoints = 49152;      // of the sheet, about
const kMultiple = 16;       // its rows and columns are multiples of this: coarse pictures divide it
const kWider = 1.3;         // than the plane's picture: a shadow moves aside
export const kAlbedo = 0.8;

const radians = degrees => degrees * Math.PI / 180;

export class ReceiverShape {
  /** @param about  of Hull */
  constructor({grid, plane, high_mm: high}) {
    Object.assign(this, {axes: grid.axes, centre: plane.centre, heightMm: 0, tiltDeg: 0, turnDeg: 0});
    this.across = kWider * plane.width_mm;
    this.along = kWider * plane.height_mm;
    this.mostMm = Math.ceil(Math.max(20, high));
    const rows = Math.sqrt(kPoints * this.along / this.across);
    const whole = n => Math.max(kMultiple, kMultiple * Math.round(n / kMultiple));
    this.rows = whole(rows);
    this.cols = whole(kPoints / rows);
  }

  /** Corner (left, at the back), sides and normal in the world, mm. */
  sheet() {
    const [a, b, n] = this.axes;
    const [turn, tilt] = [radians(this.turnDeg), radians(this.tiltDeg)];
    const right = sum([Math.cos(turn), a], [Math.sin(turn), b]);
    const level = sum([-Math.sin(turn), a], [Math.cos(turn), b]);
    const back = sum([Math.cos(tilt), level], [Math.sin(tilt), n]);
    const normal = sum([-Math.sin(tilt), level], [Math.cos(tilt), n]);
    const across = sum([this.across, right]);
    const down = sum([-this.along, back]);
    const corner = sum([1, this.centre], [this.heightMm, n], [-0.5, across], [-0.5, down]);
    return {corner, across, down, normal};
  }

  corners() {
    const {corner, across, down} = this.sheet();
    return [corner, sum([1, corner], [1, across]), sum([1, corner], [1, across], [1, down]), sum([1, corner], [1, down])];
  }

  /** Its points for hull_shadow.js, every `coarse`-th of them. */
  face(hull, coarse) {
    const {corner, across, down, normal} = this.sheet();
    const [cols, rows] = [this.cols / coarse, this.rows / coarse];
    const side = hull.about.grid.voxel_mm;
    return {cols, rows, grid: {
      corner: hull.pointInGrid(corner),
      across: hull.directionInGrid(across).map(x => x / cols),
      down: hull.directionInGrid(down).map(x => x / rows),
      normal: hull.directionInGrid(normal).map(x => x * side),
    }};
  }

  /** A scene file of it for `haarlight shadow`. @param camera  {size, eye, target, up, fovDeg} */
  sceneText(camera) {
    const list = v => `[${v.map(x => Number(x.toFixed(6))).join(', ')}]`;
    return `schema = 1\nname = "receiver"\n\n[[material]]\nname = "sheet"\nkd = [${kAlbedo}]\n\n` +
      `[[quad]]\ncorners = [${this.corners().map(list).reverse().join(', ')}]\nmaterial = "sheet"\n\n` +
      `[camera]\nsize = ${list(camera.size)}\neye = ${list(camera.eye)}\ntarget = ${list(camera.target)}\n` +
      `up = ${list(camera.up)}\nfov_y_deg = ${Number(camera.fovDeg.toFixed(6))}\n`;
  }
}
