// SPDX-License-Identifier: Apache-2.0
// The daemon's page: what runs, the map, one shot, live picture, plan, log. docs/reference/page.md tells
// how to use it; every action is a request of docs/reference/http-api.md and a verb of haarlight.

import {DaemonError, Link, get, post, postUrgent, setLogin, wordsOf} from './daemon.js';
import {askForToken, isSure, mayFlash} from './dialogs.js';
import {LivePanel} from './live.js';
import {GridMap, drawSign} from './map.js';
import {PlanPanel} from './plan.js';
import {RigPanel} from './rig.js';
import {ShotPanel} from './shot.js';
import {MARKS, PHASES, clock, cureOf, duration, markOf, moreUrgent, number} from './words.js';

const byId = id => document.getElementById(id);
const kMaxLog = 300;
const kSmallMap = 4096;  // shots; a larger map is square, so that it fits the screen
const kActive = ['preflight', 'running', 'suspended', 'paused', 'safe-off', 'aborting', 'finalise'];

let rig = null;
let state = null;
let shownSession = '';  // of the map; '' before any
let pickedSession = '';  // by the user; '' follows the daemon
let layout = null;
let marks = '';
let isByLight = true;
let lightShots = [];  // by light, from the layout
let maps = [];
let mapsKey = '';
let currentStory = null;
let burning = new Set();  // lights of the pattern that is on now, where it has many

const say = words => {
  byId('say').textContent = words;
};

// ---- the map -------------------------------------------------------------------------------

const faceOf = light => rig.faces.findLast(face => face.first_light <= light) || rig.faces[0];

function nameOf(light) {
  const face = faceOf(light);
  const i = light - face.first_light;
  const on = rig.faces.length > 1 ? ` of face ${face.id}` : '';
  return `light ${light}${on} (row ${Math.floor(i / face.cols)}, column ${i % face.cols})`;
}

/** Shots of a light, where a shot lights one light only. */
const shotsOf = light => lightShots[light] || [];

function findLightShots() {
  lightShots = [];
  layout?.light.forEach((light, shot) => {
    if (light >= 0 && layout.kinds[shot] === 'l') {
      (lightShots[light] ??= []).push(shot);
    }
  });
}

const hasSingleShots = () => layout !== null && layout.light.some(light => light >= 0);

const isDone = letter => letter === 'o' || letter === '?' || letter === 'r';

/** Of each light: the mark that matters most, and the fraction of its shots that is done. */
function classifyLights() {
  findLightShots();
  lightLetters = '';
  lightShares = Array(rig.lights).fill(0);
  lightDone = Array(rig.lights).fill(0);
  for (let light = 0; light < rig.lights; ++light) {
    let letter = '.';
    const shots = shotsOf(light);
    for (const shot of shots) {
      const one = marks[shot] ?? '.';
      lightDone[light] += isDone(one) ? 1 : 0;
      letter = one === '.' ? letter : letter === '.' ? one : moreUrgent(letter, one);
    }
    lightLetters += letter;
    lightShares[light] = shots.length > 0 ? lightDone[light] / shots.length : 0;
  }
}

function describeShot(shot) {
  if (!layout || shot >= layout.kinds.length) {
    return `shot ${shot}`;
  }
  const kind = {l: '', d: ', dark', f: ', flat field', s: ', sentinel'}[layout.kinds[shot]] ?? '';
  const light = layout.light[shot];
  const what = light >= 0 ? `, ${nameOf(light)}` : light === -2 ? ', several lights' : '';
  return `shot ${shot}${kind}${what}: ${markOf(marks[shot]).name}`;
}

function describeLight(light) {
  const n = shotsOf(light).length;
  const mark = markOf(lightLetters[light] ?? '.').name;
  const more = n > 1 ? `, ${lightDone[light]} of its ${n} shots done` : '';
  return `${nameOf(light)}: ${burning.has(light) ? 'lit' : mark}${more}`;
}

