// SPDX-License-Identifier: Apache-2.0
// A published picture that is lit by direction: tiles of deep zoom levels, loaded as they are seen and
// dropped when they no longer are. Positions are pixels of the full picture, from its upper left.

import {fileBytes, refuse, versionOf} from './published.js';
import {PlaneTexture, RelitPainter} from './reflectance_renderer.js';

const kAtOnce = 3;      // tiles whose pictures are under way
const kMostScale = 16;  // canvas pixels per pixel
const kSnap = 1e-6;

export class TiledRenderer extends RelitPainter {
  /**
   * @param changed  called when there is more to draw
   * @param tell  (error): a tile that cannot be had
   */
  constructor(canvas, about, changed, tell) {
    const slots = [];
    about.tiles.planes.forEach((planes, layer) => planes.forEach((p, byte) => {
      if (p >= 0) {
        slots[p] = [layer, byte];
      }
    }));
    super(canvas, about, slots);
    Object.assign(this, {changed, tell, tiles: about.tiles, shrink: 1});
    const {width, height} = about.picture;
    Object.assign(this, {width, height});
    this.levels = this.tiles.levels.map((level, l) => ({
      ...level, number: l, step: 2 ** (this.tiles.levels.length - 1 - l),
      across: Math.ceil(level.width / this.tiles.size),
    }));
    this.found = new Map();   // "level/x_y" → {texture, seen}
    this.failed = new Set();
    this.queue = [];
    this.underWay = new Map();
    this.bytes = 0;
    this.clock = 0;
    this.centre = [width / 2, height / 2];
    this.isFit = true;
    this.scale = 1;
  }

  /** The canvas takes the size it is shown in. */
  resize() {
    const {canvas} = this;
    const ratio = window.devicePixelRatio || 1;
    const most = this.gl.getParameter(this.gl.MAX_RENDERBUFFER_SIZE);
    for (const [side, shown] of [['width', canvas.clientWidth], ['height', canvas.clientHeight]]) {
      const pixels = Math.max(1, Math.min(most, Math.round(shown * ratio)));
      if (canvas[side] !== pixels) {
        canvas[side] = pixels;  // which empties it, even where nothing changes
      }
    }
    if (this.isFit) {
      this.fit();
    }
    this.clampView();
  }

  get fitScale() {
    return Math.min(this.canvas.width / this.width, this.canvas.height / this.height);
  }

  fit() {
    this.isFit = true;
    this.scale = this.fitScale;
    this.centre = [this.width / 2, this.height / 2];
  }

  /** @param scale  canvas pixels per pixel; at: the canvas's pixel that stays where it is */
  zoomTo(scale, at = [this.canvas.width / 2, this.canvas.height / 2]) {
    const fixed = this.pictureAt(at);
    this.isFit = false;
    this.scale = Math.max(Math.min(this.fitScale, 1), Math.min(kMostScale, scale));
    if (Math.abs(this.scale - 1) < kSnap) {
      this.scale = 1;
    }
    this.centre = [0, 1].map(i => fixed[i] - (at[i] - this.half[i]) / this.scale);
    this.clampView();
  }

  /** @param by  canvas pixels that the picture moves by */
  pan(by) {
    this.isFit = false;
    this.centre = this.centre.map((v, i) => v - by[i] / this.scale);
    this.clampView();
  }

  clampView() {
    const size = [this.width, this.height];
    this.centre = this.centre.map((v, i) => {
      const margin = Math.min(size[i] / 2, this.half[i] / this.scale);
      return Math.min(size[i] - margin, Math.max(margin, v));
    });
  }

  get half() {
    return [this.canvas.width / 2, this.canvas.height / 2];
  }

  /** Where the picture's upper left corner is on the canvas: whole pixels, so that 100 % is exact. */
  get origin() {
    return this.half.map((h, i) => Math.round(h - this.centre[i] * this.scale));
  }

  pictureAt(at) {
    return at.map((v, i) => (v - this.origin[i]) / this.scale);
  }

  /** Tiles of a level that are on the canvas, those in the middle first. */
  seen(level) {
    const side = this.tiles.size * level.step;
    const rows = Math.ceil(level.height / this.tiles.size);
    const [left, top] = this.pictureAt([0, 0]);
    const [right, bottom] = this.pictureAt([this.canvas.width, this.canvas.height]);
    const list = [];
    const begin = v => Math.max(0, Math.floor(v / side));
    const end = (v, n) => Math.min(n, Math.ceil(v / side));
    for (let y = begin(top); y < end(bottom, rows); ++y) {
      for (let x = begin(left); x < end(right, level.across); ++x) {
        list.push({level, x, y, key: `${level.number}/${x}_${y}`});
      }
    }
    const far = tile => Math.hypot((tile.x + 0.5) * side - this.centre[0], (tile.y + 0.5) * side - this.centre[1]);
    return list.sort((a, b) => far(a) - far(b));
  }

