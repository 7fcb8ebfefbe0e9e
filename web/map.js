// SPDX-License-Identifier: Apache-2.0
// The map: one canvas per grid, drawn whole (6144 cells take about a millisecond), with a keyboard
// cursor and, for screen readers, one grid cell that stands for the one under the cursor.

import {markOf} from './words.js';

const kGap = 0.12;  // of a cell, between cells

export function drawSign(context, sign, x, y, size) {
  const [cx, cy, r] = [x + size / 2, y + size / 2, size / 2];
  context.lineWidth = Math.max(1.2, size * 0.13);
  context.beginPath();
  if (sign === 'dot' || sign === 'sun') {
    context.arc(cx, cy, r * (sign === 'sun' ? 0.42 : 0.3), 0, 7);
    context.fill();
  } else if (sign === 'ring') {
    context.arc(cx, cy, r * 0.5, 0, 7);
    context.stroke();
  } else if (sign === 'cross') {
    const d = r * 0.5;
    context.moveTo(cx - d, cy - d);
    context.lineTo(cx + d, cy + d);
    context.moveTo(cx + d, cy - d);
    context.lineTo(cx - d, cy + d);
    context.stroke();
  } else if (sign === 'bang') {
    context.fillRect(cx - r * 0.14, cy - r * 0.62, r * 0.28, r * 0.72);
    context.fillRect(cx - r * 0.14, cy + r * 0.34, r * 0.28, r * 0.28);
  }
}

export class GridMap {
  /**
   * @param options  title, rows, cols, count (cells, the last row may be short), describe(i): words
   *   for cell i, open(i), moved(i): the cursor stands there
   */
  constructor(options) {
    Object.assign(this, options);
    this.letters = '.'.repeat(this.count);
    this.burning = new Set();  // lit as part of a pattern
    this.done = null;        // done of each cell's shots, 0 to 1; null: one shot per cell
    this.cursor = 0;
    this.selected = -1;
    this.hasFocus = false;

    this.root = document.createElement('div');
    this.root.className = 'face';
    const title = document.createElement('h3');
    title.textContent = this.title;
    this.grid = document.createElement('div');
    this.grid.className = 'grid';
    this.grid.tabIndex = 0;
    this.grid.setAttribute('role', 'grid');
    this.grid.setAttribute('aria-label', this.title);
    this.grid.setAttribute('aria-rowcount', this.rows);
    this.grid.setAttribute('aria-colcount', this.cols);
    this.canvas = document.createElement('canvas');
    this.canvas.setAttribute('aria-hidden', 'true');
    const row = document.createElement('div');
    row.setAttribute('role', 'row');
    row.className = 'unseen';
    this.cell = document.createElement('div');
    this.cell.setAttribute('role', 'gridcell');
    this.cell.id = `cell-${Math.random().toString(36).slice(2)}`;
    row.append(this.cell);
    this.row = row;
    this.grid.setAttribute('aria-activedescendant', this.cell.id);
    this.grid.append(this.canvas, row);
    this.root.append(title, this.grid);

    this.grid.addEventListener('keydown', event => this.key(event));
    this.grid.addEventListener('focus', () => this.focusChanged(true));
    this.grid.addEventListener('blur', () => this.focusChanged(false));
    this.canvas.addEventListener('click', event => {
      const i = this.cellAt(event);
      if (i >= 0) {
        this.moveTo(i);
        this.choose();
      }
    });
    this.canvas.addEventListener('pointermove', event => {
      const i = this.cellAt(event);
      if (i >= 0 && event.pointerType === 'mouse') {
        this.hover?.(i);
      }
    });
    this.watcher = new ResizeObserver(() => this.draw());
    this.watcher.observe(this.grid);
    this.tell();
  }

  remove() {
    this.watcher.disconnect();
    this.root.remove();
  }

  set(letters, burning = new Set(), done = null) {
    const same = letters === this.letters && burning.size === this.burning.size &&
      [...burning].every(i => this.burning.has(i)) && done?.length === this.done?.length &&
      (done === null || done.every((part, i) => part === this.done[i]));
    if (!same) {
      this.letters = letters;
      this.burning = burning;
      this.done = done;
      this.draw();
      this.tell();
    }
  }

  focusChanged(hasFocus) {
    this.hasFocus = hasFocus;
    if (hasFocus) {
      this.moved(this.cursor);
    }
    this.draw();
  }

  cellAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const col = Math.floor((event.clientX - box.left) / box.width * this.cols);
    const row = Math.floor((event.clientY - box.top) / box.height * this.rows);
    const i = row * this.cols + col;
    return col >= 0 && col < this.cols && row >= 0 && i < this.count ? i : -1;
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) {
      return;
    }
    const i = this.cursor;
    const col = i % this.cols;
    const last = this.count - 1;
    const to = {
      ArrowLeft: col > 0 ? i - 1 : i,
      ArrowRight: col < this.cols - 1 && i < last ? i + 1 : i,
      ArrowUp: i >= this.cols ? i - this.cols : i,
      ArrowDown: i + this.cols <= last ? i + this.cols : i,
      Home: i - col,
      End: Math.min(i - col + this.cols - 1, last),
      PageUp: col,
      PageDown: Math.min(col + (this.rows - 1) * this.cols, last),
    }[event.key];
    if (to !== undefined) {
      event.preventDefault();
      this.moveTo(to);
    } else if (event.key === 'Enter' || event.key === ' ') {
      event.preventDefault();
      this.choose();
    }
  }

  moveTo(i) {
    this.cursor = i;
    this.tell();
    this.moved(i);
    this.draw();
  }

  choose() {
    this.selected = this.cursor;
    this.tell();
    this.draw();
    this.open(this.cursor);
  }

  select(i) {
    this.selected = i;
    this.tell();
    this.draw();
  }

  tell() {
    this.row.setAttribute('aria-rowindex', Math.floor(this.cursor / this.cols) + 1);
    this.cell.setAttribute('aria-colindex', this.cursor % this.cols + 1);
    this.cell.setAttribute('aria-selected', String(this.selected === this.cursor));
    this.cell.textContent = this.describe(this.cursor);
  }

  draw() {
    const width = this.grid.clientWidth;
    if (width === 0) {
      return;
    }
    const scale = window.devicePixelRatio || 1;
    const cell = Math.max(2, Math.floor(width * scale / this.cols));
    const [w, h] = [cell * this.cols, cell * this.rows];
    if (this.canvas.width !== w || this.canvas.height !== h) {
      this.canvas.width = w;
      this.canvas.height = h;
    }
    const context = this.canvas.getContext('2d');
    const style = getComputedStyle(document.documentElement);
    const colours = new Map();
    const colour = name => {
      if (!colours.has(name)) {
        colours.set(name, style.getPropertyValue(name).trim());
      }
      return colours.get(name);
    };
    context.clearRect(0, 0, w, h);
    const size = cell > 5 ? cell - Math.max(1, Math.round(cell * kGap)) : cell;
    const inset = Math.floor((cell - size) / 2);
    for (let i = 0; i < this.count; ++i) {
      const [x, y] = [i % this.cols * cell + inset, Math.floor(i / this.cols) * cell + inset];
      const mark = this.burning.has(i) ? markOf('*') : markOf(this.letters[i]);
      const part = this.done ? this.done[i] : 1;
      const isLoud = mark.letter !== 'o' && mark.letter !== '.';  // its colour says more than how much is done
      if (part < 1 && !isLoud) {  // fills from below with its shots
        context.fillStyle = colour('--m-pending');
        context.fillRect(x, y, size, size);
        const height = part > 0 ? Math.max(1, Math.round(part * size)) : 0;
        context.fillStyle = colour('--m-committed');
        context.fillRect(x, y + size - height, size, height);
      } else {
        context.fillStyle = colour(mark.colour);
        context.fillRect(x, y, size, size);
        if (part < 1 && part > 0) {
          const height = Math.max(1, Math.round(part * size));
          context.fillStyle = colour('--m-committed');
          context.fillRect(x, y + size - height, Math.max(2, Math.round(size / 4)), height);
        }
      }
      if (mark.sign && size >= 7) {
        context.fillStyle = context.strokeStyle = colour(mark.letter === 'w' ? '--text' : '--m-mark');
        drawSign(context, mark.sign, x, y, size);
      }
    }
    const frame = (i, name, thick) => {
      const [x, y] = [i % this.cols * cell, Math.floor(i / this.cols) * cell];
      context.lineWidth = thick;
      context.strokeStyle = colour(name);
      context.strokeRect(x + thick / 2, y + thick / 2, cell - thick, cell - thick);
    };
    const thick = Math.max(2, Math.round(2.5 * scale));
    if (this.selected >= 0 && this.selected < this.count) {
      frame(this.selected, '--accent', thick);
    }
    if (this.hasFocus) {
      frame(this.cursor, '--focus', thick);
    }
  }
}
