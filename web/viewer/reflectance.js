// The page of a picture that is lit by direction: the ball → the server's map of bytes to colours → the canvas.

import {LightBall} from './light_ball.js';
import {NoGraphics} from './graphics.js';
import {ReflectanceRenderer, sketchLights} from './reflectance_renderer.js';
import {ServerError, askBytes, askJson} from './server.js';

const byId = id => document.getElementById(id);
const kFirstLight = [-0.5, 0.5];  // upper left, as people expect light to fall
const kNotes = {
  picture: '',
  specular: 'The gloss of a shiny surface of this shape is added, which shows fine relief. Not what the object looks like.',
  normals: 'Red leans right, green up, blue faces the camera: what a matt surface of this brightness would be. ' +
    'For measured ones: haarlight shape.',
};

const page = {about: null, renderer: null, ball: null, asked: null, shown: null, latencies: []};

function tellProblem(error) {
  const box = byId('problem');
  box.hidden = false;
  if (error instanceof ServerError) {
    box.textContent = error.message;
  } else if (error instanceof NoGraphics) {
    box.textContent = `${error.message}\nCure: use a current Firefox, Chrome, Edge or Safari with WebGL 2, ` +
      'or `haarlight convert` for single pictures.';
  } else {
    box.textContent = `The page made a mistake: ${error.message}\nCure: load the page again.`;
    throw error;
  }
}

const mapOf = ([x, y, z]) => askJson(`/v1/reflectance/light?x=${x}&y=${y}&z=${z}`);

const look = () => ({
  mode: byId('mode').value,
  diffuse: Number(byId('diffuse').value),
  gloss: Number(byId('gloss').value),
  shine: Number(byId('shine').value),
});

/** One question at a time; the newest light is asked for when the last answer is drawn. */
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
      tellProblem(error);
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
  const [x, y, z] = shown.light;
  const height = Math.round(Math.asin(z) * 180 / Math.PI);
  const numbers = shown.light.map(v => Number(v.toFixed(4)));
  byId('light-readout').textContent = `${numbers.join(', ')}: ${height}° over the picture` +
    (Math.hypot(x, y) > 1e-3 ? `, from ${Math.round(Math.atan2(y, x) * 180 / Math.PI)}° against the clock from the right` : '');
  const file = page.about.file;
  byId('command').textContent = `haarlight convert ${/^[\w./=+-]+$/.test(file) ? file : `'${file.replaceAll("'", "'\\''")}'`} ` +
    `picture.png --light ${numbers.join(',')}`;
}

function zoom() {
  const canvas = byId('picture');
  const value = byId('zoom').value;
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
  const {width, height, data} = page.renderer.pixels();
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext('2d').putImageData(new ImageData(data, width, height), 0, 0);
  const link = document.createElement('a');
  link.href = URL.createObjectURL(await canvas.convertToBlob({type: 'image/png'}));
  link.download = `${page.about.file.replace(/\.[^.]*$/, '')}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

function connectControls() {
  byId('theme').addEventListener('click', () => {
    const root = document.documentElement;
    const isDark = root.dataset.theme ? root.dataset.theme === 'dark' : !matchMedia('(prefers-color-scheme: light)').matches;
    root.dataset.theme = isDark ? 'light' : 'dark';
    page.ball.draw();
  });
  byId('zoom').addEventListener('change', zoom);
  byId('save').addEventListener('click', () => savePicture().catch(tellProblem));
  for (const id of ['mode', 'diffuse', 'gloss', 'shine']) {
    byId(id).addEventListener('input', showMode);
  }
}

async function begin() {
  const canvas = byId('picture');
  canvas.addEventListener('webglcontextlost', event => {
    event.preventDefault();
    page.isLoaded = false;
    tellProblem(new ServerError(0, {
      what: 'The graphics processor has dropped the page.', where: 'this browser',
      cure: 'load the page again; close other pages if it comes back',
    }));
  });
  page.about = await askJson('/v1/reflectance');
  const {about} = page;
  byId('file-name').textContent = about.file;
  document.title = `${about.file} – haarlight view`;
  page.renderer = new ReflectanceRenderer(canvas, about);
  const {renderer} = page;
  page.ball = new LightBall(byId('ball'), lightFrom);
  connectControls();
  for (let layer = 0; layer < renderer.layers; ++layer) {
    byId('loading').textContent = `loading ${Math.round(100 * layer / renderer.layers)} %`;
    renderer.load(layer, await askBytes(`/v1/reflectance/${about.hash}/planes/${layer}/${renderer.shrink}`));
  }
  renderer.makeNormals(await Promise.all(sketchLights.map(mapOf)));
  page.isLoaded = true;
  const {width, height} = about.picture;
  byId('loading').textContent = `${width} × ${height}`;
  byId('picture-facts').textContent = `${about.basis} of ${about.terms} terms, ${about.planes} planes of 8 bits` +
    (renderer.shrink > 1 ? `. Shown are means of ${renderer.shrink} × ${renderer.shrink} pixels: the whole does not fit this page.` : '.');
  zoom();
  showMode();
  page.ball.put(...kFirstLight, performance.now());
  await page.asking;
}

page.engine = {settled: async () => { while (page.asking) { await page.asking; } }};
window.haarlightView = page;  // for the console and for tests
page.begun = begin().catch(tellProblem);
