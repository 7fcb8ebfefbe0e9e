// Published folders in a real browser from plain web servers; their pictures against the command's.
//   node publish_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR]
// scripts/page_test BUILD --publish runs it.

import {execFileSync, spawnSync} from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, Suite, expect, until} from './harness.mjs';
import {contrast, fitsThePhone, namesAndRoles} from './page_rules.mjs';
import {StaticServer, pythonServer} from './static_server.mjs';
import {compareFullPixels, writeWaves} from './tiles_harness.mjs';
import {compareWithPng, relight, settled} from './view_harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const option = name => {
  const i = process.argv.indexOf(name);
  return i < 0 ? '' : process.argv[i + 1];
};
const source = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const haarlight = path.join(programs, 'haarlight/haarlight');
const folder = path.join(out, 'publish');
fs.rmSync(folder, {recursive: true, force: true});
fs.mkdirSync(folder, {recursive: true});
const kSmall8 = path.join(source, 'configs/rigs/small8.toml');
const kRoom = path.join(source, 'configs/environments/room.hdr');

/** A basis file of the made scene. */
function made(name, ...words) {
  const file = path.join(folder, `${name}.hlb`);
  execFileSync(path.join(programs, '../tests/web/made_basis'), [file, ...words.map(String)]);
  return file;
}

function publish(file, name, ...words) {
  const site = path.join(folder, name);
  const said = execFileSync(haarlight, ['publish', file, '-o', site, '--force', '--quiet', ...words.map(String)],
                            {encoding: 'utf8'});
  return {site, said};
}

const browser = await new Browser().begin(modules);
const suite = new Suite(browser, option('--only'));

/** Runs body(page, server) on a published folder behind a plain server. */
async function showing(site, body, options = {}) {
  const server = await new StaticServer().begin(site, options.at ?? '/');
  server.lie = options.lie ?? server.lie;
  try {
    const page = await browser.page(server.url + (options.query ?? ''), options.context, options.allowed);
    if (!options.isRefused) {
      await settled(page);
    }
    return await body(page, server);
  } finally {
    await browser.closePages();
    await server.end();
  }
}

const textOf = (page, id) => page.locator(id).innerText();

// ---- basis files ----------------------------------------------------------------------------

const setLights = (page, lights, terms = null) => page.evaluate(async ([given, k]) => {
  const view = window.haarlightView;
  const weights = new Float64Array(view.basis.nLights);
  Object.entries(given).forEach(([light, weight]) => (weights[light] = weight));
  view.engine.terms = k ?? Infinity;
  view.engine.setWeights([weights]);
  await view.engine.settled();
}, [lights, terms]);

async function sameAsRelit(page, file, words) {
  const {worst} = await compareWithPng(page, relight(haarlight, file, words, folder).url);
  expect(worst <= 1, `${words.join(' ')}: differs by ${worst} of 255 from the command's picture`);
}

const kBases = {
  haar: ['--rig', kSmall8, '--width', 90, '--height', 70, '--plate'],
  colour: ['--rig', kSmall8, '--width', 50, '--height', 66, '--channels', 3, '--plate'],
  lossless: ['--grid', 8, '--width', 64, '--height', 70, '--basis', 'direct', '--max-error', 0],
  dct: ['--rig', kSmall8, '--width', 50, '--height', 40, '--plate', '--basis', 'dct'],
  'haar-standard': ['--rig', kSmall8, '--width', 50, '--height', 40, '--plate', '--basis', 'haar-standard'],
  import: ['--grid', 8, '--width', 50, '--height', 40, '--channels', 3],
  '9x7': ['--grid', 7, '--rows', 9, '--width', 50, '--height', 40, '--channels', 3],
};
for (const [name, words] of Object.entries(kBases)) {
  await suite.test(`${name}: from a plain server below a sub-path, the command's pictures`, async () => {
    const file = made(name, ...words);
    const hasRoom = name === 'haar' || name === 'import';
    const {site} = publish(file, `${name}-site`, ...(hasRoom ? ['--environment', kRoom] : []));
    return showing(site, async page => {
      await setLights(page, {27: 1});
      await sameAsRelit(page, file, ['--light', '27']);
      await setLights(page, {9: 1, 36: 2, 60: 0.5}, 9);
      await sameAsRelit(page, file, ['--light', '9=1', '--light', '36=2', '--light', '60=0.5', '--terms', '9']);
      if (!hasRoom) {
        expect(!await page.locator('#environment-card').isVisible(), 'no environment is offered');
        return;
      }
      await page.locator('#environment-list').selectOption({label: 'room.hdr'});
      await page.locator('#turn-tool:visible').waitFor();
      await page.locator('#turn').fill('44');
      await page.evaluate(() => new Promise(resolve => setTimeout(resolve, 400)));
      await settled(page);
      expect(await textOf(page, '#turn-text') === '44°', 'it turns by 2 degrees');
      await page.evaluate(() => { window.haarlightView.engine.terms = Infinity; window.haarlightView.engine.touch(); });
      await settled(page);
      await sameAsRelit(page, file, ['--cubemap', kRoom, '--rotate', '44']);
    }, {at: '/lab/airplane/'});
  });
}

