// SPDX-License-Identifier: Apache-2.0
// The camera's newest frame, and light for aiming and focusing.

import {DaemonError, post, wordsOf} from './daemon.js';
import {mayFlash} from './dialogs.js';
import {FrameView} from './frame_view.js';
import {clock, parseLights} from './words.js';

const byId = id => document.getElementById(id);
const kEveryMs = 200;
const kOldMs = 3000;  // a frame that came so long ago is no longer live...
const kOldFrames = 3;  // ...unless the camera is as slow as that
const kPaths = {picture: '/v1/preview.png', facts: '/v1/preview/facts'};

export class LivePanel {
  constructor() {
    this.view = new FrameView('live');
    this.view.use(kPaths);
    this.view.changed = () => this.fetch().catch(() => {});  // the link tells
    this.view.maxAgeMs = kOldMs;
    this.nLights = 0;
    this.isShown = false;
    this.isOnline = false;
    this.streams = false;
    this.since = 0;
    byId('live-form').onsubmit = event => {
      event.preventDefault();
      this.light();
    };
    byId('live-stop').onclick = () => this.stop();
    this.blank('No picture yet. Light something, or start a run.');
    this.loop();
  }

  /** Of the rig file, as the daemon tells it. */
  begin(rig) {
    this.nLights = rig.lights;
    this.view.maxAgeMs = Math.max(kOldMs, kOldFrames * 1000 / rig.cameras[0].fps);
  }

  show(isShown) {
    this.isShown = isShown;
  }

  /** @param streams  the camera should deliver frames in this phase */
  tell(isOnline, streams) {
    if (streams && !this.streams) {
      this.since = Date.now();
    }
    this.isOnline = isOnline;
    this.streams = streams;
    if (!isOnline || !streams) {
      this.blank(isOnline ? 'No picture: the camera is idle. Light something, or start a run.'
                          : 'No picture: the daemon does not answer.');
    }
  }

  blank(words) {
    byId('live-hint').hidden = false;
    byId('live-hint').textContent = words;
    byId('live-facts').textContent = '';
    this.view.clear();
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
    const {view} = this;
    const news = await view.update();
    if (!this.streams || !this.isOnline) {
      this.view.clear();
      return;
    }
    if (news === 'new') {
      this.since = Date.now();
      byId('live-facts').textContent =
        `Frame ${view.sequence} at ${clock(this.since)}. ` +
        (view.saturated > 0 ? `${(100 * view.saturated).toFixed(2)} % saturated.` : 'Nothing is saturated.');
      byId('live-hint').hidden = true;
    } else if (news === 'old' || (news === 'none' && Date.now() - this.since > kOldMs)) {
      this.blank(`No new picture since ${clock(this.since)}.`);
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
