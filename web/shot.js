// SPDX-License-Identifier: Apache-2.0
// One shot: its frame, why it can be trusted, and the button that takes it again.

import {get, post, wordsOf} from './daemon.js';
import {mayFlash} from './dialogs.js';
import {FrameView} from './frame_view.js';
import {markOf} from './words.js';

const byId = id => document.getElementById(id);
const kManyChoices = 12;  // shots of one light as buttons; beyond that a list
const kReopenMs = 200;
const kReopenTries = 100;

export class ShotPanel {
  /** @param nameOf  words for a light's number; @param shown  called with a shot's story or null */
  constructor(nameOf, shown) {
    this.nameOf = nameOf;
    this.shown = shown;
    this.view = new FrameView('shot');
    this.session = '';
    this.shot = -1;
    this.letter = '';
    this.turn = 0;
    byId('reshoot').onclick = () => this.reshoot();
  }

  /** Shows `first` of `shots` of `session`, with a choice of the others. */
  choose(session, shots, first = shots[0]) {
    this.session = session;
    const box = byId('shot-choice');
    box.hidden = shots.length < 2;
    box.replaceChildren();
    if (shots.length > kManyChoices) {
      const select = document.createElement('select');
      select.setAttribute('aria-label', `One of the ${shots.length} shots of this light`);
      select.append(...shots.map(shot => new Option(`shot ${shot}`, shot)));
      select.onchange = () => this.open(Number(select.value));
      box.append(select);
    } else {
      for (const shot of shots) {
        const button = document.createElement('button');
        button.type = 'button';
        button.textContent = shot;
        button.setAttribute('aria-label', `shot ${shot}`);
        button.onclick = () => this.open(shot);
        box.append(button);
      }
    }
    this.open(first);
  }

  async open(shot) {
    this.shot = shot;
    this.letter = '';
    for (const one of byId('shot-choice').children) {
      if (one.tagName === 'SELECT') {
        one.value = String(shot);
      } else {
        one.setAttribute('aria-pressed', String(one.textContent === String(shot)));
      }
    }
    await this.refresh();
  }

  /** The map's mark of the shot shown: a new one means new facts. */
  tell(letter) {
    if (this.shot >= 0 && letter !== this.letter) {
      this.letter = letter;
      this.refresh();
    }
  }

  async refresh() {
    const turn = ++this.turn;
    const path = `/v1/sessions/${encodeURIComponent(this.session)}/shots/${this.shot}`;
    let story = null;
    try {
      story = await get(`${path}/story`);
    } catch (error) {
      if (turn === this.turn) {
        byId('shot-none').hidden = false;
        byId('shot-none').textContent = wordsOf(error);
        byId('shot-view').hidden = true;
      }
      return;
    }
    if (turn !== this.turn) {
      return;
    }
    this.letter = story.mark;
    this.story = story;
    this.write(story);
    this.shown(story);
    if (story.words) {
      this.view.use({picture: `${path}/frame.png`, facts: `${path}/facts`});
      this.view.number = '';  // the same shot may have another frame now
      try {
        const news = await this.view.update();
        if (turn === this.turn) {
          this.view.canvas.setAttribute('aria-label', `The frame of shot ${this.shot}`);
          if (news === 'none') {
            byId('shot-verdict').textContent += ' The frame cannot be shown: see the daemon\'s log.';
          }
        }
      } catch (error) {
        byId('shot-verdict').textContent += ` The frame cannot be shown: ${wordsOf(error)}`;
      }
    } else {
      this.view.use(null);
      this.view.clear();
      this.view.canvas.setAttribute('aria-label', 'No frame yet');
    }
  }

  lightWords(story) {
    const n = story.lights.length;
    if (n === 0) {
      return 'all lights off';
    }
    if (n === 1) {
      const [light, level] = story.lights[0];
      const part = level === 65535 ? '' : ` at ${(level / 655.35).toFixed(1)} %`;
      return this.nameOf(light) + part;
    }
    return `${n} lights together`;
  }

  write(story) {
    byId('shot-none').hidden = true;
    byId('shot-view').hidden = false;
    const kind = story.kind === 'light' ? '' : `, ${story.kind}`;
    byId('shot-title').textContent = `Shot ${story.shot}${kind}: ${this.lightWords(story)}`;
    const verdict = byId('shot-verdict');
    const mark = markOf(story.mark).name;
    if (story.mark === 'x') {
      verdict.className = 'verdict bad';
      verdict.textContent = `The last try failed: ${story.problem}. It is taken again by itself.`;
    } else if (!story.words) {
      verdict.className = 'verdict';
      verdict.textContent = `No frame yet: ${mark}.`;
    } else if (story.doubt) {
      verdict.className = 'verdict doubt';
      verdict.textContent = `Look at it: ${story.doubt}.`;
    } else if ('o' === story.mark || 'r' === story.mark) {
      verdict.className = 'verdict good';
      verdict.textContent = story.attempt > 0
        ? `Good, on attempt ${story.attempt + 1}.` : 'Good, on the first attempt.';
    } else {
      verdict.className = 'verdict';
      verdict.textContent = `Now ${mark}; below is its newest frame.`;
    }
    byId('shot-words').replaceChildren(...(story.words || []).map(words => {
      const item = document.createElement('li');
      item.textContent = words;
      return item;
    }));
    byId('shot-evidence').replaceChildren(...Object.entries(story.evidence || {}).map(
      ([name, value]) => {
        const row = document.createElement('tr');
        for (const text of [name.replaceAll('_', ' '), String(value)]) {
          row.insertCell().textContent = text;
        }
        return row;
      }));
    this.allow(this.how);
  }

  /** @param how  'now', 'reopen' (the session first) or '' (not possible) */
  allow(how) {
    this.how = how;
    byId('reshoot').disabled = !how;
    byId('reshoot-why').hidden = Boolean(how) || this.shot < 0;
  }

  /** The session shown becomes the daemon's current one again. */
  async reopen() {
    await post(`/v1/run?session=${encodeURIComponent(this.session)}`);
    for (let i = 0; i < kReopenTries; ++i) {
      const state = await get('/v1/state');
      if (state.session === this.session && !state.is_opening && state.phase === 'done') {
        return;
      }
      await new Promise(resolve => setTimeout(resolve, kReopenMs));
    }
    throw new Error('the session does not open');
  }

  async reshoot() {
    if (this.shot < 0 || !this.how) {
      return;
    }
    const verdict = byId('shot-verdict');
    if (!await mayFlash(`Shot ${this.shot} is lit and taken again.`, false)) {
      return;
    }
    try {
      if (this.how === 'reopen') {
        verdict.className = 'verdict';
        verdict.textContent = 'The session is opened again.';
        await this.reopen();
      }
      await post('/v1/reshoot', {shots: [this.shot]});
      verdict.className = 'verdict';
      verdict.textContent = 'It is taken again.';
    } catch (error) {
      verdict.className = 'verdict bad';
      verdict.textContent = wordsOf(error);
    }
  }
}
