// SPDX-License-Identifier: Apache-2.0
// The lights as a map that is painted on: a face's grid, or an import's lights on the hemisphere.
// One canvas, a keyboard cursor, and for screen readers one cell that stands for the one under it.

const kGap = 0.1;  // of a cell, between cells

/** A face: cells in rows. Coordinates from 0 to 1, from the upper left. */
export class FaceLayout {
  constructor({id, first, rows, cols}) {
    Object.assign(this, {title: `Face ${id}`, first, rows, cols, count: rows * cols});
    this.ratio = cols / rows;
  }

  at(x, y) {
    const [col, row] = [Math.floor(x * this.cols), Math.floor(y * this.rows)];
    return col >= 0 && col < this.cols && row >= 0 && row < this.rows ? row * this.cols + col : -1;
  }

  /** Centre and half the size of a light. */
  positionOf(i) {
    return {x: (i % this.cols + 0.5) / this.cols, y: (Math.floor(i / this.cols) + 0.5) / this.rows,
            size: 0.5 / this.cols};
  }

  step(i, dx, dy) {
    const [col, row] = [i % this.cols + dx, Math.floor(i / this.cols) + dy];
    return col >= 0 && col < this.cols && row >= 0 && row < this.rows ? row * this.cols + col : i;
  }

  describe(i) {
    return `light ${this.first + i}, row ${Math.floor(i / this.cols)}, column ${i % this.cols}`;
  }
}

/** Lights of an import, by direction: the zenith in the middle. */
export class SkyLayout {
  constructor(positions, names) {
    const reach = Math.max(1, ...positions.map(([x, y]) => Math.hypot(x, y))) * 1.06;
    Object.assign(this, {title: 'Lights, seen from above', first: 0, names, count: positions.length});
    Object.assign(this, {ratio: 1, isRound: true});
    this.size = Math.min(0.04, 0.35 / Math.sqrt(positions.length));
    this.positions = positions.map(([x, y]) => ({x: 0.5 + 0.5 * x / reach, y: 0.5 - 0.5 * y / reach, size: this.size}));
  }

  at(x, y) {
    let [nearest, least] = [-1, Infinity];
    this.positions.forEach((place, i) => {
      const distance = Math.hypot(place.x - x, place.y - y);
      if (distance < least) {
        [nearest, least] = [i, distance];
      }
    });
    return nearest;
  }

  positionOf(i) {
    return this.positions[i];
  }

  /** The nearest light that lies more in this direction than aside. */
  step(i, dx, dy) {
    const from = this.positions[i];
    let [best, least] = [i, Infinity];
    this.positions.forEach((place, j) => {
      const along = (place.x - from.x) * dx + (place.y - from.y) * dy;
      const distance = Math.hypot(place.x - from.x, place.y - from.y);
      if (j !== i && along > 0.7 * distance && distance > 0 && distance < least) {
        [best, least] = [j, distance];
      }
    });
    return best;
  }

  describe(i) {
    return `light ${i}, ${this.names[i]}`;
  }
}

const kSteps = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
const toDisplay = linear => {
  const v = Math.min(1, Math.max(0, linear));
  return Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055));
};

export class LightMap {
  /**
   * @param handlers  stroke(map, i, isFirst, at): the pointer presses or moves on light i of the map;
   *   key(map, i, isEnter): the cursor has moved to it, or Enter was pressed; hover(words)
   */
  constructor(layout, handlers) {
    Object.assign(this, {layout, handlers});
    this.columns = null;
    this.peak = 1;
    this.cursor = 0;
    this.hasFocus = false;
    this.brush = 0;  // radius, in lights; 0: none shown
    this.hovered = -1;
    this.marksCursor = false;

    this.root = document.createElement('div');
    this.root.className = 'face';
    const title = document.createElement('h3');
    title.textContent = layout.title;
    this.grid = document.createElement('div');
    this.grid.className = 'grid';
    this.grid.tabIndex = 0;
    this.grid.setAttribute('role', 'application');
    this.grid.setAttribute('aria-roledescription', 'map of lights');
    this.grid.setAttribute('aria-label', `${layout.title}, ${layout.count} lights. Arrow keys move, Enter acts.`);
    this.canvas = document.createElement('canvas');
    this.canvas.setAttribute('aria-hidden', 'true');
    this.grid.append(this.canvas);
    this.root.append(title, this.grid);

    this.grid.addEventListener('keydown', event => this.onKey(event));
    for (const [type, has] of [['focus', true], ['blur', false]]) {
      this.grid.addEventListener(type, () => {
        this.hasFocus = has;
        this.draw();
      });
    }
    this.canvas.addEventListener('pointerdown', event => {
      if (event.button === 0) {
        this.canvas.setPointerCapture(event.pointerId);
        this.onPointer(event, true);
      }
    });
    this.canvas.addEventListener('pointermove', event => this.onPointer(event, false));
    this.canvas.addEventListener('pointerleave', () => {
      this.hovered = -1;
      this.draw();
    });
    this.watcher = new ResizeObserver(() => this.draw());
    this.watcher.observe(this.grid);
  }

  lightAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const clamp = v => Math.min(0.9999, Math.max(0, v));
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    return event.buttons & 1 ? this.layout.at(clamp(x), clamp(y)) : this.layout.at(x, y);
  }

  onPointer(event, isFirst) {
    const i = this.lightAt(event);
    if (i < 0) {
      return;
    }
    const isNew = this.hovered !== i;
    this.hovered = i;
    if (event.buttons & 1) {
      event.preventDefault();
      this.cursor = i;
      if (isFirst) {
        this.grid.focus({preventScroll: true});
      }
      if (isFirst || isNew) {
        this.handlers.stroke(this, i, isFirst, event.timeStamp);
      }
    }
    if (isNew || isFirst) {
      this.handlers.hover(this, i);
      this.draw();
    }
  }

  onKey(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) {
      return;
    }
    const step = kSteps[event.key];
    if (step) {
      const times = event.shiftKey ? 4 : 1;
      for (let n = 0; n < times; ++n) {
        this.cursor = this.layout.step(this.cursor, ...step);
      }
      this.handlers.key(this, this.cursor, false, event.timeStamp);
    } else if (event.key === 'Home' || event.key === 'End') {
      this.cursor = event.key === 'Home' ? 0 : this.layout.count - 1;
      this.handlers.key(this, this.cursor, false, event.timeStamp);
    } else if (event.key === 'Enter' || event.key === ' ') {
      this.handlers.key(this, this.cursor, true, event.timeStamp);
    } else {
      return;
    }
    event.preventDefault();
    this.handlers.hover(this, this.cursor);
    this.draw();
  }

  /** @param peak  the weight that is shown as white */
  set(columns, peak) {
    this.columns = columns;
    this.peak = peak > 0 ? peak : 1;
    this.draw();
  }

  /** Lights within the brush around light i, with a factor from 0 to 1 each. */
  under(i, radius) {
    const centre = this.layout.positionOf(i);
    const reach = Math.max(radius * 2 * centre.size, 1e-6);
    const found = [];
    for (let j = 0; j < this.layout.count; ++j) {
      const {x, y} = this.layout.positionOf(j);
      const distance = Math.hypot(x - centre.x, (y - centre.y) / this.layout.ratio) / reach;
      if (distance < 1 || j === i) {
        found.push([j, j === i ? 1 : (1 - distance ** 2) ** 2]);
      }
    }
    return found;
  }

  draw() {
    const across = this.grid.clientWidth;
    if (across === 0 || !this.columns) {
      return;
    }
    const {layout} = this;
    const scale = window.devicePixelRatio || 1;
    const cell = layout.isRound ? 0 : Math.max(2, Math.floor(across * scale / layout.cols));
    const width = layout.isRound ? Math.floor(across * scale) : cell * layout.cols;
    const height = layout.isRound ? width : cell * layout.rows;
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    const context = this.canvas.getContext('2d');
    const style = getComputedStyle(document.documentElement);
    const colour = name => style.getPropertyValue(name).trim();
    const dark = colour('--light-off');
    const off = dark.match(/[0-9a-f]{2}/gi).map(digits => parseInt(digits, 16));  // "#rrggbb"
    context.clearRect(0, 0, width, height);
    const [red, green = red, blue = red] = this.columns;
    for (let i = 0; i < layout.count; ++i) {
      const k = layout.first + i;
      const part = (weight, c) => Math.max(off[c], toDisplay(weight / this.peak));
      context.fillStyle = red[k] === 0 && green[k] === 0 && blue[k] === 0 ? dark
        : `rgb(${part(red[k], 0)} ${part(green[k], 1)} ${part(blue[k], 2)})`;
      const place = layout.positionOf(i);
      if (layout.isRound) {
        context.beginPath();
        context.arc(place.x * width, place.y * height, Math.max(3, place.size * width), 0, 7);
        context.fill();
      } else {
        const inset = cell > 5 ? Math.max(1, Math.round(cell * kGap)) : 0;
        context.fillRect(i % layout.cols * cell, Math.floor(i / layout.cols) * cell, cell - inset, cell - inset);
      }
    }
    const ring = (i, name, radius) => {
      const place = layout.positionOf(i);
      context.lineWidth = Math.max(2, 2 * scale);
      context.strokeStyle = colour(name);
      context.beginPath();
      context.arc(place.x * width, place.y * height, Math.max(radius, 1.2) * place.size * 1.6 * width, 0, 7);
      context.stroke();
    };
    if (this.hasFocus || this.marksCursor) {
      ring(this.cursor, '--light-ring', 1.2);
    }
    if (this.hovered >= 0 && this.brush > 0) {
      ring(this.hovered, '--light-ring', this.brush * 1.25);
    }
  }
}
