// SPDX-License-Identifier: Apache-2.0
// The mode that casts the object's shadow on a receiver: what the user moves → the shape → the engine →
// the scene and the page's words.

import {displayExposure} from './exposure.js';
import {kSourceNumbers, irradiance} from './hull_shadow.js';
import {openHull} from './hull.js';
import {byId, pngOf, save, shellWord} from './page.js';
import {ReceiverScene} from './receiver_scene.js';
import {ReceiverShape, kAlbedo} from './receiver_shape.js';
import {ShadowEngine} from './shadow_engine.js';

const kSolidGroups = 24;
const kFinerMs = 200;         // without a change: the solid's edges are drawn finer
const kFiner = 2;
const kTurnPerPixel = 0.4;    // degrees
const kOrbitPerPixel = 0.007;  // radians
const kSampled = 1 << 13;      // values that the exposure of a moving picture is taken from
const kModes = ['height', 'tilt', 'view'];
const kSteps = {height: 2, tilt: 2};  // mm, degrees of an arrow key; with Shift five times as much

/** A group of buttons of which one is chosen, also by the arrow keys. */
export function connectChoice(ids, choose) {
  const pick = id => {
    for (const other of ids) {
      byId(other).setAttribute('aria-checked', String(other === id));
      byId(other).tabIndex = other === id ? 0 : -1;
    }
    choose(id);
  };
  ids.forEach((id, i) => {
    byId(id).addEventListener('click', () => pick(id));
    byId(id).addEventListener('keydown', event => {
      const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[event.key];
      if (step) {
        event.preventDefault();
        const next = ids[(i + step + ids.length) % ids.length];
        pick(next);
        byId(next).focus();
      }
    });
  });
  return pick;
}

const count = (n, one, many) => `${n} ${n === 1 ? one : many}`;

export class ReceiverMode {
  /**
   * @param lightWords  gives the light that is set as the command line has it, '' where it cannot
   * @param tell  called with what went wrong later on
   */
  constructor(lightWords, tell) {
    Object.assign(this, {lightWords, tellError: tell, columns: null, file: '', hull: null, mode: 'height'});
  }

  /** Carves or reads the hull, the first time; then shows the mode. @throws ServerError, NoGraphics */
  async open(columns, file) {
    this.isOpen = true;
    this.file = file;
    if (!this.hull) {
      byId('receiver-wait').textContent = 'Carving the object out of its shadows. The first time this takes some ten seconds; ' +
        'then the hull is kept next to the file.';
      this.hull = await openHull();
      this.begin();
    }
    byId('receiver-wait').textContent = '';
    this.engine.isHidden = !this.isOpen;
    this.setWeights(columns);
  }

  close() {
    this.isOpen = false;
    if (this.engine) {
      this.engine.isHidden = true;
    }
  }

  begin() {
    this.shape = new ReceiverShape(this.hull.about);
    this.scene = new ReceiverScene(byId('receiver'), this.hull, this.shape);
    this.engine = new ShadowEngine(this.hull, this.shape, picture => this.take(picture), error => this.tellError(error));
    this.engine.progress = (part, level) => this.tellProgress(part, level);
    this.connect();
    this.tellHull();
    new ResizeObserver(() => this.redraw()).observe(byId('receiver'));
  }

  setWeights(columns, at) {
    this.columns = columns;
    this.engine.setWeights(columns, at);
    this.lightSolid();
  }

  /** The lights in a few groups: for the solid's shading. */
  lightSolid() {
    const {engine, hull, scene} = this;
    if (engine.sources.length === 0) {
      scene.setLights([], [0, 0, 0]);
      return;
    }
    const {groups} = engine.planOf({groups: Math.min(kSolidGroups, engine.sources.length / kSourceNumbers), rays: 1});
    const side = hull.about.grid.voxel_mm;
    const middle = hull.pointInGrid(hull.about.plane.centre);
    const ambient = [0, 0, 0];
    const lights = groups.map(({whole}) => {
      const E = irradiance(...middle, 0, 0, 1, whole, 0);
      const area = Math.hypot(...whole.slice(3, 6)) * Math.hypot(...whole.slice(6, 9)) * side * side;
      for (let c = 0; c < 3; ++c) {
        ambient[c] += E * whole[13 + c];
      }
      return {centre: hull.pointInWorld(whole.slice(0, 3)), emits: hull.directionInWorld([...whole.slice(9, 12)]),
              power: [...whole.slice(13, 16)].map(x => x * area)};
    });
    scene.setLights(lights, ambient);
  }