function buildMaps() {
  const nShots = layout?.kinds.length ?? 0;
  const key = isByLight ? 'lights' : `shots ${nShots} ${shownSession}`;
  if (!rig || key === mapsKey) {
    return;
  }
  mapsKey = key;
  maps.forEach(map => map.remove());
  const readout = words => {
    byId('map-readout').textContent = words;
  };
  if (isByLight) {
    maps = rig.faces.map(face => {
      const name = rig.faces.length > 1 ? `Face ${face.id}` : face.id;
      const describe = i => describeLight(face.first_light + i);
      return new GridMap({
        title: `${name}: ${face.rows} × ${face.cols} lights, row 0 at the top`,
        rows: face.rows, cols: face.cols, count: face.rows * face.cols, describe,
        moved: i => readout(describe(i)), hover: i => readout(describe(i)),
        open: i => openLight(face.first_light + i),
      });
    });
  } else {
    const cols = Math.max(1, nShots <= kSmallMap ? Math.min(64, Math.ceil(Math.sqrt(nShots)))
                                                 : Math.ceil(Math.sqrt(nShots)));
    maps = nShots === 0 ? [] : [new GridMap({
      title: `${number(nShots)} shots in the order of the plan`,
      rows: Math.ceil(nShots / cols), cols, count: nShots, describe: describeShot,
      moved: i => readout(describeShot(i)), hover: i => readout(describeShot(i)),
      open: i => openShots([i]),
    })];
  }
  byId('maps').replaceChildren(...maps.map(map => map.root));
}

let lightLetters = '';
let lightShares = [];
let lightDone = [];

function drawMaps() {
  if (!rig) {
    return;
  }
  buildMaps();
  classifyLights();
  if (isByLight) {
    maps.forEach((map, f) => {
      const face = rig.faces[f];
      const end = face.first_light + map.count;
      map.set(lightLetters.slice(face.first_light, end),
              new Set([...burning].filter(k => k >= face.first_light && k < end)
                .map(k => k - face.first_light)),
              lightShares.slice(face.first_light, end));
    });
  } else {
    maps.forEach(map => map.set(marks));
  }
  const counts = new Map();
  for (const letter of marks) {
    counts.set(letter, (counts.get(letter) || 0) + 1);
  }
  for (const mark of MARKS) {
    const n = counts.get(mark.letter) || 0;
    const item = byId(`legend-${mark.letter.charCodeAt(0)}`);
    item.querySelector('b').textContent = marks ? number(n) : '';
  }
}

function buildLegend() {
  const style = getComputedStyle(document.documentElement);
  byId('legend').replaceChildren(...MARKS.map(mark => {
    const item = document.createElement('li');
    item.id = `legend-${mark.letter.charCodeAt(0)}`;
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = 36;
    canvas.setAttribute('aria-hidden', 'true');
    const context = canvas.getContext('2d');
    context.fillStyle = style.getPropertyValue(mark.colour);
    context.fillRect(2, 2, 32, 32);
    context.fillStyle = context.strokeStyle =
      style.getPropertyValue(mark.letter === 'w' ? '--text' : '--m-mark');
    drawSign(context, mark.sign, 2, 2, 32);
    item.append(canvas, `${mark.name} `, document.createElement('b'));
    return item;
  }));
  maps.forEach(map => map.draw());
}

function openLight(light) {
  byId('live-lights').value = String(light);
  const shots = shotsOf(light);
  if (shots.length > 0) {
    // The one that gave the light its mark, else the newest that is done.
    const first = shots.find(shot => marks[shot] === lightLetters[light] && !'.o'.includes(marks[shot])) ??
      shots.findLast(shot => isDone(marks[shot])) ?? shots[0];
    openShots(shots, first);
  } else {
    say(layout ? `${nameOf(light)} has no shot of its own: the plan lights several together. See Shots.`
               : `${nameOf(light)}: no run yet.`);
    byId('shot-view').hidden = true;
    byId('shot-none').hidden = false;
    byId('shot-none').textContent = byId('say').textContent;
    selectTab('shot');
  }
}

