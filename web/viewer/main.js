// SPDX-License-Identifier: Apache-2.0
// Wiring: what the user does → the light weights → the engine; what the engine has drawn →
// the page's words.

import {Basis, askWeights, sendEnvironment} from './basis.js';
import {Engine} from './engine.js';
import {askHull} from './hull.js';
import {FaceLayout, LightMap, SkyLayout} from './light_map.js';
import {begun, byId, connectTheme, pngOf, save, shellWord, showNotes, tellProblem, titleOf, watchGraphics} from './page.js';
import {FullError} from './page_store.js';
import {PublishedTurns} from './published.js';
import {ReceiverMode, connectChoice} from './receiver.js';
import {Renderer} from './renderer.js';
import {ServerError, isPublished} from './server.js';
import {Turntable} from './turntable.js';

const kPollMs = 60;
const kRestMs = 150;     // without a movement: the environment rests at its angle
const kTellMs = 200;
const kTermStops = 100;  // of the slider; the last one is "all"
const kGone = 1e-3;      // of the brush's level: a light that erasing leaves weaker is turned off
const kListed = 12;      // lights that the command line still names one by one
const kListedByShadow = 64;  // for a command that takes no file of weights

const kMoreMemory = isPublished ? 'publish it again with fewer --terms'
  : 'give haarlight view a larger --memory: the page takes a quarter of it, at most 1 GB';

const page = {
  basis: null, renderer: null, engine: null, maps: [],
  columns: null,        // light weights: one or three arrays
  mode: 'move',
  environment: null,    // {id of the server's, name, degrees, isExact, turntable, weights}
  source: 'light',      // or environment, painted: where the weights come from
  level: 1,             // the weight at the brush's full strength
  strokes: 0,           // by the user: weights that were requested before one come too late
  receiver: null,       // the mode that casts a shadow on one
  isStacked: matchMedia('(max-width: 700px)'),
};

// ---- what went wrong ------------------------------------------------------------------------

const tell = error => tellProblem(error, 'haarlight relight');