  take(picture) {
    const {cols, rows, sums, level} = picture;
    const every = level.isExact ? 1 : Math.max(1, Math.floor(3 * cols * rows / kSampled));
    const unshadowed = [];
    for (let i = 0; i < 3 * cols * rows; i += every) {
      unshadowed.push(sums[6 * Math.floor(i / 3) + 3 + i % 3] * kAlbedo / Math.PI);
    }
    this.picture = picture;
    this.scene.exposure = displayExposure(Float64Array.from(unshadowed));
    this.scene.setPicture(picture);
    this.draw();
    this.tell();
  }

  /** At once, and with finer edges when nothing changes any more. */
  draw() {
    this.scene.draw();
    clearTimeout(this.finer);
    this.finer = setTimeout(() => this.isOpen && this.scene.draw(kFiner), kFinerMs);
  }

  redraw() {
    this.drawing ??= requestAnimationFrame(() => {
      this.drawing = null;
      if (this.isOpen && this.hull) {
        this.draw();
      }
    });
  }

  /** The receiver has moved. */
  moved(at) {
    this.showPlace();
    this.engine.touch(at);
  }

  showPlace() {
    const {shape} = this;
    for (const [id, value, unit] of [['height', shape.heightMm, ' mm'], ['tilt', shape.tiltDeg, '°'], ['turn', shape.turnDeg, '°']]) {
      byId(`receiver-${id}`).value = value;
      byId(`receiver-${id}-text`).textContent = `${Math.round(value)}${unit}`;
    }
  }

  move({height = 0, tilt = 0, turn = 0}, at) {
    const {shape} = this;
    const within = (x, most) => Math.max(-most, Math.min(most, x));
    shape.heightMm = within(shape.heightMm + height, shape.mostMm);
    shape.tiltDeg = within(shape.tiltDeg + tilt, 60);
    shape.turnDeg = (shape.turnDeg + turn + 540) % 360 - 180;
    this.moved(at);
  }

  connect() {
    const {shape, scene} = this;
    byId('receiver-height').min = -shape.mostMm;
    byId('receiver-height').max = shape.mostMm;
    for (const [id, key] of [['height', 'heightMm'], ['tilt', 'tiltDeg'], ['turn', 'turnDeg']]) {
      byId(`receiver-${id}`).addEventListener('input', event => {
        shape[key] = Number(event.target.value);
        this.moved(event.timeStamp);
      });
    }
    connectChoice(kModes.map(mode => `drag-${mode}`), id => {
      this.mode = id.slice('drag-'.length);
      byId('receiver').dataset.drag = this.mode;
    });
    this.connectCanvas();
    byId('view-camera').addEventListener('click', () => {
      scene.isFromCamera = true;
      this.redraw();
    });
    byId('view-reset').addEventListener('click', () => {
      Object.assign(shape, {heightMm: 0, tiltDeg: 0, turnDeg: 0});
      scene.reset();
      this.redraw();
      this.moved();
    });
    byId('show-assumed').addEventListener('input', event => {
      scene.showsAssumed = event.target.checked;
      this.redraw();
    });
    byId('save-receiver').addEventListener('click', async () => {
      await this.engine.settled();
      scene.draw(kFiner);
      save(await pngOf(scene.pixels()), `${this.file.replace(/\.hlb$/, '')}-shadow.png`);
    });
    byId('save-scene').addEventListener('click', () =>
      save(new Blob([shape.sceneText(scene.camera())], {type: 'application/toml'}), 'receiver.toml'));
  }