function openShots(shots, first = shots[0]) {
  selectTab('shot');
  shotPanel.choose(shownSession, shots, first);
}

function storyShown(story) {
  currentStory = story;
  maps.forEach((map, f) => {
    if (!isByLight) {
      map.select(story.shot);
    } else {
      const i = story.lights.length === 1 ? story.lights[0][0] - rig.faces[f].first_light : -1;
      map.select(i >= 0 && i < map.count ? i : -1);
    }
  });
  say(`${byId('shot-title').textContent}. ${byId('shot-verdict').textContent}`);
}

// ---- what the daemon says ------------------------------------------------------------------

let lastStory = {session: '', shot: -1, lights: []};

/** The lights that burn now, of a pattern of many. */
async function findBurning() {
  const shot = state.current;
  if (pickedSession || shot === null || !layout || layout.light[shot] !== -2 ||
      marks[shot] !== '*') {
    burning = new Set();
    return;
  }
  if (lastStory.session !== shownSession || lastStory.shot !== shot) {
    const story = await get(`/v1/sessions/${encodeURIComponent(shownSession)}/shots/${shot}/story`);
    lastStory = {session: shownSession, shot, lights: story.lights.map(([light]) => light)};
  }
  burning = new Set(lastStory.lights);
}

async function followSession() {
  const session = pickedSession || state.session || '';
  if (session !== shownSession) {
    shownSession = session;
    layout = null;
    marks = '';
    currentStory = null;
  }
  if (!session) {
    drawMaps();
    return;
  }
  const base = `/v1/sessions/${encodeURIComponent(session)}`;
  try {
    if (!layout && !(state.session === session && state.is_opening)) {
      layout = await get(`${base}/layout`);
      if (!hasSingleShots() && isByLight && layout.kinds.length > 0) {
        showBy(false);
      }
    }
    if (layout) {
      marks = (await get(`${base}/map`)).marks;
      if (marks.length !== layout.kinds.length) {
        layout = null;
      }
    }
    await findBurning();
  } catch (error) {
    if (!(error instanceof DaemonError)) {
      throw error;
    }
    marks = '';
  }
  drawMaps();
  if (shotPanel.session === shownSession && shotPanel.shot >= 0 && marks) {
    shotPanel.tell(marks[shotPanel.shot]);
  }
}

function lightsWords() {
  const lit = {on: 'lights on', off: 'lights off', unknown: 'lights: not known'};
  return lit[state.lights] || lit.unknown;
}

