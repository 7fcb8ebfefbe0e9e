// SPDX-License-Identifier: Apache-2.0
// The plan editor: text, checked and priced by the daemon while it is written.

import {post, wordsOf, DaemonError} from './daemon.js';
import {mayFlash} from './dialogs.js';
import {bytes, duration, number} from './words.js';

const byId = id => document.getElementById(id);
const kTypingMs = 350;
/** A newer dry run of this page replaces one that still waits. */
const kClient = Math.random().toString(36).slice(2);

/** Plans to begin with; {exposure} is the rig's own. */
const kPresets = [
  ['Every light once, far apart', e => `schema = 1
name = "one-at-a-time"
patterns = "one_at_a_time"
# Neighbours far apart in time, so that they do not heat each other.
order = "bit_reversed"
# A dark frame before every 256 shots and at the end.
darks_every = 256
`],
  ['Quick: every light once', () => `schema = 1
name = "quick"
patterns = "one_at_a_time"
order = "raster"
`],
  ['Bright and dark: a bracket of three', e => `schema = 1
name = "bracket"
patterns = "one_at_a_time"
order = "bit_reversed"
darks_every = 256
# Three exposures in microseconds, a factor of four apart.
exposures_us = [${[e / 4, e, e * 4].map(x => Number(x.toPrecision(3))).join(', ')}]
`],
  ['Blocks of 2 x 2 lights', () => `schema = 1
name = "blocks"
patterns = "bins"
bin = 2
order = "bit_reversed"
darks_every = 64
`],
  ['A few lights', () => `schema = 1
name = "few"
patterns = "one_at_a_time"
lights = [0, 1, 2, 3]
`],
];

export class PlanPanel {
  /** @param started  called with the run's receipt */
  constructor(started) {
    this.started = started;
    this.cost = null;
    this.asked = 0;
    this.timer = null;
    this.text = byId('plan-text');
    const preset = byId('plan-preset');
    kPresets.forEach(([name], i) => preset.add(new Option(name, String(i))));
    preset.onchange = () => this.take(kPresets[Number(preset.value)][1](this.exposure));
    byId('plan-file').onchange = async event => {
      const file = event.target.files[0];
      if (file) {
        this.take(await file.text());
        event.target.value = '';
      }
    };
    this.text.oninput = () => this.changed();
    byId('plan-form').onsubmit = event => {
      event.preventDefault();
      this.start();
    };
    this.exposure = 4000;
  }

  begin(rig) {
    this.exposure = rig.cameras[0]?.exposure_us || 4000;
    if (this.text.value === '') {
      this.take(kPresets[0][1](this.exposure));
    } else {
      this.check();
    }
  }

  take(text) {
    this.text.value = text;
    this.check();
  }

  changed() {
    clearTimeout(this.timer);
    byId('plan-start').disabled = true;
    this.timer = setTimeout(() => this.check(), kTypingMs);
  }

  /** The dry run. */
  async check() {
    clearTimeout(this.timer);
    const turn = ++this.asked;
    const problem = byId('plan-error');
    try {
      const cost = await post(`/v1/dry-run?name=plan&client=${kClient}`, this.text.value);
      if (turn !== this.asked) {
        return;
      }
      this.cost = cost;
      problem.textContent = '';
      this.showCost(cost);
    } catch (error) {
      if (turn !== this.asked) {
        return;
      }
      this.cost = null;
      byId('plan-cost').replaceChildren();
      problem.textContent =
        error instanceof DaemonError && error.where && error.where !== 'plan'
          ? `${error.where}: ${error.words}` : wordsOf(error);
    }
    byId('plan-start').disabled = this.cost === null;
  }

  showCost(cost) {
    const isOver = cost.bytes_free !== null && cost.bytes > cost.bytes_free;
    const rows = [
      ['Shots', number(cost.shots), `${number(cost.light_shots)} with light`],
      ['Time', duration(cost.seconds), `${cost.flashes_a_second.toFixed(1)} flashes per second`],
      ['Disk', bytes(cost.bytes),
        cost.bytes_free === null ? '' : `${bytes(cost.bytes_free)} free`, isOver],
      ['Power', `${number(cost.peak_watts.toFixed(cost.peak_watts < 10 ? 1 : 0))} W`,
        `${cost.mean_watts.toFixed(1)} W on average`],
      ['Busiest light', cost.busiest_light < 0 ? '–' : `${(100 * cost.highest_duty).toFixed(2)} %`,
        cost.busiest_light < 0 ? '' : `light ${cost.busiest_light}, on`],
    ];
    byId('plan-cost').replaceChildren(...rows.map(([name, value, more, over]) => {
      const [box, dt, dd] = ['div', 'dt', 'dd'].map(tag => document.createElement(tag));
      dt.textContent = name;
      dd.textContent = value;
      if (more) {
        const small = document.createElement('small');
        small.textContent = more;
        dd.append(small);
      }
      box.classList.toggle('over', Boolean(over));
      box.append(dt, dd);
      return box;
    }));
  }

  async start() {
    const message = byId('plan-message');
    message.className = 'message';
    message.textContent = '';
    await this.check();
    if (!this.cost) {
      return;
    }
    const {cost} = this;
    const isGo = await mayFlash(
      `"${cost.name}" flashes ${number(cost.light_shots)} patterns, about ` +
      `${cost.flashes_a_second.toFixed(0)} per second, for ${duration(cost.seconds)}.`, true);
    if (!isGo) {
      message.textContent = 'Nothing was started.';
      return;
    }
    try {
      this.started(await post('/v1/run?name=plan', this.text.value));
      message.textContent = 'The run begins.';
    } catch (error) {
      message.className = 'message bad';
      message.textContent = wordsOf(error);
    }
  }
}