  connectCanvas() {
    const canvas = byId('receiver');
    let last = null;
    canvas.addEventListener('pointerdown', event => {
      last = event;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener('pointermove', event => {
      if (last && event.pointerId === last.pointerId) {
        const [dx, dy] = [event.clientX - last.clientX, event.clientY - last.clientY];
        last = event;
        this.drag(event.buttons & 2 || event.ctrlKey ? 'view' : this.mode, dx, dy, event.timeStamp);
      }
    });
    for (const name of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(name, () => (last = null));
    }
    canvas.addEventListener('contextmenu', event => event.preventDefault());
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      this.scene.zoom(Math.exp(0.001 * event.deltaY));
      this.redraw();
    }, {passive: false});
    canvas.addEventListener('keydown', event => {
      const arrow = {ArrowUp: [0, -1], ArrowDown: [0, 1], ArrowLeft: [-1, 0], ArrowRight: [1, 0]}[event.key];
      if (arrow) {
        event.preventDefault();
        const [dx, dy] = arrow.map(x => x * (event.shiftKey ? 5 : 1));
        if (this.mode === 'height') {
          this.move({height: -kSteps.height * dy}, event.timeStamp);
        } else if (this.mode === 'tilt') {
          this.move({tilt: -kSteps.tilt * dy, turn: kSteps.tilt * dx}, event.timeStamp);
        } else {
          this.drag('view', 12 * dx, 12 * dy);
        }
      }
    });
  }

  drag(mode, dx, dy, at) {
    if (mode === 'height') {
      this.move({height: -dy * this.scene.mmPerPixel}, at);
    } else if (mode === 'tilt') {
      this.move({tilt: -kTurnPerPixel * dy, turn: kTurnPerPixel * dx}, at);
    } else {
      this.scene.orbit(-kOrbitPerPixel * dx, kOrbitPerPixel * dy);
      this.redraw();
    }
  }

  // ---- words ----

  static levelWords(level) {
    const {isExact, coarse, groups, rays, lights} = level;
    if (lights === 0) {
      return 'No light is on.';
    }
    if (isExact) {
      return `${lights === 1 ? 'The light that is on' : `The ${lights} lights that are on`}, 9 rays from each point to each light, ` +
        '36 where its edge falls.';
    }
    return `${groups < lights ? `The ${lights} lights in ${groups} groups` : count(lights, 'light', 'lights')}, ` +
      `${count(rays, 'ray', 'rays')} each${coarse > 1 ? `, every ${coarse === 2 ? 'second' : `${coarse}th`} point` : ''}`;
  }

  tell() {
    const {level, ms} = this.picture;
    byId('receiver-facts').textContent = level.isExact ? `${ReceiverMode.levelWords(level)} ${this.tookWords(ms)}`
      : `${ReceiverMode.levelWords(level)}; the others follow …`;
    if (level.isExact) {
      this.showCommand();
    }
  }

  tookWords(ms) {
    return this.picture.level.lights === 0 ? '' : ms < 1000 ? `${Math.round(ms)} ms.` : `${(ms / 1000).toFixed(1)} s.`;
  }

  tellProgress(part, level) {
    if (level.isExact && this.picture && !this.picture.level.isExact) {
      byId('receiver-facts').textContent = `${ReceiverMode.levelWords(this.picture.level)}; ` +
        `every light by itself follows: ${Math.floor(100 * part)} % …`;
    }
  }

  tellHull() {
    const {counts, grid, high_mm: high, low_mm: low, touches_border: touches, leaves_camera: leaves} = this.hull.about;
    const taken = counts.matter + counts.assumed_full;
    byId('hull-facts').textContent =
      `The object as its shadows know it: ${taken.toLocaleString('en')} cubes of ${Number(grid.voxel_mm.toPrecision(2))} mm, ` +
      `${Math.round(low)} to ${Math.round(high)} mm over the plane. ` +
      `${Math.round(100 * counts.assumed_full / taken)} % of them are assumed: too few lights saw them to be sure. ` +
      'The blue outline is the plane of the capture.' +
      (touches ? ' The object reaches the border of the plane\'s picture: what is beyond it casts no shadow here.' : '') +
      (leaves ? ' The border of the camera\'s picture cuts the object: what is beyond it casts no shadow here.' : '');
  }

  showCommand() {
    const light = this.lightWords();
    byId('receiver-command').textContent = light
      ? `haarlight shadow ${[this.file, ...this.hull.about.options].map(shellWord).join(' ')} --scene receiver.toml ` +
        `--method hull ${light} -o shadow.png\n` +
        'receiver.toml: what "Save scene" writes.'
      : 'haarlight shadow takes an environment, or up to 64 lights of one colour.';
  }
}
