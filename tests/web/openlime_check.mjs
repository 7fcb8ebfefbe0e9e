// What OpenLIME shows of the folders that `haarlight fit` writes, in headless Chromium, against the
// pictures of `haarlight convert FOLDER --light`: decibels per basis.
//   node openlime_check.mjs HAARLIGHT MODULES BUNDLE OUT CAPTURE [CAPTURE...]
// HAARLIGHT: the program; MODULES: where playwright-core is installed; BUNDLE: a script that exports
// OpenLIME's Viewer and Layer (scripts/openlime_check makes it of a checkout); OUT: the folders;
// CAPTURE: a folder of JPEG pictures with dirs.lp. Exits 1 where a basis is below the least median.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import {Browser} from './harness.mjs';

const [haarlight, modules, bundle, out, ...captures] = process.argv.slice(2).map(p => path.resolve(p));
const kBases = ['ptm', 'lptm', 'hsh4', 'hsh9', 'bilinear'];
const kLights = 9;
// OpenLIME draws linear light into 8 bits before it codes them: a black's first step is 20 of 255,
// which costs pictures of middle tones 50 dB and dark ones more.
const kLeastMedian = 40;

/** Unit vectors on a spiral from the zenith to ten degrees over the horizon, with three decimals. */
const lights = [...Array(kLights).keys()].map(i => {
  const z = 0.18 + 0.82 * (i + 0.5) / kLights;
  const turn = 0.4 + i * Math.PI * (3 - Math.sqrt(5));
  const rho = Math.sqrt(1 - z * z);
  return [rho * Math.cos(turn), rho * Math.sin(turn), z];
});

const kTypes = {'.json': 'application/json', '.jpg': 'image/jpeg', '.png': 'image/png', '.js': 'text/javascript'};
const server = http.createServer((request, response) => {
  const {pathname} = new URL(request.url, 'http://localhost');
  const name = pathname === '/openlime.js' ? bundle : path.join(out, path.normalize(pathname));
  if (pathname === '/') {
    response.setHeader('Content-Type', 'text/html');
    response.end('<!doctype html><title>OpenLIME</title><style>body { margin: 0 }</style>');
  } else if (fs.existsSync(name) && kTypes[path.extname(name)]) {
    response.setHeader('Content-Type', kTypes[path.extname(name)]);
    fs.createReadStream(name).pipe(response);
  } else {
    response.statusCode = pathname === '/favicon.ico' ? 204 : 404;
    response.end();
  }
});
await new Promise(resolve => server.listen(0, '127.0.0.1', resolve));
const url = `http://127.0.0.1:${server.address().port}/`;

/** In the page: OpenLIME's viewer on a canvas of the picture's size, its planes loaded. */
async function open([name, background]) {
  const {Viewer, Layer} = await import('/openlime.js');
  const {width, height} = await (await fetch(`${name}/info.json`)).json();
  const box = document.createElement('div');
  box.style = `position: relative; width: ${width}px; height: ${height}px; background: ${background}`;
  box.innerHTML = `<canvas style="display: block; width: ${width}px; height: ${height}px"></canvas>`;
  document.body.append(box);
  const viewer = new Viewer(box, {canvas: {preserveDrawingBuffer: true}});
  const layer = new Layer({type: 'rti', url: `${name}/info.json`, layout: 'image'});
  viewer.canvas.addLayer('picture', layer);
  const end = performance.now() + 15000;
  const isLoaded = () => layer.status === 'ready' && [...layer.tiles.values()].some(tile => tile.missing === 0);
  while (!isLoaded()) {
    if (performance.now() > end) {
      throw new Error(`OpenLIME does not load ${name}: ${layer.status}`);
    }
    await new Promise(resolve => setTimeout(resolve, 20));
  }
  viewer.camera.fitCameraBox(0);
  globalThis.shown = {viewer, layer};
  return {width, height};
}

/** In the page. */
async function light([x, y]) {
  const {viewer, layer} = globalThis.shown;
  layer.setLight([x, y], 0);
  viewer.canvas.draw(performance.now() + 1);
  await new Promise(resolve => requestAnimationFrame(() => requestAnimationFrame(resolve)));
}

/** In the page: PSNR in dB of two pictures. */
async function decibelsOf([shown, truth]) {
  const pixels = async source => {
    const image = new Image();
    image.src = source;
    await image.decode();
    const flat = document.createElement('canvas');
    flat.width = image.naturalWidth;
    flat.height = image.naturalHeight;
    const context = flat.getContext('2d', {willReadFrequently: true});
    context.drawImage(image, 0, 0);
    return context.getImageData(0, 0, flat.width, flat.height).data;
  };
  const [a, b] = [await pixels(shown), await pixels(truth)];
  if (a.length !== b.length) {
    throw new Error(`${a.length / 4} pixels are shown of ${b.length / 4}`);
  }
  let squares = 0;
  for (let i = 0; i < a.length; ++i) {
    squares += i % 4 === 3 ? 0 : (a[i] - b[i]) ** 2;
  }
  return 10 * Math.log10(255 * 255 * 0.75 * a.length / Math.max(squares, 1e-9));
}

const median = values => values.sort((a, b) => a - b)[(values.length - 1) >> 1];
const browser = await new Browser().begin(modules);
let nBad = 0;
console.log(`${'capture'.padEnd(16)} ${'basis'.padEnd(9)} median dB  worst dB  (page black; white)`);
for (const capture of captures) {
  for (const basis of kBases) {
    const name = `${path.basename(capture)}_${basis}`;
    fs.rmSync(path.join(out, name), {recursive: true, force: true});
    execFileSync(haarlight, ['fit', capture, '--lights', path.join(capture, 'dirs.lp'), '--basis', basis, '-o',
                             path.join(out, name), '--quiet'], {stdio: ['ignore', 'ignore', 'inherit']});
    lights.forEach((l, i) => execFileSync(haarlight, ['convert', path.join(out, name),
      path.join(out, `${name}_${i}.png`), '--force', '--light', l.map(v => v.toFixed(9)).join(',')]));
    const found = [];
    for (const background of ['black', 'white']) {
      const page = await browser.page(url);
      const {width, height} = await page.evaluate(open, [name, background]);
      await page.setViewportSize({width: width + 20, height: height + 20});
      const decibels = [];
      for (let i = 0; i < kLights; ++i) {
        await page.evaluate(light, lights[i]);
        const shown = await page.screenshot({clip: {x: 0, y: 0, width, height}});
        decibels.push(await page.evaluate(decibelsOf, [`data:image/png;base64,${shown.toString('base64')}`,
                                                       `${name}_${i}.png`]));
      }
      found.push({median: median(decibels), worst: Math.min(...decibels)});
      await browser.closePages();
    }
    const text = key => found.map(f => f[key].toFixed(1)).join('; ');
    console.log(`${path.basename(capture).padEnd(16)} ${basis.padEnd(9)} ${text('median')}  ${text('worst')}`);
    nBad += found.some(f => !(f.median >= kLeastMedian)) ? 1 : 0;
  }
}
await browser.end();
server.close();
browser.problems.forEach(problem => console.log(`FAILED  ${problem}`));
process.exit(nBad > 0 || browser.problems.length > 0 ? 1 : 0);
