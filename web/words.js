// SPDX-License-Identifier: Apache-2.0
// Words and numbers as people read them.

export const MARKS = [
  {letter: '.', name: 'pending', colour: '--m-pending', sign: ''},
  {letter: '*', name: 'lit', colour: '--m-lit', sign: 'sun'},
  {letter: '~', name: 'checking', colour: '--m-checking', sign: 'dot'},
  {letter: 'o', name: 'committed', colour: '--m-committed', sign: ''},
  {letter: '?', name: 'suspect', colour: '--m-suspect', sign: 'bang'},
  {letter: 'x', name: 'failed, tried again', colour: '--m-failed', sign: 'cross'},
  {letter: 'w', name: 'to be taken again', colour: '--m-waiting', sign: 'ring'},
  {letter: 'r', name: 'taken again', colour: '--m-reshot', sign: 'ring'},
];
export const markOf = letter => MARKS.find(mark => mark.letter === letter) || MARKS[0];

/** Of several shots of one light, the one that matters most to the operator. */
const kUrgency = '*x?~w.ro';
export const moreUrgent = (a, b) => (kUrgency.indexOf(a) <= kUrgency.indexOf(b) ? a : b);

export const PHASES = {
  boot: 'starting', recover: 'recovering', idle: 'ready', preflight: 'checking the devices',
  running: 'running', paused: 'paused', suspended: 'suspended', aborting: 'ending',
  finalise: 'finishing', done: 'done', 'safe-off': 'all off by request',
};

/** Why a run waits, and what the operator can do about it. */
export const REASONS = {
  camera: ['The camera is lost.', 'Check its cable and its power.'],
  controller: ['The light controller is lost.', 'Check its cable, its power and the address in the rig file.'],
  disk: ['The disk takes no more frames.', 'Free some space, or repair the disk. No frame is lost.'],
  session_folder: ['The session\'s folder was moved or deleted.',
    'Put it back where it was, or abort.'],
  no_clean_frame: ['No clean frame arrives.',
    'Something delays the light or the frames: check the frame rate, the settle times and the exposure in the rig file.'],
  held_back: ['The controller holds the lights back.',
    'Close the interlock, or let the lights cool down.'],
  wrong_light: ['Twice a picture contradicted another one of the same light.',
    'Does the controller act late, or was something moved? It is tried again by itself.'],
};

/** What the daemon says of a reason is more particular than its name. */
export function cureOf(reason, detail) {
  if (reason === 'held_back' && /interlock/i.test(detail)) {
    return ['The interlock is open.', 'Close the rig\'s door or cover; nothing is lit before.'];
  }
  if (reason === 'held_back' && /asked again/i.test(detail)) {
    return ['The controller refuses what it accepted before.',
      'It is asked again. If it stays so, look at its power, its cable and its own log.'];
  }
  if (reason === 'held_back' && /temperature|hot/i.test(detail)) {
    return ['The lights are too hot.', 'They cool down by themselves; is the fan running?'];
  }
  if (reason === 'held_back' && /duty|rest/i.test(detail)) {
    return ['A light needs a rest.', 'Nothing to do; a plan with the order "bit_reversed" avoids it.'];
  }
  return REASONS[reason] || [`The run waits: ${reason}.`, ''];
}

export function duration(seconds) {
  if (!(seconds >= 0)) {
    return '';
  }
  const s = Math.round(seconds);
  if (s < 100) {
    return `${s < 10 && seconds < 9.95 ? seconds.toFixed(1) : s} s`;
  }
  if (s < 3600) {
    return `${Math.floor(s / 60)} min ${String(s % 60).padStart(2, '0')} s`;
  }
  return `${Math.floor(s / 3600)} h ${String(Math.floor(s / 60) % 60).padStart(2, '0')} min`;
}

export function bytes(n) {
  const steps = ['B', 'kB', 'MB', 'GB', 'TB'];
  let i = 0;
  while (n >= 999.5 && i < steps.length - 1) {
    n /= 1000;
    ++i;
  }
  return `${n < 10 && i > 0 ? n.toFixed(1) : Math.round(n)} ${steps[i]}`;
}

export const number = n => Number(n).toLocaleString('en').replaceAll(',', '\u202f');
export const clock = ms => new Date(ms).toTimeString().slice(0, 8);

/** "0-3 17" -> [0, 1, 2, 3, 17]; null when it is no list of lights. */
export function parseLights(text, nLights) {
  const lights = [];
  for (const word of text.split(/[\s,;]+/).filter(Boolean)) {
    const match = /^(\d+)(?:-(\d+))?$/.exec(word);
    if (!match) {
      return null;
    }
    const [first, last] = [Number(match[1]), Number(match[2] ?? match[1])];
    if (last < first || last >= nLights) {
      return null;
    }
    for (let light = first; light <= last; ++light) {
      lights.push(light);
    }
  }
  return lights.length > 0 ? [...new Set(lights)] : null;
}
