// SPDX-License-Identifier: Apache-2.0
// Pictures of the newest view: previews while it changes, the exact one once it rests. One request for a picture at a
// time; a view that is announced ends what the server still draws of the one before it.

import {ask, ServerError} from './server.js';

const kRest = 180;  // ms without a change
const kFrame = 90;  // ms that a preview may take
const kCoarse = 4;  // of the first exact picture, where the whole one takes long
const kLong = 1.5;  // s
const kBusy = 503;
const kWait = 400;  // ms until a busy server is asked again

const pause = ms => new Promise(resolve => setTimeout(resolve, ms));

export class VolumeEngine {
  /**
   * @param about    of /v1/volume
   * @param options  () → {preview, exposure, stops}: the preview's method; a factor, or nothing; stops on top
   * @param shown    (bitmap, facts, blob) a picture has come @param told  (share) of an exact one so far
   */
  constructor(about, {options, shown, told, failed}) {
    Object.assign(this, {about, options, shown, told, failed});
    const bytes = crypto.getRandomValues(new Uint8Array(10));
    this.client = [...bytes].map(b => (b % 36).toString(36)).join('');
    this.asked = null;
    this.shrink = 1;
    this.exactSeconds = 0;
    this.latencies = [];
  }

  /** The view is another one. @param at  when the user moved, as performance.now() */
  want(look, at = performance.now()) {
    this.asked = {look, at};
    if (this.isResting && look !== this.view.look) {
      this.announce(look).catch(() => {});  // ends the exact picture; the loop tells what is wrong
    }
    this.running ??= this.run().finally(() => {
      this.running = null;
    });
  }

  /** The newest view once more, as the options are now: what the server has drawn of it stays. */
  again() {
    const look = this.asked?.look ?? this.view?.look;
    if (look) {
      this.want(look);
    }
  }

  async settled() {
    while (this.running) {
      await this.running;
    }
  }

  async announce(look) {
    const response = await ask(`/v1/volume/views?client=${this.client}`, {method: 'POST', body: JSON.stringify(look)});
    return (await response.json()).view;
  }

  async run() {
    while (this.asked) {
      const {look, at} = this.asked;
      this.asked = null;
      try {
        if (look !== this.view?.look) {
          this.view = {look, number: await this.announce(look)};
        }
        await this.show(at);
      } catch (error) {
        this.failed(error);
      }
    }
  }

  async show(at) {
    const canPreview = !this.about.no_preview;
    const begun = performance.now();
    await this.picture(canPreview ? 'preview' : 'exact', canPreview ? this.shrink : Math.max(kCoarse, this.shrink));
    const now = performance.now();
    this.latencies.push(now - at);
    this.adapt(now - begun);
    for (let waited = 0; waited < kRest; waited += 20) {
      if (this.asked) {
        return;
      }
      await pause(20);
    }
    this.isResting = true;
    try {
      if (canPreview && this.shrink > 1) {
        await this.picture('preview', 1);
      }
      if (!this.asked && this.exactSeconds > kLong) {
        await this.picture('exact', kCoarse);
      }
      if (!this.asked) {
        await this.picture('exact', 1);
      }
    } finally {
      this.isResting = false;
    }
  }

  /** Smaller previews where they take longer than a frame may. */
  adapt(ms) {
    if (ms > 1.5 * kFrame) {
      this.shrink = Math.min(4, this.shrink + 1);
    } else if (ms < 0.35 * kFrame) {
      this.shrink = Math.max(1, this.shrink - 1);
    }
  }

  /** Asks until it is there, or the view is another one. */
  async picture(kind, shrink) {
    const {preview, exposure, stops} = this.options();
    const words = new URLSearchParams({client: this.client, preview, shrink, stops});
    if (exposure) {
      words.set('exposure', exposure);
    }
    const path = `/v1/volume/views/${this.view.number}/${kind}?${words}`;
    for (;;) {
      let response;
      try {
        response = await ask(path);
      } catch (error) {
        if (error instanceof ServerError && error.status === kBusy) {
          await pause(kWait);
          continue;
        }
        throw error;
      }
      if (response.status === 202) {
        const {is_replaced: isReplaced, share} = await response.json();
        if (this.asked) {
          return;
        }
        if (isReplaced) {  // four other pages have come since
          await pause(kWait);
          this.asked ??= {look: {...this.view.look}, at: performance.now()};
          return;
        }
        this.told(share, shrink);
        continue;
      }
      const facts = JSON.parse(response.headers.get('Haarlight-Picture'));
      const blob = await response.blob();
      const bitmap = await createImageBitmap(blob, {colorSpaceConversion: 'none', premultiplyAlpha: 'none'});
      if (kind === 'exact' && shrink === 1) {
        this.exactSeconds = facts.seconds;
      }
      this.shown(bitmap, facts, blob);
      return;
    }
  }

  /** The exact picture's file. @return  a Blob */
  async exr() {
    for (;;) {
      const response = await ask(`/v1/volume/views/${this.view.number}/exact.exr?client=${this.client}`);
      if (response.status !== 202) {
        return response.blob();
      }
    }
  }
}
