// SPDX-License-Identifier: Apache-2.0
// The page of a picture that is lit by direction: the ball → a map of bytes to colours, the server's or,
// in a published folder, the page's own → the canvas.

import {colourMap} from './colour_map.js';
import {LightBall} from './light_ball.js';
import {begun, byId, connectTheme, pngOf, save, shellWord, showNotes, tellProblem, titleOf, watchGraphics} from './page.js';
import {PanZoom} from './pan_zoom.js';
import {ReflectanceRenderer, sketchLights} from './reflectance_renderer.js';
import {askAbout, askBytes, askJson, isPublished} from './server.js';
import {TiledRenderer} from './tiled_renderer.js';

const kFirstLight = [-0.5, 0.5];  // upper left, as people expect light to fall
const kNotes = {
  picture: '',
  specular: 'The gloss of a shiny surface of this shape is added, which shows fine relief. Not what the object looks like.',
  normals: 'Red leans right, green up, blue faces the camera: what a matte surface of this brightness would have. ' +
    'For measured ones: haarlight shape.',
};

const page = {about: null, renderer: null, ball: null, asked: null, shown: null, latencies: []};

const tell = error => tellProblem(error, 'haarlight convert');

const mapOf = async light => {
  const [x, y, z] = light;
  return isPublished ? colourMap(page.about.model, light) : askJson(`/v1/reflectance/light?x=${x}&y=${y}&z=${z}`);
};

const look = () => ({
  mode: byId('mode').value,
  diffuse: Number(byId('diffuse').value),
  gloss: Number(byId('gloss').value),
  shine: Number(byId('shine').value),
});

/** One question at a time; the newest light is requested when the last answer is drawn. */
async function lightFrom(light, at) {
  page.asked = {light, at};
  if (page.asking) {
    return page.asking;
  }
  page.asking = (async () => {
    try {
      while (page.asked) {
        const {light: wanted, at: begun} = page.asked;
        page.asked = null;
        page.shown = {light: wanted, map: await mapOf(wanted)};
        draw();
        page.latencies.push(performance.now() - begun);
      }
    } catch (error) {
      tell(error);
    } finally {
      page.asking = null;
    }
  })();
  return page.asking;
}

function draw() {
  const {renderer, shown} = page;
  if (!shown || !page.isLoaded) {
    return;
  }
  renderer.show(shown.map, shown.light, look());
  if (!page.firstAt && (renderer.found?.size ?? 1) > 0) {
    page.firstAt = performance.now();
  }
  const [x, y, z] = shown.light;
  const height = Math.round(Math.asin(z) * 180 / Math.PI);
  const numbers = shown.light.map(v => Number(v.toFixed(4)));
  byId('light-readout').textContent = `${numbers.join(', ')}: ${height}° above the picture` +
    (Math.hypot(x, y) > 1e-3 ? `, ${Math.round(Math.atan2(y, x) * 180 / Math.PI)}° counter-clockwise from the right` : '');
  byId('command').textContent =
    `haarlight convert ${shellWord(page.about.file)} picture.png --light ${numbers.join(',')}`;
}

function zoom() {
  const canvas = byId('picture');
  const value = byId('zoom').value;
  if (page.panZoom) {
    page.panZoom.choose(value);
    return;
  }
  byId('stage').classList.toggle('zoomed', value !== 'fit');
  canvas.style.width = value === 'fit' ? '' : `${value * canvas.width / devicePixelRatio}px`;
  canvas.style.imageRendering = Number(value) > 1 ? 'pixelated' : '';
}

function showMode() {
  const {mode, diffuse, gloss, shine} = look();
  byId('gloss-tools').hidden = mode !== 'specular';
  byId('mode-note').textContent = kNotes[mode];
  byId('diffuse-text').textContent = `× ${diffuse}`;
  byId('gloss-text').textContent = `× ${gloss}`;
  byId('shine-text').textContent = String(shine);
  draw();
}

async function savePicture() {
  save(await pngOf(page.renderer.pixels()), `${page.about.file.replace(/\.[^.]*$/, '')}.png`);
}

function connectControls() {
  connectTheme(() => page.ball.draw());
  byId('zoom').addEventListener('change', zoom);
  byId('save').addEventListener('click', () => savePicture().catch(tell));
  for (const id of ['mode', 'diffuse', 'gloss', 'shine']) {
    byId(id).addEventListener('input', showMode);
  }
}

/** The whole picture from the server. */
async function loadWhole(canvas) {
  const {about} = page;
  page.renderer = new ReflectanceRenderer(canvas, about);
  const {renderer} = page;
  for (let layer = 0; layer < renderer.layers; ++layer) {
    byId('loading').textContent = `loading ${Math.round(100 * layer / renderer.layers)} %`;
    renderer.load(layer, await askBytes(`/v1/reflectance/${about.hash}/planes/${layer}/${renderer.shrink}`));
  }
}

/** A published folder's tiles, as they are seen. */
function openTiles(canvas) {
  const {width, height} = page.about.picture;
  byId('stage').style.setProperty('--shape', `${width} / ${height}`);
  byId('stage').classList.add('tiled');
  let request = null;
  const again = () => {
    request ??= requestAnimationFrame(() => {
      request = null;
      draw();
      tellTiles();
    });
  };
  page.renderer = new TiledRenderer(canvas, page.about, again, tell);
  page.panZoom = new PanZoom(byId('stage'), page.renderer, again);
  page.isTilesSettled = () => request === null && page.renderer.isComplete && page.renderer.underWay.size === 0;
}

function tellTiles() {
  const {renderer, about: {picture}} = page;
  byId('loading').textContent = `${picture.width} × ${picture.height}` + (renderer.isComplete ? '' : ', loading …');
}

async function begin() {
  const canvas = byId('picture');
  watchGraphics(canvas, () => { page.isLoaded = false; }, tell);
  page.about = await askAbout('/v1/reflectance');
  const {about} = page;
  byId('file-name').textContent = about.file;
  document.title = titleOf(about);
  showNotes(about);
  page.ball = new LightBall(byId('ball'), lightFrom);
  connectControls();
  await (isPublished ? openTiles(canvas) : loadWhole(canvas));
  const {renderer} = page;
  renderer.sketchMaps = await Promise.all(sketchLights.map(mapOf));
  page.isLoaded = true;
  const {width, height} = about.picture;
  byId('loading').textContent = `${width} × ${height}`;
  byId('picture-facts').textContent = `${about.basis} of ${about.terms} terms, ${about.planes} planes of 8 bits` +
    (renderer.shrink > 1 ? `. Shown are means of ${renderer.shrink} × ${renderer.shrink} pixels: the full picture does not fit this page.` : '.');
  zoom();
  showMode();
  page.ball.put(...kFirstLight, performance.now());
  await page.asking;
}

/** For tests: the light requested, and every tile of the view. */
async function settled() {
  while (page.asking || (page.isTilesSettled && !page.isTilesSettled())) {
    await (page.asking ?? new Promise(resolve => setTimeout(resolve, 20)));
  }
}

page.engine = {settled};
window.haarlightView = page;  // for the console and for tests
begun();
page.begun = begin().catch(tell);
