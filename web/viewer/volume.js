// SPDX-License-Identifier: Apache-2.0
// The page of a volume: pointer, keys, points → a view → the server's pictures → the canvas.

import {connectOrbit} from './orbit.js';
import {begun, byId, connectTheme, save, shellWord, tellProblem} from './page.js';
import {ask, askJson} from './server.js';
import {TransferEditor, hexOf, rgbOf} from './transfer_editor.js';
import {VolumeEngine} from './volume_engine.js';

const page = {about: null, look: null, engine: null, shown: null, held: null};

const tell = error => tellProblem(error, 'haarlight render volume');
const stem = () => page.about.file.replace(/\.[^.]*$/, '');
const isFiles = look => JSON.stringify(look) === JSON.stringify(page.about.look);
const stops = () => Number(byId('exposure').value);

/** What is held; nothing: the picture's own. */
const held = () => byId('hold').checked ? page.held : null;

function want(look, at) {
  page.look = look;
  byId('problem').hidden = true;
  page.engine.want(look, at);
}

const seconds = s => s < 0.0995 ? `${Math.round(1000 * s)} ms` : `${Number(s.toPrecision(2))} s`;

/** A picture has come. */
function show(bitmap, facts, blob) {
  const canvas = byId('picture');
  const {size} = page.engine.view.look;
  [canvas.width, canvas.height] = size;
  const context = canvas.getContext('2d');
  context.imageSmoothingEnabled = facts.shrink > 1;
  context.drawImage(bitmap, 0, 0, ...size);
  page.shown = {facts, blob, look: page.engine.view.look};
  if (!held()) {
    page.held = facts.exposure / 2 ** facts.stops;
  }
  const size_words = facts.shrink > 1 ? `, ${facts.width} × ${facts.height} pixels` : '';
  const isExact = facts.kind === 'exact';
  byId('loading').textContent = isExact ? (facts.shrink > 1 ? 'exact, coarse' : 'exact') : 'preview';
  byId('loading').dataset.kind = facts.kind;
  byId('picture-facts').textContent = (isExact ? 'The exact picture' : `A preview (${byId('preview').value}), not exact`) +
    `${size_words}: ${seconds(facts.seconds)}.` +
    (page.about.no_preview ? ` No preview: ${page.about.no_preview}; small exact pictures serve instead.` : '');
  const errors = facts.preview_errors;
  byId('difference').textContent = errors
    ? `The preview (${errors.preview}) was off by ${Number(errors.mean.toPrecision(2))} in the mean, ` +
      `${Number(errors.at_99.toPrecision(2))} at 99 % of ${errors.pixels} pixels, ${Number(errors.worst.toPrecision(2))} at worst ` +
      '(the worst of red, green and blue, before exposure).'
    : '';
  tellCommand();
}

function tellCommand() {
  const {facts, look} = page.shown;
  const scene = isFiles(look) ? page.about.path : `${stem()}-view.toml`;
  const words = ['haarlight render volume', shellWord(scene), '-o', shellWord(`${stem()}-view.png`)];
  if (facts.kind === 'preview') {
    words.push('--algorithm projected-tetrahedra --preview', byId('preview').value);
  }
  if (facts.shrink > 1) {
    words.push(`--size ${facts.width}x${facts.height}`);
  }
  if (held() || stops() !== 0) {
    words.push('--exposure', String(facts.exposure));
  }
  byId('command').textContent = words.join(' ') + (isFiles(look) ? '' : `\n(after Save scene, in the folder of ${stem()}-view.toml)`);
}

function progress(share, shrink) {
  byId('loading').textContent = `exact${shrink > 1 ? ', coarse' : ''}: ${Math.round(100 * share)} %`;
}

async function saveScene() {
  const response = await ask('/v1/volume/scene', {method: 'POST', body: JSON.stringify(page.look)});
  save(await response.blob(), `${stem()}-view.toml`);
}

/** Stops when the picture comes; then the exact one is there. */
async function saveExr() {
  await page.engine.settled();
  save(await page.engine.exr(), `${stem()}-view.exr`);
}

function showExposure() {
  byId('exposure-text').textContent = `${stops()} stops`;
  page.engine.again();
}

function connectControls() {
  const {about} = page;
  connectTheme(() => {
    page.density.draw();
    page.colour.draw();
  });
  connectOrbit(byId('picture'), {
    get: () => page.look.camera,
    home: () => about.look.camera,
    moved: (camera, at) => want({...page.look, camera}, at),
  });
  byId('save').addEventListener('click', () => save(page.shown.blob, `${stem()}-view.png`));
  byId('save-exr').addEventListener('click', () => saveExr().catch(tell));
  byId('save-scene').addEventListener('click', () => saveScene().catch(tell));
  byId('reset').addEventListener('click', () => {
    page.density.show(about.look.density);
    page.colour.show(about.look.colour);
    want(about.look);
  });
  byId('exposure').addEventListener('input', showExposure);
  byId('hold').addEventListener('change', showExposure);
  byId('preview').addEventListener('change', () => page.engine.again());
  byId('preview').disabled = Boolean(about.no_preview);
  byId('preview-note').textContent = about.no_preview;
}

function connectFunctions() {
  const {about} = page;
  const make = (name, labels) => {
    const field = about.fields[name];
    byId(`${name}-facts`).textContent = `${field.name}, on ${field.on}: ${field.range.map(v => Number(v.toPrecision(4))).join(' to ')}`;
    const editor = new TransferEditor({
      canvas: byId(name), inputs: byId(`${name}-fields`), readout: byId(`${name}-readout`), field, labels, mostRows: about.most_rows,
    }, rows => {
      if (name === 'colour') {
        byId('colour-choice').value = hexOf(editor.rows[editor.chosen].slice(1));
      }
      want({...page.look, [name]: rows.map(row => [...row])});
    });
    byId(`${name}-add`).addEventListener('click', () => editor.add());
    byId(`${name}-remove`).addEventListener('click', () => editor.remove());
    editor.show(about.look[name]);
    return editor;
  };
  page.density = make('density', ['Field', 'Extinction per mm']);
  page.colour = make('colour', ['Field', 'Red', 'Green', 'Blue']);
  byId('colour').addEventListener('pointerup', () => {
    byId('colour-choice').value = hexOf(page.colour.rows[page.colour.chosen].slice(1));
  });
  byId('colour-choice').value = hexOf(page.colour.rows[0].slice(1));
  byId('colour-choice').addEventListener('input', event => page.colour.setColour(rgbOf(event.target.value)));
}

async function begin() {
  page.about = await askJson('/v1/volume');
  const {about} = page;
  byId('file-name').textContent = about.file;
  document.title = `${about.file} – haarlight view`;
  page.look = about.look;
  page.engine = new VolumeEngine(about, {
    options: () => ({preview: byId('preview').value, exposure: held(), stops: stops()}),
    shown: show, told: progress, failed: tell,
  });
  connectFunctions();
  connectControls();
  want(about.look);
  await page.engine.settled();
}

/** For tests: what is on the canvas. */
page.renderer = {
  pixels() {
    const {width, height} = byId('picture');
    return {width, height, data: byId('picture').getContext('2d').getImageData(0, 0, width, height).data};
  },
};
window.haarlightView = page;  // for the console and for tests
begun();
page.begun = begin().catch(tell);
