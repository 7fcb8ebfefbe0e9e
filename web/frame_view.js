// SPDX-License-Identifier: Apache-2.0
// A frame to look at, live or stored: whole, or pixel by pixel in a chosen region, with its
// histogram and a figure of sharpness. All of it is computed by the daemon.

import {Picture} from './picture.js';
import {number} from './words.js';

const kZooms = [0, 1, 2, 4, 8];  // screen pixels per sensor pixel; 0: the whole frame
const kMaxCrop = 1024;           // of the daemon
const kStep = 0.25;              // of what is shown, for an arrow key
const kFactsMs = 1000;
const kMinUsed = 0.98;           // of the pixels, for a sharpness to be believed
const kColours = {grey: '--text', red: '--h-red', green: '--h-green', blue: '--h-blue'};

const clamp = (value, low, high) => Math.min(Math.max(value, low), Math.max(low, high));
const percent = part => (part === 0 ? '0' : part < 0.0001 ? '<0.01' : (100 * part).toFixed(2));

export class FrameView {
  /** @param prefix  of the ids that its part of the page gets ("live", "shot") */
  constructor(prefix) {
    this.prefix = prefix;
    const box = document.getElementById(`${prefix}-view-box`);
    box.append(document.getElementById('frame-view').content.cloneNode(true));
    for (const element of box.querySelectorAll('[data-id]')) {
      element.id = `${prefix}-${element.dataset.id}`;
    }
    this.byId = name => document.getElementById(`${prefix}-${name}`);
    this.picture = new Picture(this.byId('picture'), this.byId('clipping'), this.byId('gain'),
                               this.byId('gain-text'));
    this.frame = this.byId('frame');
    this.canvas = this.byId('picture');
    this.paths = null;
    this.factsKey = '';
    this.factsAt = 0;
    this.maxAgeMs = Infinity;  // an older frame is not shown
    this.size = null;  // of the frame, sensor pixels
    this.zoom = 0;
    this.centre = null;
    this.number = '';  // of the newest frame that is shown
    this.isBusy = false;
    this.wantsMore = false;
    this.best = 0;
    this.facts = null;
    this.changed = () => this.update();  // a region was chosen
    this.buildZoom();
    this.listen();
    this.byId('sharp-reset').onclick = () => this.resetBest();
    this.byId('log').oninput = () => this.drawHistogram();
    new ResizeObserver(() => this.resized()).observe(this.frame);
  }

  /** @param paths  picture and facts; null: nothing to look at */
  use(paths) {
    if (paths?.picture !== this.paths?.picture) {
      this.paths = paths;
      this.number = '';
      this.size = null;
      this.resetBest();
    }
  }

  clear() {
    this.number = '';
    this.facts = null;
    this.factsKey = '';
    if (this.picture.pixels) {
      this.picture.clear();
    }
    this.byId('where').hidden = true;
    this.byId('measures').hidden = true;
  }

  get hasPicture() {
    return this.picture.pixels !== null;
  }

  // ---- zoom and region

  buildZoom() {
    this.buttons = kZooms.map(zoom => {
      const button = document.createElement('button');
      button.type = 'button';
      button.setAttribute('role', 'radio');
      button.textContent = zoom === 0 ? 'Whole' : `${zoom}:1`;
      button.onclick = () => this.setZoom(zoom);
      button.onkeydown = event => {
        const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[event.key];
        if (step) {
          event.preventDefault();
          const i = (kZooms.indexOf(this.zoom) + step + kZooms.length) % kZooms.length;
          this.setZoom(kZooms[i]);
          this.buttons[i].focus();
        }
      };
      return button;
    });
    this.byId('zoom').append(...this.buttons);
    this.showZoom();
  }

  showZoom() {
    this.buttons.forEach((button, i) => {
      const is = kZooms[i] === this.zoom;
      button.setAttribute('aria-checked', String(is));
      button.tabIndex = is ? 0 : -1;
    });
    this.frame.classList.toggle('is-crop', this.zoom > 0);
  }

  setZoom(zoom, centre = this.centre) {
    this.zoom = zoom;
    this.centre = centre;
    this.showZoom();
    this.regionChanged();
  }

  /** Sensor pixels that are shown; null: the whole frame. */
  region() {
    if (this.zoom === 0 || !this.size) {
      return null;
    }
    const {width, height} = this.size;
    const w = clamp(Math.floor(this.frame.clientWidth / this.zoom), 1, Math.min(kMaxCrop, width));
    const h = clamp(Math.floor(w * 0.75), 1, Math.min(kMaxCrop, height));
    const [cx, cy] = this.centre || [width / 2, height / 2];
    const x = clamp(Math.round(cx - w / 2), 0, width - w);
    const y = clamp(Math.round(cy - h / 2), 0, height - h);
    this.centre = [x + w / 2, y + h / 2];
    return {x, y, width: w, height: h};
  }

  moveBy(dx, dy) {
    const region = this.region();
    if (region) {
      this.centre = [this.centre[0] + dx, this.centre[1] + dy];
      this.regionChanged();
    }
  }

