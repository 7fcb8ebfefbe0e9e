// SPDX-License-Identifier: Apache-2.0
// Moving over a large picture: drag, wheel, two fingers, keys; and its scale bar.

const kWheel = 1.0015;    // a zoom's factor for each pixel of the wheel
const kKeyShare = 0.15;   // of the canvas, for an arrow key
const kKeyZoom = 1.5;
const kBarShare = 0.3;    // of the canvas, at most

/** The longest of 1, 2, 5 × 10^n mm that is at most so long: [mm, words]. */
export function barLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  const mm = [5, 2, 1].map(n => n * power).find(length => length <= most * (1 + 1e-9)) ?? power;
  const number = value => String(Number(value.toPrecision(6)));
  return [mm, mm < 0.1 ? `${number(1000 * mm)} µm` : mm >= 1000 ? `${number(mm / 1000)} m`
    : mm >= 10 ? `${number(mm / 10)} cm` : `${number(mm)} mm`];
}

export class PanZoom {
  /** @param stage  holds the canvas and the bar; changed: draws */
  constructor(stage, renderer, changed) {
    Object.assign(this, {stage, renderer, changed, pointers: new Map()});
    this.select = document.getElementById('zoom');
    this.bar = document.getElementById('scale-bar');
    stage.setAttribute('aria-label', 'The picture: drag or arrow keys move it, the wheel or + and − zoom, 0 shows all');
    const {canvas} = renderer;
    canvas.addEventListener('pointerdown', event => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, this.place(event));
    });
    canvas.addEventListener('pointermove', event => this.onMove(event));
    for (const kind of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(kind, event => this.pointers.delete(event.pointerId));
    }
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      this.zoomBy(kWheel ** (-event.deltaY * lines), this.place(event));
    }, {passive: false});
    canvas.addEventListener('dblclick', event => this.zoomBy(2, this.place(event)));
    stage.addEventListener('keydown', event => this.onKey(event));
    this.watcher = new ResizeObserver(() => this.resized());
    this.watcher.observe(canvas);
    this.resized();
  }

  /** Of a pointer, in pixels of the canvas. */
  place(event) {
    const {canvas} = this.renderer;
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * canvas.width / box.width, (event.clientY - box.top) * canvas.height / box.height];
  }

  onMove(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      return;
    }
    const now = this.place(event);
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    this.pointers.set(event.pointerId, now);
    if (other) {
      const far = at => Math.max(1, Math.hypot(at[0] - other[0], at[1] - other[1]));
      this.renderer.pan([0, 1].map(i => (now[i] - before[i]) / 2));
      this.zoomBy(far(now) / far(before), [0, 1].map(i => (now[i] + other[i]) / 2));
    } else {
      this.renderer.pan([0, 1].map(i => now[i] - before[i]));
      this.moved();
    }
  }

  onKey(event) {
    const {canvas} = this.renderer;
    const step = kKeyShare * Math.min(canvas.width, canvas.height);
    const pans = {ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step]};
    if (event.ctrlKey || event.altKey || event.metaKey) {
      return;
    }
    if (pans[event.key]) {
      this.renderer.pan(pans[event.key]);
      this.moved();
    } else if (event.key === '+' || event.key === '=') {
      this.zoomBy(kKeyZoom);
    } else if (event.key === '-') {
      this.zoomBy(1 / kKeyZoom);
    } else if (event.key === '0') {
      this.choose('fit');
    } else {
      return;
    }
    event.preventDefault();
  }

  zoomBy(factor, at) {
    this.renderer.zoomTo(this.renderer.scale * factor, at);
    this.moved();
  }

  /** @param value  of the list: "fit", or canvas pixels per pixel */
  choose(value) {
    if (value === 'fit') {
      this.renderer.fit();
    } else if (value !== 'free') {
      this.renderer.zoomTo(Number(value));
    }
    this.moved();
  }

  resized() {
    this.renderer.resize();
    this.moved();
  }

  moved() {
    const {scale, isFit} = this.renderer;
    const listed = isFit ? 'fit' : [...this.select.options].find(({value}) => Number(value) === scale)?.value ?? 'free';
    const free = [...this.select.options].find(({value}) => value === 'free');
    free.hidden = listed !== 'free';
    free.textContent = `${Number((100 * scale).toPrecision(2))} %`;
    this.select.value = listed;
    this.drawBar();
    this.changed();
  }

  drawBar() {
    const mmPerPixel = this.renderer.about.notes?.mm_per_pixel;
    this.bar.hidden = !mmPerPixel;
    if (mmPerPixel) {
      const {canvas, scale} = this.renderer;
      const cssPerMm = scale / mmPerPixel * canvas.clientWidth / canvas.width;
      const [mm, words] = barLength(kBarShare * canvas.clientWidth / cssPerMm);
      this.bar.style.width = `${mm * cssPerMm}px`;
      this.bar.firstElementChild.textContent = words;
    }
  }
}