  sizeOf({level, x, y}) {
    const {size} = this.tiles;
    return [Math.min(size, level.width - x * size), Math.min(size, level.height - y * size)];
  }

  /** The coarsest level that has a texel for each pixel of the canvas, as far as its tiles fit the memory. */
  get level() {
    let chosen = this.levels.findIndex(({step}) => this.scale * step <= 1 + kSnap);
    chosen = chosen < 0 ? this.levels.length - 1 : chosen;
    const bytes = level => this.seen(level).reduce((sum, tile) => {
      const [width, height] = this.sizeOf(tile);
      return sum + width * height * PlaneTexture.texelBytes(this.layers);
    }, 0);
    while (chosen > 0 && bytes(this.levels[chosen]) > this.about.texture_bytes) {
      --chosen;
    }
    return this.levels[chosen];
  }

  /** Everything that the view needs is there. */
  get isComplete() {
    return this.seen(this.level).every(({key}) => this.found.has(key) || this.failed.has(key));
  }

  show(map, light, look) {
    const {gl, canvas} = this;
    const level = this.level;
    const wanted = this.seen(level);
    ++this.clock;
    const lacks = wanted.some(({key}) => !this.found.has(key));
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    for (const coarse of lacks ? this.levels.slice(0, level.number) : []) {
      this.seen(coarse).forEach(tile => this.paintTile(tile, map, light, look));
    }
    wanted.forEach(tile => this.paintTile(tile, map, light, look));
    const first = this.seen(this.levels[0]);  // the coarsest: something to see at once, and when panning
    this.queue = [...first, ...wanted].filter(({key}) =>
      !this.found.has(key) && !this.failed.has(key) && !this.underWay.has(key));
    this.dropUnseen();
    this.loadNext();
  }

  paintTile(tile, map, light, look) {
    const known = this.found.get(tile.key);
    if (!known) {
      return;
    }
    known.seen = this.clock;
    const {level, x, y} = tile;
    const {canvas, origin, scale} = this;
    const side = this.tiles.size * level.step;
    const size = [this.width, this.height];
    const from = [x, y].map((v, i) => origin[i] + v * side * scale);
    const to = [x, y].map((v, i) => origin[i] + Math.min((v + 1) * side, size[i]) * scale);
    const limits = [canvas.width, canvas.height];
    const low = from.map(v => Math.max(0, Math.round(v)));
    const high = to.map((v, i) => Math.min(limits[i], Math.round(v)));
    if (high[0] <= low[0] || high[1] <= low[1]) {
      return;
    }
    const texels = 1 / (scale * level.step);
    const isFinest = level.step === 1;
    this.paint(known.texture, {
      below: canvas.height, corner: from, texels, isSmooth: texels !== 1 && !(isFinest && texels < 1),
      rect: {x: low[0], y: low[1], width: high[0] - low[0], height: high[1] - low[1]},
    }, map, light, look);
  }

  dropUnseen() {
    const old = [...this.found].filter(([key, {seen}]) => seen < this.clock && !key.startsWith('0/'))
      .sort(([, a], [, b]) => a.seen - b.seen);
    while (this.bytes > this.about.texture_bytes && old.length > 0) {
      const [key, {texture}] = old.shift();
      this.bytes -= texture.bytes;
      texture.end();
      this.found.delete(key);
    }
  }

  loadNext() {
    while (this.underWay.size < kAtOnce && this.queue.length > 0) {
      const tile = this.queue.shift();
      this.underWay.set(tile.key, this.loadTile(tile).catch(error => {
        this.failed.add(tile.key);
        this.tell(error);
      }).finally(() => {
        this.underWay.delete(tile.key);
        this.changed();
      }));
    }
  }

  async loadTile(tile) {
    const {level, x, y} = tile;
    const {format, isWhole} = this.tiles;
    const [width, height] = this.sizeOf(tile);
    const pictures = await Promise.all(level.files.map(async (files, i) => {
      const name = isWhole ? `plane_${i}.${format}` : `plane_${i}_files/${level.number}/${x}_${y}.${format}`;
      const bytes = await fileBytes(name, ...files[y * level.across + x], {}, versionOf());
      let bitmap;
      try {
        bitmap = await createImageBitmap(new Blob([bytes]), {premultiplyAlpha: 'none', colorSpaceConversion: 'none'});
      } catch {
        refuse('This browser cannot decode a file of this page.', name);
      }
      if (bitmap.width !== width || bitmap.height !== height) {
        refuse(`A file of this page holds ${bitmap.width} × ${bitmap.height} pixels, ${width} × ${height} belong there.`, name);
      }
      return bitmap;
    }));
    const texture = new PlaneTexture(this.gl, width, height, this.layers, isWhole);
    pictures.forEach((bitmap, layer) => {
      texture.load(layer, bitmap);
      bitmap.close();
    });
    texture.complete();
    this.found.set(tile.key, {texture, seen: this.clock});
    this.bytes += texture.bytes;
  }
}