function showState() {
  const {phase} = state;
  const isPreview = state.is_preview && phase === 'running';
  byId('phase').textContent = isPreview ? 'light for aiming'
    : state.is_opening ? 'opening the session' : PHASES[phase] || phase;
  byId('phase').dataset.phase = phase;
  byId('lights').textContent = lightsWords();
  byId('lights').dataset.lights = state.lights || 'unknown';
  const hasRun = Boolean(state.session) && !isPreview;
  byId('run-title').textContent = hasRun
    ? state.plan?.name ?? 'Run' : isPreview ? 'Light for aiming' : 'No run';
  const fraction = state.shots > 0 ? state.committed / state.shots : 0;
  byId('progress').hidden = !hasRun;
  byId('progress').setAttribute('aria-valuenow', Math.floor(100 * fraction));
  byId('progress').setAttribute('aria-valuetext', `${state.committed} of ${state.shots} shots`);
  byId('progress-bar').style.width = `${100 * fraction}%`;
  const isGoing = phase === 'running' || phase === 'suspended' || phase === 'paused';
  byId('run-left').textContent = !hasRun ? ''
    : phase === 'done' ? 'complete'
    : isGoing && state.seconds_left !== null ? `${duration(state.seconds_left)} left` : '';
  byId('run-facts').textContent = hasRun
    ? `${number(state.committed)} of ${number(state.shots)} shots committed` +
      (state.retries > 0 ? ` · ${number(state.retries)} taken again by itself` : '') +
      ` · ${['done', 'idle'].includes(phase) ? state.folder : state.session}`
    : isPreview ? 'Nothing is stored.' : 'Write or choose a plan, look at what it costs, start it.';
  const can = {
    pause: !isPreview && ['running', 'preflight', 'suspended'].includes(phase),
    resume: ['paused', 'safe-off'].includes(phase),
    abort: kActive.includes(phase) && phase !== 'aborting',
    'to-plan': ['idle', 'done'].includes(phase) && !state.is_opening,
  };
  for (const [id, is] of Object.entries(can)) {
    const button = byId(id);
    if (!is && document.activeElement === button) {
      byId('run-card').tabIndex = -1;
      byId('run-card').focus();
    }
    button.hidden = !is;
  }
  byId('resume').textContent = phase === 'safe-off' ? 'Resume: allow light again' : 'Resume';
  byId('abort').textContent = isPreview ? 'Lights off' : 'Abort';
  const isSuspended = phase === 'suspended';
  byId('suspended').hidden = !isSuspended;
  if (isSuspended) {
    const all = state.reasons.map(reason => cureOf(reason, state.reason));
    setText('suspended-title', `Suspended: ${all.map(([what]) => what).join(' ') || 'the run waits.'}`);
    setText('suspended-cure', `${all.map(([, hint]) => hint).join(' ')} The run resumes by itself.`);
    setText('suspended-detail', state.reason);
  }
  setText('run-message', !isSuspended && state.reason && phase !== 'running' ? state.reason : '');
  const streams = ['running', 'preflight', 'suspended'].includes(phase);
  livePanel.tell(true, streams);
  rigPanel.tell(true);
  shotPanel.allow(howToReshoot());
  byId('old-session').hidden = pickedSession === '' || pickedSession === state.session;
  document.title = (phase === 'running' && hasRun ? `${Math.floor(100 * fraction)} % ` : '') +
    (rig ? `${rig.name} – haarlight` : 'haarlight');
}

function setText(id, text) {
  if (byId(id).textContent !== text) {
    byId(id).textContent = text;
  }
}

/** 'now' in an open session; 'reopen' first, where a complete one is shown and nothing runs. */
function howToReshoot() {
  const isPreview = state.is_preview && state.phase === 'running';
  const isPresent = shownSession === state.session && Boolean(state.session);
  if (isPreview || state.is_opening) {
    return '';
  }
  if (isPresent && ['running', 'preflight', 'paused', 'suspended', 'done', 'safe-off'].includes(state.phase)) {
    return 'now';
  }
  const isComplete = marks !== '' && [...marks].every(letter => 'o?r'.includes(letter));
  return isComplete && ['idle', 'done'].includes(state.phase) ? 'reopen' : '';
}

let lastPhase = '';

async function stateCame(next) {
  state = next;
  if (!rig) {
    await begin();
  }
  document.body.classList.remove('waiting');
  showState();
  if (next.phase !== lastPhase) {
    if (lastPhase) {
      say(`${PHASES[next.phase] || next.phase}. ${next.committed} of ${next.shots} shots committed.`);
    }
    lastPhase = next.phase;
    listSessions();
  }
  await followSession();
  shotPanel.allow(howToReshoot());
}

async function begin() {
  rig = await get('/v1/rig');
  byId('rig-name').textContent = `· ${rig.name}`;
  byId('version').textContent = `haarlightd ${rig.version}`;
  livePanel.begin(rig);
  planPanel.begin(rig);
}

async function listSessions() {
  let sessions = [];
  try {
    ({sessions} = await get('/v1/sessions'));
  } catch {
    return;
  }
  const select = byId('session');
  const options = [new Option('the current one', ''), ...sessions.reverse().map(s => new Option(
    s.id + (s.is_finished ? '' : s.is_aborted ? ' (aborted)' : s.is_active ? '' : ' (unfinished)'), s.id))];
  select.replaceChildren(...options);
  select.value = pickedSession;
  byId('go-on').hidden = !sessions.some(s => s.id === pickedSession && !s.is_finished && !s.is_active);
}