const megabytes = bytes => `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;

// ---- weights --------------------------------------------------------------------------------

/** One array where the three are equal, as the command takes weights of one colour. */
function simplest(columns) {
  const [r, g, b] = columns;
  return columns.length === 3 && r.every((v, k) => v === g[k] && v === b[k]) ? [r] : columns;
}

function colourOfBrush() {
  const text = byId('colour').value;
  return [1, 3, 5].map(at => {
    const v = parseInt(text.slice(at, at + 2), 16) / 255;
    return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  });
}

function setWeights(columns, source, at) {
  page.columns = simplest(columns);
  page.source = source;
  if (page.receiver?.isOpen && page.receiver.hull) {
    page.receiver.setWeights(page.columns, at);
  } else {
    page.engine.setWeights(page.columns, at);
  }
  showMaps();
}

function showMaps() {
  let peak = 0;
  for (const column of page.columns) {
    for (const weight of column) {
      peak = Math.max(peak, weight);
    }
  }
  page.maps.forEach(map => map.set(page.columns, peak));
}

const threeColumns = () =>
  page.columns.length === 3 ? page.columns.map(column => column.slice()) : [0, 1, 2].map(() => page.columns[0].slice());

/** Weights that the user chose. */
function choose(columns, source, level, at) {
  ++page.strokes;
  page.level = level;
  setWeights(columns, source, at);
}

/** One light at full weight in the brush's colour. */
function lightOne(k, at) {
  const columns = colourOfBrush().map(part => {
    const column = new Float64Array(page.basis.nLights);
    column[k] = part;
    return column;
  });
  choose(columns, 'light', 1, at);
}

/** Paint adds light towards the brush's colour, erase takes it away. */
function stroke(map, i, at) {
  const columns = threeColumns();
  const colour = colourOfBrush();
  const strength = Number(byId('strength').value);
  const {level} = page;
  for (const [j, factor] of map.under(i, Number(byId('brush').value))) {
    const part = strength * factor;
    columns.forEach((column, c) => {
      const k = map.layout.first + j;
      if (page.mode === 'erase') {
        const left = column[k] * (1 - part);
        column[k] = left < kGone * level ? 0 : left;
      } else {
        column[k] = Math.max(column[k], Math.min(colour[c] * level, column[k] + colour[c] * level * part));
      }
    });
  }
  choose(columns, 'painted', level, at);
}

const handlers = {
  stroke(map, i, isFirst, at) {
    if (page.mode === 'move') {
      lightOne(map.layout.first + i, at);
    } else {
      stroke(map, i, at);
    }
  },
  key(map, i, isEnter, at) {
    if (page.mode === 'move') {
      lightOne(map.layout.first + i, at);
    } else if (isEnter) {
      stroke(map, i, at);
    }
  },
  hover(map, i) {
    const k = map.layout.first + i;
    const weight = page.columns.map(column => Number(column[k].toPrecision(3)));
    const words = weight.every(v => v === 0) ? 'dark' : `weight ${weight.join(', ')}`;
    byId('map-readout').textContent = `${map.layout.describe(i)}: ${words}`;
  },
};

// ---- environments ---------------------------------------------------------------------------

const environmentMessage = (text, isError = false) => {
  byId('environment-message').textContent = text;
  byId('environment-message').classList.toggle('error', isError);
};

const pause = ms => new Promise(resolve => setTimeout(resolve, ms));

async function loadEnvironment(file) {
  const most = page.basis.about.environment_bytes;
  if (file.size > most) {
    environmentMessage(`${file.name} has ${megabytes(file.size)}, at most ${megabytes(most)} are accepted.\n` +
      'Hint: make it smaller; a light sees no detail finer than its own cell.', true);
    return;
  }
  environmentMessage(`reading ${file.name} …`);
  try {
    const id = await sendEnvironment(file);
    await showEnvironment({
      id, name: file.name, turntable: new Turntable(degrees => askWeights(id, degrees, 'quick')),
      weights: (degrees, quality) => askWeights(id, degrees, quality),
    });
  } catch (error) {
    tellEnvironment(error);
  }
}

/** One of those that a published folder holds. */
async function choosePublished(environment) {
  environmentMessage(`loading ${environment.name} …`);
  try {
    const turns = await PublishedTurns.open(environment, page.basis.nLights);
    byId('turn').step = turns.step;
    await showEnvironment({name: environment.name, turntable: turns, weights: async degrees => turns.at(degrees)});
  } catch (error) {
    tellEnvironment(error);
  }
}

function tellEnvironment(error) {
  environmentMessage(error.message, true);
  if (!(error instanceof ServerError)) {
    throw error;
  }
}

/** @param environment  {name, turntable, weights: (degrees, quality) → its weights there} */
async function showEnvironment(environment) {
  const {name, turntable} = environment;
  page.environment?.turntable.end();
  page.environment = {...environment, degrees: 0};
  byId('environment-name').textContent = isPublished ? '' : name;
  byId('turn').value = 0;
  byId('turn-text').textContent = '0°';
  await turn(0);
  byId('turn-tool').hidden = false;
  await turntable.fill(() => !isTurning);
}

let turning = null;  // the angle that is requested, while one is in progress
let isTurning = false;

/** Shows the environment at an angle: quick weights at once, exact ones when it rests there. */
async function turn(degrees, at) {
  turning = {degrees, at, strokes: page.strokes};
  const known = page.environment.turntable.at(degrees);
  if (known) {
    take(known, turning, page.environment.turntable.isExact ? 'exact' : 'quick');
    turning.isShown = true;
  }
  if (isTurning) {
    return;
  }
  isTurning = true;
  try {
    while (turning) {
      const wanted = turning;
      turning = null;
      page.engine.setMoving(true);
      if (!wanted.isShown) {
        await weightsOf(wanted, 'quick');
      }
      await pause(wanted.isShown ? kRestMs : 0);
      page.engine.setMoving(turning !== null);
      if (!turning) {
        await weightsOf(wanted, 'exact');
      }
    }
  } finally {
    isTurning = false;
    page.engine.setMoving(false);
  }
}

/** Requests weights until they arrive, or are no longer wanted. */
async function weightsOf(wanted, quality) {
  for (;;) {
    const found = await page.environment.weights(wanted.degrees, quality);
    if (page.strokes !== wanted.strokes || turning?.isShown) {
      return;
    }
    if (found.is_ready) {
      take(found, wanted, quality);
      return;
    }
    if (turning) {
      return;
    }
    await pause(kPollMs);
  }
}

function take(found, wanted, quality) {
  const {environment} = page;
  environment.degrees = wanted.degrees;
  environment.isExact = quality === 'exact';
  const columns = found.weights.map(column => Float64Array.from(column));
  page.level = columns.reduce((most, column) => column.reduce((a, b) => Math.max(a, b), most), 0) || 1;
  setWeights(columns, 'environment', quality === 'quick' ? wanted.at : undefined);
  const missing = (100 * found.missing_share).toFixed(1);
  environmentMessage(`${found.layout}. ${found.missing_share > 1e-6
    ? `${missing} % of its light comes from where the rig has no lights.` : 'The lights reach all of its light.'}` +
    (environment.isExact ? '' : ' Turning: from a smaller picture of it.'));
}

// ---- the picture's words --------------------------------------------------------------------

/** Slider's position to a number of terms: 0, then 1 … all on a log scale. */
function termsOf(position) {
  const all = Math.max(1, page.engine.lighting?.termsAll ?? page.basis.nLights);
  if (position <= 0 || position >= kTermStops) {
    return position <= 0 ? 0 : Infinity;
  }
  return Math.min(all, Math.round(all ** ((position - 1) / (kTermStops - 1))));
}

/** What the stated error leaves out. */
function clippedWords({clipped}) {
  if (!clipped) {
    return ' What was clipped is not known (an older file).';
  }
  const fraction = percent(clipped.share);
  return clipped.share > 0
    ? ` Not in the error: ${fraction} of the values were clipped in every exposure and are lower bounds.` : '';
}

const percent = fraction => fraction === Infinity ? 'not bounded' : `${Number((100 * fraction).toPrecision(2))} %`;

let tellAt = 0;

/** Words cost more than a picture under software GL: they follow a moving one five times a second. */
function tellSoon() {
  tellAt ||= setTimeout(() => {
    tellAt = 0;
    tellStatus();
  }, kTellMs);
}

function tellStatus() {
  const {engine} = page;
  const status = engine.status();
  const terms = `${status.terms} of ${status.termsAll} terms`;
  byId('picture-facts').textContent = status.isWhole
    ? `${terms}, error at most ${percent(status.bound)}. Exposure ${Number(status.exposure.toPrecision(4))}.${clippedWords(page.basis.about)}`
    : `${terms}, the others follow …`;
  byId('name-first').textContent = `${status.terms} terms`;
  byId('name-difference').textContent = `difference × ${engine.amplify}, grey: none`;
  byId('picture').classList.toggle('small', page.basis.width < 300 && !engine.isComparing);
  if (status.isWhole) {
    showCommand();
  }
}

const litLights = () => [...page.columns[0].keys()].filter(k => page.columns.some(column => column[k] !== 0));

/** The light that is set, as the command line has it. */
function lightWords() {
  const {environment} = page;
  const words = [];
  if (page.source === 'environment' && environment) {
    words.push(`--cubemap ${shellWord(environment.name)}`);
    if (environment.degrees !== 0) {
      words.push(`--rotate ${environment.degrees}`);
    }
  } else {
    const lit = litLights();
    if (page.columns.length === 1 && lit.length > 0 && lit.length <= kListed) {
      lit.forEach(k => words.push(page.columns[0][k] === 1 ? `--light ${k}` : `--light ${k}=${page.columns[0][k]}`));
    } else {
      words.push('--weights weights.json');
    }
  }
  return words;
}

function showCommand() {
  const {basis, engine} = page;
  const words = [`haarlight relight ${shellWord(basis.about.file)}`, ...lightWords()];
  if (engine.terms !== Infinity) {
    words.push(`--terms ${engine.terms}`);
  }
  words.push(`--exposure ${engine.exposure} -o picture.png`);
  byId('command').textContent = words.join(' ');
}

function tellLoading() {
  const {basis} = page;
  const left = basis.isLeftOut.reduce((sum, is) => sum + is, 0);
  byId('loading').textContent = basis.isComplete ? `${basis.width} × ${basis.height}, ${basis.nLights} lights` +
    (left > 0 ? `; ${basis.nLights - left} of ${basis.nLights} terms are published; the bound on the error covers the others` : '')
    : `loading ${Math.round(100 * basis.arrived / Math.max(1, basis.wanted))} %`;
}

// ---- controls -------------------------------------------------------------------------------

const stem = () => page.basis.about.file.replace(/\.hlb$/, '');

async function savePicture() {
  await page.engine.settled();
  save(await pngOf(page.renderer.pixels()), `${stem()}.png`);
}

function saveWeights() {
  const {columns} = page;
  const list = [...columns[0].keys()].map(k =>
    columns.length === 1 ? columns[0][k] : columns.map(column => column[k]));
  save(new Blob([`${JSON.stringify(list)}\n`], {type: 'application/json'}), 'weights.json');
}

function showBrush() {
  page.maps.forEach(map => {
    map.brush = page.mode === 'move' ? 0 : Number(byId('brush').value);
    map.draw();
  });
}

function connectControls() {
  const {engine} = page;
  const onInput = (id, act) => byId(id).addEventListener('input', event => act(byId(id), event));
  onInput('terms', (input, event) => {
    engine.terms = termsOf(Number(input.value));
    byId('terms-text').textContent = engine.terms === Infinity ? 'all' : String(engine.terms);
    engine.touch(event.timeStamp);
  });
  onInput('stops', input => {
    engine.stops = Number(input.value);
    byId('stops-text').textContent = `${engine.stops > 0 ? '+' : ''}${engine.stops} stops`;
    engine.show();
  });
  onInput('hold', input => {
    engine.heldExposure = input.checked ? engine.baseExposure : null;
    engine.touch();
  });
  onInput('compare', input => {
    engine.isComparing = input.checked;
    byId('panel-names').hidden = !input.checked;
    engine.touch();
  });
  onInput('amplify', input => {
    engine.amplify = Number(input.value);
    engine.show();
  });
  const stack = () => {
    engine.isStacked = page.isStacked.matches;
    byId('panel-names').classList.toggle('stacked', engine.isStacked);
    engine.show();
  };
  page.isStacked.addEventListener('change', stack);
  stack();
  connectChoice(['move', 'paint', 'erase'].map(mode => `mode-${mode}`), id => {
    page.mode = id.slice('mode-'.length);
    showBrush();
  });
  onInput('brush', showBrush);
  for (const [id, weight] of [['clear', 0], ['all-lights', 1]]) {
    byId(id).addEventListener('click', () => choose([new Float64Array(page.basis.nLights).fill(weight)], 'painted', 1));
  }
  byId('save').addEventListener('click', () => savePicture().catch(tell));
  byId('save-weights').addEventListener('click', saveWeights);
  byId('environment-file').addEventListener('change', event => {
    if (event.target.files.length > 0) {
      loadEnvironment(event.target.files[0]);
    }
  });
  onInput('turn', (input, event) => {
    byId('turn-text').textContent = `${input.value}°`;
    turn(Number(input.value), event.timeStamp).catch(error => environmentMessage(error.message, true));
  });
}

// ---- the shadow on a receiver ---------------------------------------------------------------

/** Offers the mode, or says why this capture has none. */
async function offerReceiver() {
  const {state, problem} = await askHull();
  if (state === 'refused') {
    tellNoReceiver(new ServerError(0, problem));
    return;
  }
  page.receiver = new ReceiverMode(receiverLightWords, tell);
  byId('shows').hidden = false;
  const pick = connectChoice(['show-picture', 'show-receiver'], id => {
    const isReceiver = id === 'show-receiver';
    byId('picture-part').hidden = isReceiver;
    byId('receiver-part').hidden = !isReceiver;
    if (!isReceiver) {
      page.receiver.close();
      page.engine.setWeights(page.columns);
      return;
    }
    page.receiver.opened = page.receiver.open(page.columns, page.basis.about.file).catch(error => {
      pick('show-picture');
      if (!(error instanceof ServerError)) {
        tell(error);
        return;
      }
      byId('shows').hidden = true;
      tellNoReceiver(error);
    });
  });
}

function tellNoReceiver(error) {
  byId('receiver-absent').hidden = false;
  byId('receiver-absent').textContent = `No shadow on a receiver for this file: ${error.message}`;
}

/** The light as `haarlight shadow` takes it, which knows no file of weights; nothing where it cannot be said. */
function receiverLightWords() {
  if (page.source === 'environment') {
    return lightWords().join(' ');
  }
  const lit = litLights();
  return page.columns.length === 1 && lit.length > 0 && lit.length <= kListedByShadow
    ? `--light ${lit.map(k => page.columns[0][k] === 1 ? k : `${k}=${page.columns[0][k]}`).join(',')}` : '';
}

/** The environments of a published folder, where it has some; none can be brought. */
function offerPublished() {
  const environments = page.basis.about.environments ?? [];
  byId('environment-card').hidden = environments.length === 0;
  byId('environment-own').hidden = true;
  byId('environment-words').textContent = 'Those that were published with the picture. With others: haarlight view.';
  const list = byId('environment-list');
  list.hidden = false;
  list.append(...[{name: 'choose …'}, ...environments].map(({name}, i) => new Option(name, i - 1)));
  list.addEventListener('change', () => {
    const environment = environments[list.value];
    if (environment) {
      choosePublished(environment);
    }
  });
}

function connectDrop() {
  let depth = 0;
  const hasFile = event => [...event.dataTransfer.types].includes('Files');
  const shade = by => {
    depth = Math.max(0, depth + by);
    byId('drop').hidden = depth === 0;
  };
  addEventListener('dragenter', event => hasFile(event) && shade(1));
  addEventListener('dragleave', event => hasFile(event) && shade(-1));
  addEventListener('dragover', event => hasFile(event) && event.preventDefault());
  addEventListener('drop', event => {
    event.preventDefault();
    shade(-depth);
    if (event.dataTransfer.files.length > 0) {
      loadEnvironment(event.dataTransfer.files[0]);
    }
  });
}

// ---- start ----------------------------------------------------------------------------------

function makeMaps() {
  const {about} = page.basis;
  const layouts = about.faces ? about.faces.map(face => new FaceLayout(face))
    : [new SkyLayout(about.places, about.names)];
  page.maps = layouts.map(layout => new LightMap(layout, handlers));
  byId('maps').replaceChildren(...page.maps.map(map => map.root));
}

/** The light in the middle of the first map. */
function firstLight() {
  const {layout} = page.maps[0];
  const i = layout.at(0.5, 0.5);
  page.maps[0].cursor = i;
  return layout.first + i;
}

function requireRoom() {
  const {basis} = page;
  const room = basis.about.texture_bytes;
  if (basis.isLossless && basis.mostBytes > room) {
    throw new ServerError(0, {
      what: `This lossless file needs ${megabytes(basis.mostBytes)} of textures; the page may use ${megabytes(room)}.`,
      where: basis.about.file,
      cure: `compress the session with --max-error 0.001, or ${kMoreMemory}`,
    });
  }
}

async function load() {
  const {basis, renderer, engine} = page;
  page.loading = new AbortController();
  const changed = () => {
    engine.lighting = null;
    engine.touch();
  };
  const telling = setInterval(tellLoading, 100);
  try {
    await basis.load(renderer.stores, changed, page.loading);
    tellLoading();
  } catch (error) {
    if (!(error instanceof FullError)) {
      throw error;
    }
    if (!basis.hasPlate) {
      throw new ServerError(0, {
        what: `Not even the clean plate's part fits the ${megabytes(basis.about.texture_bytes)} that the page may use.`,
        where: basis.about.file, cure: kMoreMemory,
      });
    }
    const n = basis.groupOf.filter(g => basis.isLoaded[0][g]).length;
    byId('loading').textContent = `The most important ${n} of ${basis.nLights} pictures fill the page's ` +
      `${megabytes(basis.about.texture_bytes)}; the bound on the error covers the others.`;
  } finally {
    clearInterval(telling);
  }
}

async function begin() {
  const canvas = byId('picture');
  watchGraphics(canvas, () => page.loading?.abort(), tell);
  page.basis = await Basis.open();
  byId('file-name').textContent = page.basis.about.file;
  document.title = titleOf(page.basis.about);
  showNotes(page.basis.about);
  requireRoom();
  page.renderer = new Renderer(canvas, page.basis, new URLSearchParams(location.search).get('sums'));
  page.engine = new Engine(page.renderer, page.basis, tellSoon);
  makeMaps();
  connectControls();
  lightOne(firstLight());  // before anything is waited for: what tells of the picture reads the light
  if (isPublished) {
    offerPublished();
  } else {
    connectDrop();
    await offerReceiver();
  }
  await load();
}

begun();
connectTheme(() => page.maps.forEach(map => map.draw()));
window.haarlightView = page;  // for the console and for tests
page.begun = begin().catch(error => {
  if (!page.renderer?.gl.isContextLost()) {
    tell(error);
  }
});
