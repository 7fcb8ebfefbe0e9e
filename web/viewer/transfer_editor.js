// SPDX-License-Identifier: Apache-2.0
// The rows of a transfer function as points over the histogram of its field: dragged, moved by keys, or
// written as numbers. Of a density the second number is the height; of a colour the points stand on a strip.

const kGrab = 18;  // CSS pixels
const kStep = 0.01;  // of the axes, of an arrow key
const kMargin = 12;  // CSS pixels

const encode = v => {
  const c = Math.min(1, Math.max(0, v));
  return Math.round(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055));
};
const decode = code => {
  const s = code / 255;
  return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
};
export const hexOf = rgb => `#${rgb.map(v => encode(v).toString(16).padStart(2, '0')).join('')}`;
export const rgbOf = hex => [1, 3, 5].map(i => Number(decode(parseInt(hex.slice(i, i + 2), 16)).toPrecision(4)));

/** A number as people write it. */
const short = v => Number(v.toPrecision(5));

export class TransferEditor {
  /**
   * @param field    {range, histogram} of the server
   * @param labels   names of a row's numbers; two of a density, four of a colour
   * @param changed  (rows) when the user has changed one
   */
  constructor({canvas, inputs, readout, field, labels, mostRows}, changed) {
    Object.assign(this, {canvas, readout, field, labels, mostRows, changed});
    this.isColour = labels.length === 4;
    this.rows = [];
    this.chosen = 0;
    this.inputs = labels.map((label, k) => {
      const box = document.createElement('label');
      const input = document.createElement('input');
      Object.assign(input, {type: 'number', step: 'any', id: `${canvas.id}-number-${k}`});
      box.append(label, input);
      inputs.append(box);
      input.addEventListener('change', () => this.typed(k, input));
      return input;
    });
    canvas.addEventListener('pointerdown', event => this.grab(event));
    canvas.addEventListener('pointermove', event => {
      if (this.isGrabbed && event.buttons & 1) {
        this.drag(event);
      }
    });
    for (const name of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(name, () => {
        this.isGrabbed = false;
        this.fitAxes();
        this.draw();
      });
    }
    canvas.addEventListener('dblclick', event => this.add(this.valueAt(event)));
    canvas.addEventListener('keydown', event => this.key(event));
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  show(rows) {
    this.rows = rows.map(row => [...row]);
    this.chosen = Math.min(this.chosen, rows.length - 1);
    this.fitAxes();
    this.tell();
  }

  /** The axes hold the field's range and every row. */
  fitAxes() {
    const [low, high] = this.field.range;
    const values = this.rows.map(row => row[0]);
    this.low = Math.min(low, ...values);
    this.high = Math.max(high, ...values);
    if (!(this.high > this.low)) {
      this.high = this.low + (Math.abs(this.low) || 1);
    }
    this.top = 1.2 * Math.max(...this.rows.map(row => row[1])) || 1;
  }

  // Positions on the canvas, CSS pixels.
  x(value) { return kMargin + (value - this.low) / (this.high - this.low) * (this.canvas.clientWidth - 2 * kMargin); }
  y(height) {
    const whole = this.canvas.clientHeight - 2 * kMargin;
    return this.isColour ? kMargin + whole / 2 : kMargin + (1 - height / this.top) * whole;
  }
  valueAt(event) {
    const at = event.clientX - this.canvas.getBoundingClientRect().left;
    return this.low + (at - kMargin) / (this.canvas.clientWidth - 2 * kMargin) * (this.high - this.low);
  }
  heightAt(event) {
    const at = event.clientY - this.canvas.getBoundingClientRect().top;
    return this.top * (1 - (at - kMargin) / (this.canvas.clientHeight - 2 * kMargin));
  }

  grab(event) {
    const box = this.canvas.getBoundingClientRect();
    const distances = this.rows.map(row => Math.hypot(
      event.clientX - box.left - this.x(row[0]),
      this.isColour ? 0 : event.clientY - box.top - this.y(row[1])));
    const nearest = distances.indexOf(Math.min(...distances));
    this.isGrabbed = distances[nearest] <= kGrab;
    if (this.isGrabbed) {
      this.canvas.setPointerCapture(event.pointerId);
      this.chosen = nearest;
      this.tell();
    }
  }

  drag(event) {
    this.put(this.valueAt(event), this.isColour ? null : this.heightAt(event));
  }

  /** The chosen point elsewhere, between its neighbours. */
  put(value, height) {
    const row = this.rows[this.chosen];
    row[0] = this.between(Number(value.toPrecision(6)), row[0]);
    if (height !== null) {
      row[1] = Math.max(0, Number(height.toPrecision(4)));
    }
    this.tell();
    this.changed(this.rows);
  }

  /** @return  `value`, or `old` where it would pass a neighbour */
  between(value, old) {
    const before = this.rows[this.chosen - 1]?.[0] ?? -Infinity;
    const after = this.rows[this.chosen + 1]?.[0] ?? Infinity;
    return value > before && value < after ? value : old;
  }

  typed(k, input) {
    const value = Number(input.value);
    if (input.value !== '' && Number.isFinite(value) && (k === 0 || value >= 0)) {
      const row = this.rows[this.chosen];
      row[k] = k === 0 ? this.between(value, row[0]) : value;
      this.fitAxes();
      this.changed(this.rows);
    }
    this.tell();
  }

  setColour(rgb) {
    this.rows[this.chosen].splice(1, 3, ...rgb);
    this.tell();
    this.changed(this.rows);
  }

  /** What the function is at a value. */
  at(value) {
    const after = this.rows.findIndex(row => row[0] > value);
    if (after <= 0) {
      return (after === 0 ? this.rows[0] : this.rows.at(-1)).slice(1);
    }
    const [a, b] = [this.rows[after - 1], this.rows[after]];
    const w = (value - a[0]) / (b[0] - a[0]);
    return a.slice(1).map((v, i) => (1 - w) * v + w * b[i + 1]);
  }

  /** @param value  of the new point; without one between the chosen one and the next */
  add(value) {
    const here = this.rows[this.chosen][0];
    const beside = this.rows[this.chosen + 1]?.[0] ?? this.rows[this.chosen - 1]?.[0] ?? this.high;
    const at = Number((value ?? (here + beside) / 2).toPrecision(6));
    if (this.rows.length >= this.mostRows || this.rows.some(row => row[0] === at)) {
      return;
    }
    this.rows.push([at, ...this.at(at)]);
    this.rows.sort((a, b) => a[0] - b[0]);
    this.chosen = this.rows.findIndex(row => row[0] === at);
    this.tell();
    this.changed(this.rows);
  }

  remove() {
    if (this.rows.length > 1) {
      this.rows.splice(this.chosen, 1);
      this.chosen = Math.min(this.chosen, this.rows.length - 1);
      this.fitAxes();
      this.tell();
      this.changed(this.rows);
    }
  }

  key(event) {
    const factor = event.shiftKey ? 5 : 1;
    const row = this.rows[this.chosen];
    const sideways = factor * kStep * (this.high - this.low);
    const upwards = this.isColour ? null : factor * kStep * this.top;
    const height = this.isColour ? null : row[1];
    const actions = {
      PageUp: () => this.choose(this.chosen - 1), PageDown: () => this.choose(this.chosen + 1),
      ArrowLeft: () => this.put(row[0] - sideways, height), ArrowRight: () => this.put(row[0] + sideways, height),
      ArrowUp: () => upwards && this.put(row[0], height + upwards), ArrowDown: () => upwards && this.put(row[0], height - upwards),
      Insert: () => this.add(), Delete: () => this.remove(),
    };
    if (actions[event.key]) {
      actions[event.key]();
      event.preventDefault();
    }
  }

  choose(i) {
    this.chosen = Math.min(this.rows.length - 1, Math.max(0, i));
    this.tell();
  }

  tell() {
    const row = this.rows[this.chosen];
    this.readout.textContent = `Point ${this.chosen + 1} of ${this.rows.length}`;
    this.inputs.forEach((input, k) => (input.value = short(row[k])));
    this.draw();
  }

  draw() {
    const {canvas} = this;
    if (!this.rows.length || !canvas.clientWidth) {
      return;
    }
    const scale = devicePixelRatio;
    canvas.width = Math.round(canvas.clientWidth * scale);
    canvas.height = Math.round(canvas.clientHeight * scale);
    const context = canvas.getContext('2d');
    const style = getComputedStyle(canvas);
    const colour = name => style.getPropertyValue(name);
    const floor = canvas.clientHeight - kMargin;
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    if (this.isColour) {
      for (let x = kMargin; x < canvas.clientWidth - kMargin; ++x) {
        context.fillStyle = hexOf(this.at(this.low + (x - kMargin) / (canvas.clientWidth - 2 * kMargin) * (this.high - this.low)));
        context.fillRect(x, kMargin, 1.5, floor - kMargin);
      }
    }
    this.drawHistogram(context, this.isColour ? '#808080' : colour('--line-strong'), floor);
    if (!this.isColour) {
      context.strokeStyle = colour('--accent');
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(kMargin, this.y(this.rows[0][1]));
      this.rows.forEach(row => context.lineTo(this.x(row[0]), this.y(row[1])));
      context.lineTo(canvas.clientWidth - kMargin, this.y(this.rows.at(-1)[1]));
      context.stroke();
    }
    this.rows.forEach((row, i) => {
      context.beginPath();
      context.arc(this.x(row[0]), this.y(row[1]), i === this.chosen ? 8 : 6, 0, 2 * Math.PI);
      context.fillStyle = this.isColour ? hexOf(row.slice(1)) : colour('--accent');
      context.fill();
      context.lineWidth = i === this.chosen ? 3 : 1.5;
      context.strokeStyle = colour(i === this.chosen ? '--text' : '--ground');
      context.stroke();
    });
  }

  /** How often each value occurs, by the square root: rare ones are seen too. */
  drawHistogram(context, ink, floor) {
    const {histogram, range: [low, high]} = this.field;
    const most = Math.max(...histogram);
    context.fillStyle = ink;
    context.globalAlpha = 0.45;
    histogram.forEach((n, i) => {
      const left = this.x(low + i / histogram.length * (high - low));
      const right = this.x(low + (i + 1) / histogram.length * (high - low));
      const height = Math.sqrt(n / most) * (floor - kMargin) * (this.isColour ? 0.4 : 1);
      context.fillRect(left, floor - height, Math.max(1, right - left), height);
    });
    context.globalAlpha = 1;
  }
}