await suite.test('fewer terms: the page and the command say what it costs, and the bound holds', async () => {
  const file = made('cut', ...kBases.haar);
  const {site, said} = publish(file, 'cut-site', '--terms', 36, '--title', 'Cut');
  const error = Number(/at most (\S+) \(/.exec(said)[1]);
  expect(/36 of 64 terms/.test(said) && error > 0.01 && error < 1, said);
  return showing(site, async page => {
    await setLights(page, {27: 1});
    const facts = await until(async () => /^.*error at most.*$/m.exec(await textOf(page, '#picture-facts'))?.[0], 'the bound');
    const bound = Number(/error at most (\S+) %/.exec(facts)?.[1]) / 100;
    expect(bound > 0.01 && bound < 1, `what is left out counts in the page's bound: ${facts}`);
    expect(await page.evaluate(() => window.haarlightView.basis.isComplete), 'all that is published is loaded');
    expect(/36 of 64 terms are published/.test(await textOf(page, '#loading')), await textOf(page, '#loading'));
    expect(/Error\s+at most/.test(await textOf(page, '#notes')), await textOf(page, '#notes'));
    // Against the whole file's picture at the same exposure, in linear light; 8 bits cost less than 0.005 of it.
    const exposure = await page.evaluate(() => window.haarlightView.engine.exposure);
    const truth = relight(haarlight, file, ['--light', '27', '--exposure', String(exposure)], folder).url;
    const found = await page.evaluate(async address => {
      const image = new Image();
      image.src = address;
      await image.decode();
      const {width, height, data} = window.haarlightView.renderer.pixels();
      const context = new OffscreenCanvas(width, height).getContext('2d');
      context.drawImage(image, 0, 0);
      const should = context.getImageData(0, 0, width, height).data;
      const linear = v => v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4;
      let [error, all] = [0, 0];
      for (let i = 0; i < data.length; i += 4) {
        error += (linear(data[i]) - linear(should[i])) ** 2;
        all += linear(should[i]) ** 2;
      }
      return Math.sqrt(error / all);
    }, truth);
    expect(found > 0.005 && found <= bound + 0.005, `differs by ${found}, at most ${bound} is said`);
    return `one light: ${found.toFixed(4)} from the whole file's picture, at most ${bound.toFixed(4)} from the capture's; of all lights ${error}`;
  });
});

await suite.test('notes are shown as text, whatever they hold', async () => {
  const evil = '<script>alert(1)</script> "&\'> <img src=x onerror=alert(2)>';
  const {site} = publish(made('notes', ...kBases.haar), 'notes-site', '--title', evil, '--description', evil,
                         '--author', evil, '--licence', 'CC BY 4.0');
  await showing(site, async page => {
    expect(await page.title() === evil, await page.title());
    const notes = await textOf(page, '#notes');
    expect(notes.split(evil).length === 3 && /CC BY 4.0/.test(notes), notes);
    expect(await page.locator('main img, main script').count() === 0, 'nothing of it is an element');
  });
});

await suite.test('a lying server: each missing, torn or foreign file is named, and what to do', async () => {
  const {site} = publish(made('lies', ...kBases.haar), 'lies-site');
  const html = Buffer.from('<!doctype html><title>Not here</title>');
  const lies = {
    'missing': [/about\.json$/, () => ({status: 404}), /is missing/],
    'missing data': [/pages\/0\/.*bin$/, () => ({status: 404, type: 'text/html', bytes: html}), /is missing/],
    'status 503': [/gains.*bin$/, () => ({status: 503, bytes: html}), /status 503/],
    'a page of its own': [/tables\.bin$/, () => ({type: 'text/html', bytes: html}), /a page of its own/],
    'torn': [/pages\/0\/.*bin$/, bytes => ({bytes: bytes.subarray(0, bytes.length / 2)}), /bytes instead of/],
    'damaged': [/pages\/0\/.*bin$/, bytes => {
      const other = Buffer.from(bytes);
      other[other.length >> 1] ^= 64;
      return {bytes: other};
    }, /is damaged/],
    'damaged about': [/about\.json$/, bytes => ({bytes: Buffer.from(String(bytes).replace('"step":', '"stEp":'))}), /is damaged/],
  };
  for (const [name, [pattern, lie, words]] of Object.entries(lies)) {
    await showing(site, async page => {
      await page.locator('#problem:visible').waitFor();
      const problem = await textOf(page, '#problem');
      expect(words.test(problem) && /Hint: copy the published folder/.test(problem) && pattern.test(problem.split('\n')[1]),
             `${name}: ${problem}`);
    }, {isRefused: true, allowed: [/Failed to load resource/], lie: (file, bytes) => pattern.test(file) ? lie(bytes) : null});
  }
});

await suite.test('python3 -m http.server shows it, and a file opened without a server says what it needs', async () => {
  const {site} = publish(made('python', ...kBases.haar), 'python-site');
  const server = await pythonServer(site);
  try {
    const page = await browser.page(server.url);
    await settled(page);
    expect(await page.locator('#unserved').count() === 0, 'it has begun');
  } finally {
    await browser.closePages();
    server.end();
  }
  const page = await browser.page(`file://${site}/index.html`, {}, [/CORS|ERR_FAILED|origin 'null'/]);
  await page.locator('#unserved:visible').waitFor();
  expect(/needs a web server[^]*python3 -m http\.server/.test(await textOf(page, '#unserved')), 'the words');
});

await suite.test('the command refuses what cannot be shown, and other people\'s folders', async () => {
  const refused = (...words) => {
    const done = spawnSync(haarlight, ['publish', ...words], {encoding: 'utf8'});
    expect(done.status !== 0, `${words.join(' ')} was taken`);
    return done.stderr;
  };
  const file = made('refused', ...kBases.haar);
  const mine = path.join(folder, 'mine');
  fs.mkdirSync(mine);
  fs.writeFileSync(path.join(mine, 'thesis.txt'), 'mine');
  expect(/--force/.test(refused(file, '-o', mine)), 'without --force');
  expect(/published folder only/.test(refused(file, '-o', mine, '--force')), 'with --force');
  expect(fs.readFileSync(path.join(mine, 'thesis.txt'), 'utf8') === 'mine', 'it is still there');
  expect(fs.readdirSync(folder).every(name => !/\.tmp/.test(name)), 'nothing half-written is left');
  expect(/haarlight/.test(refused(mine, '-o', path.join(folder, 'new'))), 'a folder of texts');
  expect(!fs.existsSync(path.join(folder, 'new')), 'nothing was written');
});

// ---- pictures lit by direction --------------------------------------------------------------

const convert = (input, output, ...words) =>
  execFileSync(haarlight, ['convert', input, output, '--force', '--quiet', ...words.map(String)]);

const kShared = path.join(source, '../shared/data/formats');
const kObjects = {
  ptm: () => writeWaves(path.join(folder, 'waves.ptm'), 1300, 700),
  hsh9: () => {
    convert(kObjects.ptm(), path.join(folder, 'waves.rti'));
    return path.join(folder, 'waves.rti');
  },
  web: () => {
    convert(writeWaves(path.join(folder, 'small.ptm'), 300, 200), path.join(folder, 'waves-web'));
    return path.join(folder, 'waves-web');
  },
};
for (const name of fs.existsSync(kShared) ? fs.readdirSync(kShared) : []) {
  if (/\.(ptm|rti)$|^relight_web_/.test(name)) {
    kObjects[name] = () => path.join(kShared, name);
  }
}
if (!fs.existsSync(kShared)) {
  console.log('note: no ../shared/data/formats here: made pictures alone');
}

const lightFrom = (page, x, y) => page.evaluate(async ([u, v]) => {
  window.haarlightView.ball.put(u, v, performance.now());
  await window.haarlightView.engine.settled();
}, [x, y]);

/** At 100 % the canvas against `haarlight convert FILE --light`. */
async function sameAsConverted(page, file, words = []) {
  await page.locator('#zoom').selectOption('1');
  await settled(page);
  const light = await page.evaluate(() => window.haarlightView.shown.light);
  const png = path.join(folder, 'relit.png');
  convert(file, png, '--light', light.join(','), ...words);
  return compareFullPixels(page, `data:image/png;base64,${fs.readFileSync(png).toString('base64')}`);
}

for (const [name, make] of Object.entries(kObjects)) {
  await suite.test(`${name}: tiles at full size are the command's picture, wherever the light stands`, async () => {
    const file = make();
    const {site} = publish(file, `${name}-tiles`);
    return showing(site, async page => {
      let pixels = 0;
      for (const [x, y] of [[0, 0], [0.6, 0.2], [-0.4, -0.7], [0.999, 0]]) {
        await lightFrom(page, x, y);
        const found = await sameAsConverted(page, file);
        expect(found.worst <= 1, `light ${x}, ${y}: differs by ${found.worst} of 255`);
        pixels = found.pixels;
      }
      return `${pixels} pixels compared`;
    }, {at: '/museum/'});
  });
}

await suite.test('it pans and zooms to every full pixel, and loads what is seen alone', async () => {
  const file = writeWaves(path.join(folder, 'large.ptm'), 3000, 1700);
  const {site} = publish(file, 'large-tiles', '--mm-per-pixel', 0.02);
  return showing(site, async (page, server) => {
    const tiles = () => server.asked.filter(({name}) => /plane_0_files/.test(name)).map(({name}) => name);
    expect(tiles().every(name => !/_files\/3\//.test(name)), `the finest level at first: ${tiles()}`);
    await lightFrom(page, 0.3, 0.3);
    await page.locator('#zoom').selectOption('1');
    await settled(page);
    const finest = () => tiles().filter(name => /_files\/3\//.test(name));
    expect(finest().length > 0 && finest().length < 24, `${finest().length} of 24 tiles of the finest level`);
    const before = finest().length;
    const canvas = await page.locator('#picture').boundingBox();
    for (let i = 0; i < 8; ++i) {  // to the lower right corner
      await page.mouse.move(canvas.x + canvas.width - 30, canvas.y + canvas.height - 30);
      await page.mouse.down();
      await page.mouse.move(canvas.x + 30, canvas.y + 30, {steps: 3});
      await page.mouse.up();
    }
    await settled(page);
    const {worst, pixels} = await sameAsConverted(page, file);
    expect(worst <= 1, `differs by ${worst}`);
    expect(finest().length > before, 'more tiles came with the movement');
    expect(await page.evaluate(() => {
      const {renderer} = window.haarlightView;
      const [x, y] = renderer.pictureAt([renderer.canvas.width, renderer.canvas.height]);
      return Math.abs(x - renderer.width) <= 1 && Math.abs(y - renderer.height) <= 1;
    }), 'the last pixel is in the corner');
    await page.locator('#stage').focus();
    await page.keyboard.press('0');
    await settled(page);
    expect(await page.locator('#zoom').inputValue() === 'fit', 'fit');
    const bar = await page.evaluate(() => {
      const {renderer} = window.haarlightView;
      const box = document.getElementById('scale-bar').getBoundingClientRect();
      return {width: box.width, mm: box.width * renderer.canvas.width / renderer.canvas.clientWidth / renderer.scale * 0.02,
              words: document.getElementById('scale-bar').innerText.trim()};
    });
    const told = Number(bar.words.split(' ')[0]) * {'µm': 0.001, mm: 1, cm: 10}[bar.words.split(' ')[1]];
    expect(Math.abs(bar.mm / told - 1) < 0.02, `the bar says ${bar.words} and is ${bar.mm} mm`);
    await page.mouse.move(canvas.x + canvas.width / 3, canvas.y + canvas.height / 3);
    const fixed = () => page.evaluate(([u, v]) => {
      const {renderer} = window.haarlightView;
      return renderer.pictureAt([u * renderer.canvas.width, v * renderer.canvas.height]);
    }, [1 / 3, 1 / 3]);
    const was = await fixed();
    await page.mouse.wheel(0, -600);
    await settled(page);
    const is = await fixed();
    expect(Math.hypot(is[0] - was[0], is[1] - was[1]) < 6, `what is under the pointer stays: ${was}, ${is}`);
    return `${pixels} pixels compared, ${tiles().length} tiles of 36 asked for`;
  });
});

await suite.test('in a window of any width the picture is there, stands still, and fills its box', async () => {
  const {site} = publish(kObjects.ptm(), 'widths-tiles');
  for (const [width, deviceScaleFactor] of [[320, 1], [390, 1], [390, 3], [412, 2.625], [701, 1], [1280, 1.25]]) {
    await showing(site, async page => {
      const box = () => page.evaluate(() => {
        const {canvas} = window.haarlightView.renderer;
        return [canvas.clientWidth, canvas.clientHeight, canvas.width, canvas.height];
      });
      const first = await box();
      await page.evaluate(() => new Promise(resolve => setTimeout(resolve, 300)));
      await settled(page);
      const what = `${width} pixels × ${deviceScaleFactor}`;
      expect(String(await box()) === String(first), `${what}: it grew from ${first} to ${await box()}`);
      const fitted = first[0] * 700 / 1300;  // and of a low picture 16rem, to move it in
      expect(Math.abs(first[1] - Math.max(256, fitted)) <= 1, `${what}: a box of ${first} for 1300 × 700`);
      const lit = await page.evaluate(() => {
        const {data} = window.haarlightView.renderer.pixels();
        return data.reduce((n, v, i) => n + (i % 4 < 3 && v > 8), 0) / (data.length * 3 / 4);
      });
      expect(lit > 0.8 * fitted / first[1], `${what}: ${lit} of the canvas is lit`);
    }, {context: {viewport: {width, height: 844}, deviceScaleFactor}});
  }
});

await suite.test('normals and gloss go across tiles without a seam', async () => {
  const {site} = publish(kObjects.ptm(), 'normals-tiles');
  await showing(site, async page => {
    await page.locator('#zoom').selectOption('1');
    await page.locator('#mode').selectOption('normals');
    await settled(page);
    // The same columns of two rows of waves: beside the seam at 512 the change is not larger than elsewhere.
    const steps = await page.evaluate(() => {
      const {renderer} = window.haarlightView;
      const {width, data} = renderer.pixels();
      const [left, top] = renderer.origin;
      const change = x => {
        let sum = 0;
        for (let y = 200; y < 340; ++y) {
          const at = 4 * ((top + y) * width + left + x);
          sum += Math.abs(data[at] - data[at + 4]);
        }
        return sum / 140;
      };
      return {seam: change(511), near: Math.max(...[480, 490, 500, 520, 530, 540].map(change))};
    });
    expect(steps.near > 0 && steps.seam < 2 * steps.near, `a seam: ${JSON.stringify(steps)}`);
  });
});

await suite.test('JPEG tiles: smaller, and their error is said on the page', async () => {
  const file = kObjects.ptm();
  const {said} = publish(file, 'jpeg-tiles', '--quality', 90);
  const {said: exact} = publish(file, 'ptm-tiles');
  const megabytes = text => Number(/: ([\d.]+) MB/.exec(text)[1]);
  const psnr = Number(/are ([\d.]+) dB/.exec(said)[1]);
  expect(megabytes(said) < megabytes(exact) && psnr > 25, said);
  return showing(path.join(folder, 'jpeg-tiles'), async page => {
    expect((await textOf(page, '#notes')).includes(`${psnr.toFixed(1)} dB`), await textOf(page, '#notes'));
    const {worst} = await sameAsConverted(page, file);
    expect(worst > 1, 'it is not exact');
    return `${psnr} dB, ${megabytes(said)} instead of ${megabytes(exact)} MB`;
  });
});

await suite.test('a lying server of tiles: the file is named, a wrong picture never shown', async () => {
  const file = kObjects.ptm();
  const {site} = publish(file, 'lies-tiles');
  const finest = /plane_0_files\/2\/1_0\.png$/;
  const html = Buffer.from('<!doctype html><title>Not here</title>');
  const lies = {
    missing: [() => ({status: 404}), /is missing/],
    'a page of its own': [() => ({type: 'text/html', bytes: html}), /a page of its own/],
    torn: [bytes => ({bytes: bytes.subarray(0, 1000)}), /bytes instead of/],
    damaged: [bytes => {
      const other = Buffer.from(bytes);
      other[other.length >> 1] ^= 1;
      return {bytes: other};
    }, /is damaged/],
    'another tile': [() => ({bytes: fs.readFileSync(path.join(site, 'plane_0_files/2/0_0.png'))}), /bytes instead of|belong there|is damaged/],
  };
  for (const [name, [lie, words]] of Object.entries(lies)) {
    await showing(site, async page => {
      await settled(page);
      await page.locator('#zoom').selectOption('1');
      await until(() => page.locator('#problem').isVisible(), `the words about a tile that is ${name}`, 10);
      const problem = await textOf(page, '#problem');
      expect(words.test(problem) && finest.test(problem.split('\n')[1]) && /Hint: /.test(problem), `${name}: ${problem}`);
    }, {allowed: [/Failed to load resource/], lie: (asked, bytes) => finest.test(asked) ? lie(bytes) : null});
  }
});

await suite.test('others read the folder: deep zoom of OpenLIME, PNG and info.json', async () => {
  const {site} = publish(kObjects.ptm(), 'others-tiles', '--mm-per-pixel', 0.5);
  const info = JSON.parse(fs.readFileSync(path.join(site, 'info.json'), 'utf8'));
  expect(info.format === 'png' && info.pixelSizeInMM === 0.5 && info.nplanes === 18, JSON.stringify(info));
  const dzi = fs.readFileSync(path.join(site, 'plane_5.dzi'), 'utf8');
  const value = name => Number(new RegExp(`${name}="(\\d+)"`).exec(dzi)[1]);
  const [width, height, side] = [value('Width'), value('Height'), value('TileSize')];
  expect(width === 1300 && height === 700 && value('Overlap') === 0, dzi);
  const levels = Math.ceil(Math.log2(Math.max(width, height) / side)) + 1;  // OpenLIME's LayoutTiles.js
  let [w, h] = [width, height];
  for (let level = levels - 1; level >= 0; --level) {
    for (let y = 0; y < Math.ceil(h / side); ++y) {
      for (let x = 0; x < Math.ceil(w / side); ++x) {
        const tile = fs.readFileSync(path.join(site, `plane_5_files/${level}/${x}_${y}.png`));
        expect(tile.readUInt32BE(16) === Math.min(side, w - x * side) && tile.readUInt32BE(20) === Math.min(side, h - y * side),
               `level ${level}, tile ${x}, ${y}`);
      }
    }
    [w, h] = [Math.ceil(w / 2), Math.ceil(h / 2)];
  }
  expect(!fs.existsSync(path.join(site, `plane_5_files/${levels}`)), 'no level more');
});

await suite.test('the page of tiles: names, roles, contrast, and a phone', async () => {
  const {site} = publish(kObjects.ptm(), 'rules-tiles', '--mm-per-pixel', 0.02, '--title', 'Waves',
                         '--description', 'A wavy surface', '--author', 'Lab', '--licence', 'CC0');
  await showing(site, async page => {
    for (const theme of ['dark', 'light']) {
      await page.evaluate(name => (document.documentElement.dataset.theme = name), theme);
      const problems = [...await namesAndRoles(page), ...await contrast(page)];
      expect(problems.length === 0, `${theme}: ${problems.join('; ')}`);
    }
    await page.screenshot({path: path.join(folder, 'tiles.png')});
  });
  await showing(site, async page => {
    const problems = await fitsThePhone(page);
    expect(problems.length === 0, problems.join('; '));
  });
});

// ---- captures -------------------------------------------------------------------------------

/** A session of 8 lights: pictures of a made surface, imported. */
function eightLights() {
  const place = path.join(folder, 'eight');
  const session = path.join(folder, 'eight.session');
  if (!fs.existsSync(session)) {
    fs.mkdirSync(place);
    const surface = writeWaves(path.join(folder, 'eight.ptm'), 200, 150);
    const lines = ['8'];
    for (let k = 0; k < 8; ++k) {
      const [up, turn] = [0.6 + 0.1 * (k % 3), 2.399963 * k];
      const light = [Math.cos(up) * Math.cos(turn), Math.cos(up) * Math.sin(turn), Math.sin(up)].map(v => v.toFixed(6));
      convert(surface, path.join(place, `light${k}.png`), '--light', light.join(','));
      lines.push(`light${k}.png ${light.join(' ')}`);
    }
    fs.writeFileSync(path.join(place, 'dirs.lp'), `${lines.join('\n')}\n`);
    execFileSync(haarlight, ['import', place, '--lights', path.join(place, 'dirs.lp'), '-o', session, '--quiet']);
  }
  return session;
}

const kButterfly = path.join(source, '../shared/data/rti_real/butterfly_8led');
const kSets = {'a made set of 8 lights': eightLights};
if (fs.existsSync(kButterfly)) {
  kSets['the butterfly under 8 lights'] = () => {
    const session = path.join(folder, 'butterfly.session');
    const list = path.join(folder, 'butterfly.lp');  // the set tells no directions: a ring stands in
    fs.writeFileSync(list, `8\n${[...Array(8).keys()].map(k =>
      `image${k}.png ${Math.cos(k * Math.PI / 4) * Math.SQRT1_2} ${Math.sin(k * Math.PI / 4) * Math.SQRT1_2} ${Math.SQRT1_2}\n`).join('')}`);
    execFileSync(haarlight, ['import', kButterfly, '--lights', list, '-o', session, '--quiet']);
    return session;
  };
} else {
  console.log('note: no ../shared/data/rti_real here: a made set of 8 lights alone');
}
for (const [name, make] of Object.entries(kSets)) {
  await suite.test(`${name}: compressed and published, the command's pictures`, async () => {
    const file = path.join(folder, 'set.hlb');
    execFileSync(haarlight, ['compress', make(), '-o', file, '--basis', 'direct', '--plate', 'none', '--force', '--quiet']);
    const {site, said} = publish(file, 'set-site');
    return showing(site, async page => {
      for (const lights of [{3: 1}, {0: 1, 7: 0.5}]) {
        await setLights(page, lights);
        await sameAsRelit(page, file, Object.entries(lights).flatMap(([k, weight]) => ['--light', `${k}=${weight}`]));
      }
      return said.split('\n')[0].replace(/^.*?: /, '');
    });
  });
}

await suite.test('fit leaves a page in its folder, which opens from a plain server; its readers do not see it', async () => {
  const fitted = path.join(folder, 'fitted');
  const said = execFileSync(haarlight, ['fit', eightLights(), '-o', fitted, '--basis', 'lptm'], {encoding: 'utf8'});
  expect(/fitted\/index\.html shows it from any web server/.test(said), said);
  const again = path.join(folder, 'again');
  convert(fitted, again);
  expect(!fs.existsSync(path.join(again, 'index.html')), 'convert reads the folder, not the page');
  return showing(fitted, async page => {
    await lightFrom(page, 0.3, -0.4);
    const {worst, pixels} = await sameAsConverted(page, fitted);
    expect(worst <= 2, `differs by ${worst} of 255`);
    await page.locator('#zoom').selectOption('0.5');
    await settled(page);
    return `${pixels} pixels differ by at most ${worst} of 255 from the command's`;
  }, {at: '/fits/eight/'});
});

await suite.test('a fit whose page is of another fit says so', async () => {
  const fitted = path.join(folder, 'fitted-other');
  execFileSync(haarlight, ['fit', eightLights(), '-o', fitted, '--basis', 'lptm', '--quiet']);
  fs.copyFileSync(path.join(fitted, 'plane_1.jpg'), path.join(fitted, 'plane_2.jpg'));
  await showing(fitted, async page => {
    await until(() => page.locator('#problem').isVisible(), 'the words');
    const problem = await textOf(page, '#problem');
    expect(/plane_2\.jpg/.test(problem) && /Hint: /.test(problem), problem);
  });
});

await suite.test('names, roles, contrast, and a phone', async () => {
  const {site} = publish(made('rules', ...kBases.haar), 'rules-site', '--environment', kRoom, '--title', 'A ball',
                         '--description', 'A ball over a plane', '--author', 'Lab', '--licence', 'CC0');
  await showing(site, async page => {
    for (const theme of ['dark', 'light']) {
      await page.evaluate(name => (document.documentElement.dataset.theme = name), theme);
      const problems = [...await namesAndRoles(page), ...await contrast(page)];
      expect(problems.length === 0, `${theme}: ${problems.join('; ')}`);
    }
    if (option('--images')) {
      await page.screenshot({path: path.join(option('--images'), 'publish-basis.png')});
    }
  });
  await showing(site, async page => {
    const problems = await fitsThePhone(page);
    expect(problems.length === 0, problems.join('; '));
  });
});

await suite.test('no console errors, no foreign requests', async () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});

await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