function eventCame(kind, data) {
  if (kind === 'committed') {
    return;  // the map shows it
  }
  const text = data.text ?? (data.session ? `session ${data.session}` : '');
  const item = document.createElement('li');
  const [time, words] = [document.createElement('time'), document.createElement('span')];
  time.textContent = clock(Date.now());
  words.textContent = `${kind}${data.shot === undefined ? '' : ` (shot ${data.shot})`}: ${text}`;
  item.className = kind === 'error' ? 'fault' : kind;
  item.append(time, words);
  const log = byId('log');
  log.prepend(item);
  while (log.children.length > kMaxLog) {
    log.lastChild.remove();
  }
  byId('log-none').hidden = true;
}

function lost(lastAnswer) {
  document.body.classList.add('stale');
  byId('lost').hidden = false;
  byId('lost').textContent = lastAnswer
    ? `Connection lost. What you see is from ${clock(lastAnswer)} and is not live. Trying again. ` +
      'The controller turns the lights off by itself when the daemon is gone.'
    : 'The daemon does not answer. Trying again.';
  byId('phase').textContent = 'not connected';
  byId('phase').dataset.phase = 'lost';
  byId('lights').textContent = 'lights: not known';
  byId('lights').dataset.lights = 'unknown';
  byId('run-left').textContent = '';
  byId('suspended').hidden = true;
  livePanel.tell(false, false);
  rigPanel.tell(false);
  shotPanel.allow('');
}

function found() {
  document.body.classList.remove('stale');
  byId('lost').hidden = true;
  layout = null;  // a restarted daemon may have another session
}

// ---- what the user does ------------------------------------------------------------------

async function act(path, body) {
  try {
    await post(path, body);
    setText('run-message', '');
  } catch (error) {
    setText('run-message', wordsOf(error));
  }
  link.soon();
}

/** In every state, and also while the connection seems lost. */
async function allOff() {
  const note = byId('off-note');
  const begun = performance.now();
  note.hidden = false;
  note.className = 'banner';
  note.textContent = 'Asking for all lights off.';
  try {
    await postUrgent('/v1/all-off');
    const ms = Math.max(1, Math.round(performance.now() - begun));
    note.textContent = `All lights off: the daemon took the order in ${ms} ms.`;
    setTimeout(() => {
      note.hidden = true;
    }, 6000);
  } catch (error) {
    note.className = 'banner bad';
    note.textContent = `ALL OFF WAS NOT ANSWERED. ${wordsOf(error)} Cut the power of the lights.`;
  }
  link.soon();
}

async function resume() {
  const left = state.session && state.committed < state.shots
    ? `${number(state.shots - state.committed)} patterns of the run are still to be flashed.`
    : 'Light is allowed again.';
  if (await mayFlash(left, true)) {
    act('/v1/resume');
  }
}

async function abort() {
  if (state.is_preview || state.committed === state.shots ||
      await isSure('Abort the run?', `${number(state.committed)} committed shots stay on the disk. ` +
        'The session can be continued later.', 'Abort')) {
    act('/v1/abort');
  }
}

async function goOn() {
  const session = pickedSession;
  if (await mayFlash(`The session ${session} goes on: its missing patterns are flashed.`, true)) {
    await act(`/v1/run?session=${encodeURIComponent(session)}`);
    pickSession('');
  }
}

function pickSession(id) {
  pickedSession = id;
  byId('session').value = id;
  byId('old-session').hidden = id === '' || id === state?.session;
  byId('old-session').textContent = id === '' ? '' : `You look at session ${id}, not at what runs now.`;
  listSessions();
  link.soon();
}

function showBy(isLight) {
  isByLight = isLight;
  for (const [id, is] of [['by-light', isLight], ['by-shot', !isLight]]) {
    byId(id).setAttribute('aria-checked', String(is));
    byId(id).tabIndex = is ? 0 : -1;
  }
  setText('map-title', isLight ? 'Lights' : 'Shots');
  drawMaps();
}

