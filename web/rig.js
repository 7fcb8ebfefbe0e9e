// SPDX-License-Identifier: Apache-2.0
// The state of the devices, what to do where something is wrong, and temperature, power and duty over
// the last minutes or hours.

import {get, wordsOf} from './daemon.js';

const byId = id => document.getElementById(id);
const kDevicesMs = 4000;
const kHistoryMs = 2000;
const kFindings = {good: ['✓', 'good'], warning: ['!', 'look at it'], wrong: ['✗', 'wrong']};

const kCharts = [
  {key: 'temperature_c', name: 'Temperature of the controller', unit: '°C', digits: 1},
  {key: 'watts', name: 'Power of the lights', unit: 'W', digits: 1, floor: 0, limit: 'max_watts'},
  {key: 'duty', name: 'Highest duty of a light', unit: '%', digits: 1, floor: 0, factor: 100, limit: 'max_duty'},
  {key: 'frames', name: 'Frames from the camera', unit: '/s', digits: 0, floor: 0},
];

export class RigPanel {
  constructor() {
    this.isShown = false;
    this.isOnline = false;
    this.span = 'minutes';
    this.history = null;
    this.nextDevices = 0;
    this.charts = kCharts.map(chart => {
      const figure = document.createElement('figure');
      figure.className = 'chart';
      const caption = document.createElement('figcaption');
      const canvas = document.createElement('canvas');
      canvas.setAttribute('role', 'img');
      canvas.setAttribute('aria-label', chart.name);
      figure.append(caption, canvas);
      return {...chart, figure, caption, canvas};
    });
    byId('charts').append(...this.charts.map(chart => chart.figure));
    new ResizeObserver(() => this.draw()).observe(byId('charts'));
    this.loop();
  }

  show(isShown) {
    if (isShown && !this.isShown) {
      this.nextDevices = 0;
      this.isShown = true;
      this.ask();
    }
    this.isShown = isShown;
  }

  tell(isOnline) {
    this.isOnline = isOnline;
  }

  showSpan(span) {
    this.span = span;
    for (const one of ['minutes', 'hours']) {
      byId(`span-${one}`).setAttribute('aria-checked', String(one === span));
      byId(`span-${one}`).tabIndex = one === span ? 0 : -1;
    }
    this.ask();
  }

  async loop() {
    await this.ask();
    setTimeout(() => this.loop(), kHistoryMs);
  }

  async ask() {
    if (!this.isShown || !this.isOnline || document.hidden) {
      return;
    }
    try {
      const {span} = this;
      const history = await get(`/v1/history?span=${span}`);
      if (span === this.span) {
        this.history = history;
        this.draw();
      }
      if (performance.now() >= this.nextDevices) {
        this.nextDevices = performance.now() + kDevicesMs;
        this.showDevices((await get('/v1/devices')).devices);
      }
      byId('rig-message').textContent = '';
    } catch (error) {
      byId('rig-message').textContent = wordsOf(error);
    }
  }

  showDevices(devices) {
    byId('devices').replaceChildren(...devices.map(device => {
      const [sign, words] = kFindings[device.finding] || kFindings.wrong;
      const item = document.createElement('li');
      item.className = device.finding;
      const add = (kind, className, text) => {
        const element = document.createElement(kind);
        element.className = className;
        element.textContent = text;
        item.append(element);
        return element;
      };
      add('span', 'sign', sign).setAttribute('aria-label', words);
      add('strong', '', device.subject);
      add('span', 'found', device.found);
      add('small', '', `expected: ${device.expected}`);
      if (device.cure) {
        add('span', 'cure', device.cure);
      }
      return item;
    }));
  }

  draw() {
    if (this.history && byId('charts').clientWidth > 0) {
      this.charts.forEach(chart => this.drawChart(chart));
    }
  }

  drawChart({key, name, unit, digits, floor, factor = 1, limit, caption, canvas}) {
    const {history} = this;
    const values = history[key].map(value => (value === null ? null : factor * value));
    const known = values.filter(value => value !== null);
    const most = limit === undefined ? Infinity : factor * history[limit];
    const hasLimit = limit !== undefined && history[limit] > 0 && !(limit === 'max_duty' && history[limit] >= 1);
    const high = Math.max(floor ?? -Infinity, ...known);
    const low = floor ?? Math.min(...known);
    const top = known.length === 0 ? 1 : high > low ? high + 0.08 * (high - low) : low + 1;
    const bottom = floor ?? (known.length === 0 ? 0 : low - 0.08 * Math.max(1, high - low));
    const newest = values.at(-1);
    const say = value => `${value.toFixed(digits)} ${unit}`;
    const now = newest === null || newest === undefined ? 'not known now' : say(newest);
    const range = known.length === 0 ? '' : `, ${say(Math.min(...known))} to ${say(Math.max(...known))}`;
    const bound = hasLimit ? `, at most ${say(most)} allowed` : '';
    const words = [document.createElement('span'), document.createElement('b'), document.createElement('small')];
    words[0].textContent = name;
    words[1].textContent = now;
    words[2].textContent = known.length === 0 ? 'nothing yet' : `${range.slice(2)}${bound}`;
    caption.replaceChildren(...words);
    canvas.setAttribute('aria-label', `${name}: ${now}${range}${bound}`);

    const scale = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(canvas.clientWidth * scale), Math.round(64 * scale)];
    canvas.width = w;
    canvas.height = h;
    const style = getComputedStyle(document.documentElement);
    const context = canvas.getContext('2d');
    const steps = this.span === 'minutes' ? 600 : 720;
    const x = i => w - (values.length - 0.5 - i) / steps * w;
    const y = value => h - (value - bottom) / (top - bottom) * (h - 2 * scale) - scale;
    if (hasLimit && most <= top) {
      context.strokeStyle = style.getPropertyValue('--danger-text').trim();
      context.setLineDash([5 * scale, 4 * scale]);
      context.beginPath();
      context.moveTo(0, y(most));
      context.lineTo(w, y(most));
      context.stroke();
      context.setLineDash([]);
    }
    context.strokeStyle = style.getPropertyValue('--accent').trim();
    context.lineWidth = 1.6 * scale;
    context.beginPath();
    let isDown = false;
    values.forEach((value, i) => {
      if (value === null) {
        isDown = false;
      } else if (isDown) {
        context.lineTo(x(i), y(value));
      } else {
        context.moveTo(x(i) - scale, y(value));
        context.lineTo(x(i), y(value));
        isDown = true;
      }
    });
    context.stroke();
  }
}