  regionChanged() {
    this.number = '';
    this.resetBest();
    this.changed();
  }

  resized() {
    const now = this.region();
    if (now && this.shown && (now.width !== this.shown.width || now.height !== this.shown.height)) {
      this.regionChanged();
    }
    this.drawHistogram();
  }

  listen() {
    let from = null;
    this.canvas.addEventListener('pointerdown', event => {
      if (event.button === 0 && this.hasPicture) {
        from = {x: event.clientX, y: event.clientY, moved: 0, zoom: this.zoom};
        this.canvas.setPointerCapture(event.pointerId);
      }
    });
    this.canvas.addEventListener('pointermove', event => {
      if (from && this.zoom > 0) {
        const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
        from.moved = Math.max(from.moved, Math.hypot(dx, dy));
        this.canvas.style.transform = `translate(${dx}px, ${dy}px)`;
      }
    });
    const end = event => {
      if (!from) {
        return;
      }
      const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
      if (this.zoom > 0 && from.moved > 3 && event.type === 'pointerup') {
        this.moveBy(-dx / this.zoom, -dy / this.zoom);
      } else {
        this.canvas.style.transform = '';
      }
      from = null;
    };
    this.canvas.addEventListener('pointerup', end);
    this.canvas.addEventListener('pointercancel', end);
    this.canvas.addEventListener('click', event => {
      if (this.zoom === 0 && this.size) {
        const box = this.canvas.getBoundingClientRect();
        this.setZoom(1, [(event.clientX - box.left) / box.width * this.size.width,
                         (event.clientY - box.top) / box.height * this.size.height]);
      }
    });
    this.frame.addEventListener('keydown', event => {
      if (event.ctrlKey || event.altKey || event.metaKey) {
        return;
      }
      const region = this.region();
      const step = region ? [kStep * region.width, kStep * region.height] : [0, 0];
      const i = kZooms.indexOf(this.zoom);
      const moves = {
        ArrowLeft: [-step[0], 0], ArrowRight: [step[0], 0],
        ArrowUp: [0, -step[1]], ArrowDown: [0, step[1]],
      };
      if (moves[event.key] && region) {
        this.moveBy(...moves[event.key]);
      } else if (event.key === '+' || event.key === '=') {
        this.setZoom(kZooms[Math.min(i + 1, kZooms.length - 1)]);
      } else if (event.key === '-') {
        this.setZoom(kZooms[Math.max(i - 1, 0)]);
      } else if (event.key === '0') {
        this.setZoom(0);
      } else {
        return;
      }
      event.preventDefault();
    });
  }

  // ---- what the daemon says

  /**
   * Asks for the picture unless it is shown already.
   * @return  'new', 'same', 'old' (not shown) or 'none' (the daemon has none)
   */
  async update() {
    if (!this.paths) {
      return 'none';
    }
    if (this.isBusy) {
      this.wantsMore = true;
      return 'same';
    }
    this.isBusy = true;
    let news = 'none';
    try {
      do {
        this.wantsMore = false;
        news = await this.fetch();
      } while (this.wantsMore);
    } finally {
      this.isBusy = false;
    }
    return news;
  }

  async fetch() {
    const {paths} = this;
    const region = this.region();
    const words = new URLSearchParams(region || {});
    const asked = `${paths.picture}?${words}`;
    const after = `&after=${this.number || 0}`;
    const response = await fetch(asked + after, {cache: 'no-store'});
    if (this.paths !== paths) {
      return 'same';
    }
    if (Number(response.headers.get('X-Frame-Age-Ms')) > this.maxAgeMs) {
      return 'old';
    }
    if (response.status === 204) {
      return response.headers.get('X-Frame-Number') ? 'same' : 'none';
    }
    if (!response.ok) {
      if (response.status === 400 && region) {
        this.size = null;  // another camera: look at all of it
        this.setZoom(0);
      }
      return 'none';
    }
    const head = name => response.headers.get(name);
    const blob = await response.blob();
    const isFirst = !this.size;
    this.size = {width: Number(head('X-Frame-Width')), height: Number(head('X-Frame-Height'))};
    this.number = head('X-Frame-Number') || '';
    this.sequence = head('X-Frame-Sequence');
    this.saturated = Number(head('X-Saturated-Share'));
    this.canvas.style.transform = '';
    this.shown = region;
    await this.picture.show(blob);
    this.canvas.style.width = region ? `${region.width * this.zoom}px` : '100%';
    this.showWhere(region);
    if (isFirst && this.zoom > 0 && !region) {
      this.wantsMore = true;  // the crop was chosen before the frame's size was known
    }
    // Of a whole frame they cost the daemon more than its picture: not more than once a second.
    const key = `${paths.facts}?${words}&after=0`;
    if (region || key !== this.factsKey || performance.now() - this.factsAt > kFactsMs) {
      this.factsKey = key;
      this.factsAt = performance.now();
      await this.fetchFacts(paths, key);
    }
    return 'new';
  }