let isWide = false;  // the picture has most of the screen

function widen() {
  isWide = !isWide;
  for (const button of document.querySelectorAll('button.wide-look')) {
    button.setAttribute('aria-pressed', String(isWide));
  }
  document.body.classList.toggle('wide-look', isWide);
}

const kTabs = ['shot', 'live', 'plan', 'rig', 'log'];

function selectTab(name) {
  for (const tab of kTabs) {
    const is = tab === name;
    byId(`tab-${tab}`).setAttribute('aria-selected', String(is));
    byId(`tab-${tab}`).tabIndex = is ? 0 : -1;
    byId(`panel-${tab}`).hidden = !is;
  }
  livePanel.show(name === 'live');
  rigPanel.show(name === 'rig');
  document.body.classList.toggle('wide-look', isWide && (name === 'live' || name === 'shot'));
}

function moveByArrows(ids, choose) {
  ids.forEach((id, i) => {
    byId(id).addEventListener('keydown', event => {
      const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[event.key];
      if (step) {
        event.preventDefault();
        const next = (i + step + ids.length) % ids.length;
        choose(next);
        byId(ids[next]).focus();
      }
    });
    byId(id).addEventListener('click', () => choose(i));
  });
}

function keyPressed(event) {
  if (event.key === 'Escape') {
    if (!document.querySelector('dialog[open]')) {  // there Escape says no, and nothing is lit
      event.preventDefault();
      allOff();
    }
    return;
  }
  const isTyping = event.target.closest('input, textarea, select, dialog');
  if (isTyping || event.ctrlKey || event.altKey || event.metaKey || !state) {
    return;
  }
  if (event.key === 'p') {
    (byId('pause').hidden ? byId('resume') : byId('pause')).click();
  } else if (event.key === 'r') {
    byId('reshoot').click();
  }
}

function changeTheme() {
  const root = document.documentElement;
  const isLight = root.dataset.theme
    ? root.dataset.theme === 'light' : matchMedia('(prefers-color-scheme: light)').matches;
  root.dataset.theme = isLight ? 'dark' : 'light';
  localStorage.setItem('theme', root.dataset.theme);
  buildLegend();
  drawMaps();
  rigPanel.draw();
}

// ---- begin ---------------------------------------------------------------------------------

if (localStorage.getItem('theme')) {
  document.documentElement.dataset.theme = localStorage.getItem('theme');
}
setLogin(askForToken);
const shotPanel = new ShotPanel(nameOf, storyShown);
const livePanel = new LivePanel();
const planPanel = new PlanPanel(receipt => {
  pickSession('');
  say(`The run ${receipt.session} begins: ${receipt.shots} shots.`);
});
const rigPanel = new RigPanel();
const link = new Link({state: stateCame, event: eventCame, lost, found});

byId('all-off').onclick = allOff;
byId('pause').onclick = () => act('/v1/pause');
byId('resume').onclick = resume;
byId('abort').onclick = abort;
byId('go-on').onclick = goOn;
byId('to-plan').onclick = () => {
  selectTab('plan');
  byId('plan-text').focus();
};
byId('theme').onclick = changeTheme;
for (const button of document.querySelectorAll('button.wide-look')) {
  button.onclick = widen;
}
byId('session').onchange = event => pickSession(event.target.value);
moveByArrows(['by-light', 'by-shot'], i => showBy(i === 0));
moveByArrows(['span-minutes', 'span-hours'], i => rigPanel.showSpan(i === 0 ? 'minutes' : 'hours'));
moveByArrows(kTabs.map(tab => `tab-${tab}`), i => selectTab(kTabs[i]));
document.addEventListener('keydown', keyPressed);
matchMedia('(prefers-color-scheme: light)').addEventListener('change', () => {
  buildLegend();
  drawMaps();
});
buildLegend();
link.start();
