// The camera's newest frame, and light for aiming and focusing.

import {DaemonError, post, wordsOf} from './daemon.js';
import {mayFlash} from './dialogs.js';
import {Picture} from './picture.js';
import {clock, parseLights} from './words.js';

const byId = id => document.getElementById(id);
const kEveryMs = 250;
const kOldMs = 3000;  // the same frame for so long is no longer live

export class LivePanel {
  constructor() {
    this.picture = new Picture(byId('live-picture'), byId('live-clipping'), byId('live-gain'),
                               byId('live-gain-text'));
    this.nLights = 0;
    this.isShown = false;
    this.isOnline = false;
    this.streams = false;
    this.sequence = '';
    this.since = 0;
    byId('live-form').onsubmit = event => {
      event.preventDefault();
      this.light();
    };
    byId('live-stop').onclick = () => this.stop();
    this.loop();
  }

  show(isShown) {
    this.isShown = isShown;
  }

  /** @param streams  the camera should deliver frames in this phase */
  tell(isOnline, streams) {
    this.isOnline = isOnline;
    this.streams = streams;
    if (!isOnline || !streams) {
      this.blank(isOnline ? 'No picture: the camera rests. Light something, or start a run.'
                          : 'No picture: the daemon does not answer.');
    }
  }

  blank(words) {
    byId('live-none').hidden = false;
    byId('live-none').textContent = words;
    byId('live-facts').textContent = '';
    this.sequence = '';
    if (this.picture.pixels) {
      this.picture.clear();
    }
  }

  async loop() {
    if (this.isShown && this.isOnline && this.streams && !document.hidden) {
      try {
        await this.fetch();
      } catch { /* the link tells */ }
    }
    setTimeout(() => this.loop(), kEveryMs);
  }

  async fetch() {
    const response = await fetch('/v1/preview.png', {cache: 'no-store'});
    if (!response.ok || !this.streams || !this.isOnline) {
      return;
    }
    const sequence = response.headers.get('X-Frame-Sequence');
    if (sequence !== this.sequence) {
      this.sequence = sequence;
      this.since = Date.now();
      await this.picture.show(await response.blob());
      const share = Number(response.headers.get('X-Saturated-Share'));
      byId('live-facts').textContent =
        `Frame ${sequence} at ${clock(this.since)}. ` +
        (share > 0 ? `${(100 * share).toFixed(2)} % saturated.` : 'Nothing is saturated.');
      byId('live-none').hidden = true;
    } else if (Date.now() - this.since > kOldMs) {
      this.blank(`No new picture since ${clock(this.since)}.`);
      this.sequence = sequence;
    }
  }

  async light() {
    const message = byId('live-message');
    message.className = 'message';
    const lights = parseLights(byId('live-lights').value, this.nLights);
    if (!lights) {
      message.className = 'message bad';
      message.textContent =
        `Name lights from 0 to ${this.nLights - 1}, such as 17 18 or 0-31. The map's light is taken when you choose one.`;
      return;
    }
    const level = Number(byId('live-level').value);
    const exposure = Number(byId('live-exposure').value);
    const n = lights.length;
    if (!await mayFlash(`${n === 1 ? 'One light goes' : `${n} lights go`} on at ${level} %.`, false)) {
      return;
    }
    try {
      await post('/v1/preview', {lights, level: Math.round(655.35 * Math.min(100, Math.max(0, level))),
                                 ...(exposure > 0 ? {exposure_us: exposure} : {})});
      message.textContent = 'Lit for a minute.';
    } catch (error) {
      message.className = 'message bad';
      message.textContent = wordsOf(error);
    }
  }

  async stop() {
    const message = byId('live-message');
    try {
      await post('/v1/abort');
      message.className = 'message';
      message.textContent = 'Out.';
    } catch (error) {
      message.className = 'message bad';
      message.textContent = error instanceof DaemonError ? error.words : wordsOf(error);
    }
  }
}