  async fetchFacts(paths, address) {
    const response = await fetch(address, {cache: 'no-store'});
    if (response.status !== 200 || this.paths !== paths) {
      return;
    }
    this.facts = await response.json();
    this.byId('measures').hidden = false;
    this.showSharpness();
    this.drawHistogram();
  }

  showWhere(region) {
    const {width, height} = this.size;
    const where = this.byId('where');
    where.hidden = !region;
    if (region) {
      where.style.aspectRatio = `${width} / ${height}`;
      const inner = where.firstElementChild;
      inner.style.left = `${100 * region.x / width}%`;
      inner.style.top = `${100 * region.y / height}%`;
      inner.style.width = `${100 * region.width / width}%`;
      inner.style.height = `${100 * region.height / height}%`;
    }
    this.byId('place').textContent = region
      ? `Columns ${region.x}–${region.x + region.width - 1}, rows ${region.y}–${region.y + region.height - 1} ` +
        `of ${width} × ${height}. Drag, or use the arrow keys.`
      : `All ${width} × ${height} pixels. Click a point to see it pixel by pixel.`;
  }

  // ---- sharpness

  resetBest() {
    this.best = 0;
    this.byId('sharp-best').textContent = '';
    this.byId('sharp-bar').style.width = '0';
  }

  showSharpness() {
    const {value, noise, share_used: used} = this.facts.sharpness;
    this.best = Math.max(this.best, value);
    const fraction = this.best > 0 ? value / this.best : 0;
    this.byId('sharp-value').textContent = (100 * value).toFixed(value < 0.1 ? 2 : 1);
    this.byId('sharp-bar').style.width = `${100 * fraction}%`;
    const meter = this.byId('sharp-meter');
    meter.setAttribute('aria-valuenow', Math.round(100 * fraction));
    meter.setAttribute('aria-valuetext', `${Math.round(100 * fraction)} % of the best so far`);
    this.byId('sharp-best').textContent = `best so far ${(100 * this.best).toFixed(this.best < 0.1 ? 2 : 1)}`;
    this.byId('sharp-note').textContent =
      used > 0 && used < kMinUsed ? `${percent(1 - used)} % of it is saturated and left out: expose less.`
      : value === 0 ? 'Nothing here beyond the noise: choose a region with detail, or use more light.'
      : noise > 0 && value < 0.5 * noise ? 'Much noise: the figure will fluctuate. More light makes it steady.' : '';
  }

  // ---- histogram

  drawHistogram() {
    const {facts} = this;
    const canvas = this.byId('histogram');
    if (!facts || canvas.clientWidth === 0) {
      return;
    }
    const scale = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(canvas.clientWidth * scale), Math.round(130 * scale)];
    canvas.width = w;
    canvas.height = h;
    const isLog = this.byId('log').checked;
    const style = getComputedStyle(document.documentElement);
    const colour = name => style.getPropertyValue(name).trim();
    const context = canvas.getContext('2d');
    context.clearRect(0, 0, w, h);
    const height = n => (isLog ? Math.log10(1 + n) : n);
    const most = Math.max(1, ...facts.histogram.flatMap(one => one.bins.map(height)));
    const at = dn => dn / (facts.white_dn + 1) * w;
    for (const one of facts.histogram) {
      context.beginPath();
      context.moveTo(0, h);
      one.bins.forEach((n, i) => {
        const y = h - height(n) / most * (h - 4 * scale);
        context.lineTo(i / one.bins.length * w, y);
        context.lineTo((i + 1) / one.bins.length * w, y);
      });
      context.lineTo(w, h);
      context.strokeStyle = context.fillStyle = colour(kColours[one.colour]);
      context.globalAlpha = 0.22;
      context.fill();
      context.globalAlpha = 1;
      context.lineWidth = 1.2 * scale;
      context.stroke();
    }
    for (const [dn, name] of [[facts.black_dn, '--h-blue'], [facts.clip_dn, '--h-red']]) {
      const x = clamp(at(dn), scale, w - scale);
      context.strokeStyle = colour(name);
      context.lineWidth = 1.5 * scale;
      context.setLineDash([4 * scale, 3 * scale]);
      context.beginPath();
      context.moveTo(x, 0);
      context.lineTo(x, h);
      context.stroke();
      context.setLineDash([]);
    }
    const lines = facts.histogram.map(one => {
      const name = one.colour === 'grey' ? 'All' : one.colour[0].toUpperCase() + one.colour.slice(1);
      return `${name}: mean ${number(Math.round(one.mean_dn))}, ` +
        `${percent(one.saturated / Math.max(1, one.pixels))} % saturated, ${percent(one.black / Math.max(1, one.pixels))} % at or below black`;
    });
    this.byId('counts').replaceChildren(...lines.map(line => {
      const item = document.createElement('li');
      item.textContent = line;
      return item;
    }));
    canvas.setAttribute('aria-label', `Histogram of the words shown, 0 to ${facts.white_dn}. ${lines.join('. ')}`);
    this.byId('axis').textContent =
      `0 to ${number(facts.white_dn)}; black level ${number(Math.round(facts.black_dn))}, ` +
      `clipping from ${number(Math.round(facts.clip_dn))}`;
  }
}
