// The viewer's page in a real browser against the real server; its pictures against the command's.
//   node view_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR]
// PROGRAMS: the build's folder apps/; MODULES: where playwright-core is installed; OUT: pictures.
// scripts/page_test BUILD --viewer runs it.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, Suite, expect, until} from './harness.mjs';
import {contrast, fitsThePhone, namesAndRoles, tabOrder} from './page_rules.mjs';
import {Viewer, compareWithPng, relight, settled} from './view_harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const option = name => {
  const i = process.argv.indexOf(name);
  return i < 0 ? '' : process.argv[i + 1];
};
const source = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const haarlight = path.join(programs, 'haarlight/haarlight');
const folder = path.join(out, 'view');
fs.mkdirSync(folder, {recursive: true});

const kSmall8 = path.join(source, 'configs/rigs/small8.toml');

/** That rig with a face of other rows and columns. */
function rigOf(rows, cols) {
  const file = path.join(folder, `rig-${rows}x${cols}.toml`);
  const text = fs.readFileSync(kSmall8, 'utf8').replace(/^rows = .*/m, `rows = ${rows}`)
    .replace(/^cols = .*/m, `cols = ${cols}`).replace(/^pitch = .*/m, 'pitch = 30.0')
    .replace(/^emitter = .*/m, 'emitter = [28.0, 28.0]').replace(/^max_watts = .*/m, 'max_watts = 9000.0');
  fs.writeFileSync(file, text);
  return file;
}

/** A basis file of the made scene. */
function made(name, ...words) {
  const file = path.join(folder, `${name}.hlb`);
  execFileSync(path.join(programs, '../tests/web/made_basis'), [file, ...words.map(String)]);
  return file;
}

const browser = await new Browser().begin(modules);
const suite = new Suite(browser, option('--only'));

/** Runs `body(page, viewer)` on a fresh server and page. */
async function viewing(file, body, options = {}) {
  const viewer = await new Viewer(programs).begin(file, options.words);
  try {
    const at = options.sums ? `/viewer/index.html?sums=${options.sums}` : '/';
    const page = await browser.page(`${viewer.url}${at}`, options.context, options.allowed);
    if (options.isRefused) {
      await page.locator('#problem:visible').waitFor();
    } else {
      await settled(page);
    }
    return await body(page, viewer);
  } finally {
    await browser.closePages();
    await viewer.end();
    if (viewer.process.exitCode !== 0) {
      throw new Error(`haarlight view ended with ${viewer.process.exitCode}`);
    }
  }
}

/** Sets weights {light: weight} of one colour, and K. */
const setLights = (page, lights, terms = null) => page.evaluate(async ([given, k]) => {
  const view = window.haarlightView;
  const weights = new Float64Array(view.basis.nLights);
  Object.entries(given).forEach(([light, weight]) => (weights[light] = weight));
  view.engine.terms = k ?? Infinity;
  view.engine.setWeights([weights]);
  await view.engine.settled();
}, [lights, terms]);

/** The canvas against `haarlight relight` under the same lights. */
async function same(page, file, lights, terms = null) {
  await setLights(page, lights, terms);
  const words = Object.entries(lights).map(([light, weight]) => ['--light', `${light}=${weight}`]).flat();
  const truth = relight(haarlight, file, terms === null ? words : [...words, '--terms', String(terms)], folder);
  const {worst, share} = await compareWithPng(page, truth.url);
  expect(worst <= 1, `${path.basename(file)}, lights ${Object.keys(lights)}, ${terms ?? 'all'} terms: ` +
    `differs by ${worst} of 255 from the command's picture`);
  return share;
}

const nine = {9: 1, 12: 0.5, 14: 1, 33: 1, 36: 2, 38: 1, 57: 0.25, 60: 1, 62: 1};
const textOf = (page, selector) => page.locator(selector).innerText();
const nearTo = (a, b, relative) => Math.abs(a - b) <= relative * Math.max(Math.abs(a), Math.abs(b));

/** The lights that burn. */
const lit = page => page.evaluate(() => {
  const {columns} = window.haarlightView;
  return [...columns[0].keys()].filter(k => columns.some(column => column[k] !== 0));
});

/** The pointer pressed over cells of the first map. */
async function drag(page, cells, cols = 8, rows = cols) {
  const canvas = page.locator('.face canvas');
  await canvas.scrollIntoViewIfNeeded();
  const box = await canvas.boundingBox();
  const at = ([row, col]) => [box.x + (col + 0.5) / cols * box.width, box.y + (row + 0.5) / rows * box.height];
  await page.mouse.move(...at(cells[0]));
  await page.mouse.down();
  for (const cell of cells.slice(1)) {
    await page.mouse.move(...at(cell), {steps: 4});
  }
  await page.mouse.up();
}

// ---- the same numbers as the command --------------------------------------------------------

const kFiles = {
  haar: ['--rig', kSmall8, '--width', 90, '--height', 70, '--plate'],
  shifts: ['--rig', kSmall8, '--width', 90, '--height', 70, '--worst-pixel', 0.02],
  colour: ['--rig', kSmall8, '--width', 50, '--height', 66, '--channels', 3, '--plate'],
  digits: ['--rig', kSmall8, '--width', 40, '--height', 40, '--max-error', 0.000001, '--plate'],
  direct: ['--grid', 8, '--width', 64, '--height', 32, '--basis', 'direct'],
  lossless: ['--grid', 8, '--width', 64, '--height', 70, '--basis', 'direct', '--max-error', 0],
  dct: ['--rig', kSmall8, '--width', 90, '--height', 70, '--plate', '--basis', 'dct'],
  'dct-13x5': ['--rig', rigOf(13, 5), '--width', 50, '--height', 66, '--channels', 3, '--basis', 'dct'],
  'lossless-dct': ['--rig', kSmall8, '--width', 33, '--height', 31, '--channels', 3, '--max-error', 0, '--basis', 'dct'],
  'haar-standard': ['--rig', kSmall8, '--width', 50, '--height', 66, '--channels', 3, '--plate', '--basis', 'haar-standard'],
  'lossless-haar-standard': ['--rig', kSmall8, '--width', 33, '--height', 31, '--max-error', 0, '--basis', 'haar-standard'],
  'lossless-haar': ['--rig', kSmall8, '--width', 33, '--height', 31, '--channels', 3, '--max-error', 0],
  tiles: ['--grid', 8, '--width', 70, '--height', 53, '--channels', 3, '--tile', 30],
  import: ['--grid', 8, '--width', 50, '--height', 40, '--channels', 3],
  '17x30': ['--rig', rigOf(17, 30), '--width', 40, '--height', 36, '--plate'],
  '13x5': ['--rig', rigOf(13, 5), '--width', 50, '--height', 66, '--channels', 3],
  'lossless-9x11': ['--rig', rigOf(9, 11), '--width', 33, '--height', 31, '--channels', 3, '--max-error', 0],
};
const kSums = ['processor', 'graphics'];
for (const [name, words] of Object.entries(kFiles)) {
  for (const sums of kSums) {
    await suite.test(`${name}, summed by ${sums}: one light, nine lights, few terms are the command's pictures`, async () =>
      viewing(made(name, ...words), async (page, viewer) => {
        let share = 0;
        const last = await page.evaluate(() => window.haarlightView.basis.nLights - 1);
        for (const [lights, terms] of [[{27: 1}, null], [{[last]: 1}, null], [nine, null], [nine, 0], [nine, 1], [nine, 9],
                                       [{63: 3}, 4], [{28: 1, [last]: 2}, 7]]) {
          if (terms === 0 && !words.includes('--plate')) {
            continue;  // nothing but the plate would be left
          }
          share = Math.max(share, await same(page, viewer.file, lights, terms));
        }
        return `at most ${(100 * share).toFixed(3)} % of the values differ, by one`;
      }, {sums}));
  }
}

await suite.test('the processor sums where there is no graphics processor, or who the address says', async () => {
  const file = made('haar', ...kFiles.haar);
  const isOnProcessor = sums => viewing(file, page =>
    page.evaluate(() => window.haarlightView.renderer.isOnProcessor), {sums});
  expect(await isOnProcessor(), 'this browser has software GL');
  expect(await isOnProcessor('processor'), 'the address says processor');
  expect(!await isOnProcessor('graphics'), 'the address says graphics');
});

await suite.test('terms and the bound are the command\'s', async () =>
  viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
    for (const terms of [3, 20, null]) {
      await setLights(page, nine, terms);
      const words = Object.entries(nine).map(([light, weight]) => ['--light', `${light}=${weight}`]).flat();
      const {report} = relight(haarlight, viewer.file, terms === null ? words : [...words, '--terms', `${terms}`], folder);
      const status = await page.evaluate(() => window.haarlightView.engine.status());
      expect(status.terms === report.reached.terms, `${status.terms} terms, the command says ${report.reached.terms}`);
      expect(nearTo(status.bound, report.reached.relative_l2_bound, 1e-5),
             `bound ${status.bound}, the command says ${report.reached.relative_l2_bound}`);
      expect(nearTo(status.exposure, report.details.exposure, 1e-5),
             `exposure ${status.exposure}, the command says ${report.details.exposure}`);
    }
    const [shown, moved] = await page.evaluate(() => {
      const {engine, basis} = window.haarlightView;
      const before = engine.status();
      engine.setWeights([new Float64Array(basis.nLights)]);
      return [before, engine.status()];
    });
    expect(JSON.stringify(moved) === JSON.stringify(shown),
           `until the next frame the old picture is shown: ${JSON.stringify(shown)}, told is ${JSON.stringify(moved)}`);
  }));

await suite.test('coloured weights on a file of one channel', async () =>
  viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
    const weights = Array.from({length: 64}, (_, k) => [k % 5 === 0 ? 1 : 0, k % 7 === 0 ? 0.7 : 0.1, k / 64]);
    fs.writeFileSync(path.join(folder, 'weights.json'), JSON.stringify(weights));
    await page.evaluate(async rows => {
      const {engine} = window.haarlightView;
      engine.setWeights([0, 1, 2].map(c => Float64Array.from(rows, row => row[c])));
      await engine.settled();
    }, weights);
    const truth = relight(haarlight, viewer.file, ['--weights', path.join(folder, 'weights.json')], folder);
    const {worst} = await compareWithPng(page, truth.url);
    expect(worst <= 1, `differs by ${worst}`);
  }));

for (const sums of kSums) {
  await suite.test(`fewer terms at a movement, all of them after it, summed by ${sums}`, async () =>
    viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
      const quick = await page.evaluate(async () => {
        const {engine, basis} = window.haarlightView;
        engine.nsPerTexel.value = 1e6;  // a very slow processor
        engine.nsPerTexel.last = [1e6];
        engine.terms = Infinity;
        engine.termsDrawn = [];
        engine.setWeights([Float64Array.from({length: basis.nLights}, (_, k) => 1 + k % 3)]);
        await new Promise(requestAnimationFrame);
        await new Promise(requestAnimationFrame);
        const status = engine.status();
        await engine.settled();
        return {status, drawn: engine.termsDrawn, after: engine.status()};
      });
      expect(quick.drawn[0] < quick.after.termsAll, `${quick.drawn[0]} terms at once`);
      expect(quick.after.isWhole && quick.after.terms === quick.after.termsAll, 'all terms after it');
      fs.writeFileSync(path.join(folder, 'weights.json'), JSON.stringify(Array.from({length: 64}, (_, k) => 1 + k % 3)));
      const {worst} = await compareWithPng(
        page, relight(haarlight, viewer.file, ['--weights', path.join(folder, 'weights.json')], folder).url);
      expect(worst <= 1, `the slices differ from the command's picture by ${worst}`);
    }, {sums}));
}

// ---- environments ---------------------------------------------------------------------------

const kRoom = path.join(source, 'configs/environments/room.hdr');

await suite.test('an environment, and turned', async () =>
  viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
    await page.locator('#environment-file').setInputFiles(kRoom);
    const settle = async degrees => {
      await until(() => page.evaluate(wanted => {
        const {environment} = window.haarlightView;
        return environment?.isExact && environment.degrees === wanted;
      }, degrees), `exact weights at ${degrees} degrees`);
      await settled(page);
    };
    for (const degrees of [0, 75, -130]) {
      if (degrees !== 0) {
        await page.locator('#turn').fill(String(degrees));
      }
      await settle(degrees);
      const truth = relight(haarlight, viewer.file, ['--cubemap', kRoom, '--rotate', `${degrees}`], folder);
      const {worst} = await compareWithPng(page, truth.url);
      expect(worst <= 1, `turned by ${degrees} degrees it differs by ${worst}`);
    }
    expect(/comes from where the rig has no lights/.test(await textOf(page, '#environment-message')), 'the missing fraction is stated');
    await until(async () => /--cubemap room\.hdr --rotate -130 /.test(await page.locator('#command').textContent()), 'the command');
  }));

await suite.test('between the angles asked ahead an environment turns evenly', async () =>
  viewing(made('haar', ...kFiles.haar), async page => {
    await page.locator('#environment-file').setInputFiles(kRoom);
    await until(() => page.evaluate(() => window.haarlightView.environment?.turntable.isFull), 'weights of every angle', 60);
    const worst = await page.evaluate(async () => {
      const {id, turntable} = window.haarlightView.environment;
      const ask = async (degrees, quality) => {
        for (;;) {
          const answer = await fetch(`/v1/environments/${id}/weights?rotate=${degrees}&quality=${quality}`);
          const {is_ready, weights} = await answer.json();
          if (is_ready) {
            return weights.flat();
          }
          await new Promise(resolve => setTimeout(resolve, 30));
        }
      };
      const size = values => Math.sqrt(values.reduce((sum, v) => sum + v * v, 0));
      const far = (a, b) => size(a.map((w, k) => w - b[k])) / size(a);
      let [between, reduced] = [0, 0];
      for (const degrees of [-179.9, -77.3, -1, 0, 0.7, 1.40625, 45, 123.4, 180]) {
        const quick = await ask(degrees, 'quick');
        between = Math.max(between, far(quick, turntable.at(degrees).weights.flatMap(column => [...column])));
        reduced = Math.max(reduced, far(await ask(degrees, 'exact'), quick));
      }
      return {between, reduced};
    });
    // Between two angles per texel's border passes through a cell at a speed that is not quite even.
    expect(worst.between < 0.3 * worst.reduced, `relative L2 ${worst.between} beside ${worst.reduced}`);
    return `relative L2 at most ${worst.between.toFixed(4)}, of the reduced picture ${worst.reduced.toFixed(4)}`;
  }));

await suite.test('what a user paints is not taken back by an environment, and shows on it', async () =>
  viewing(made('haar', ...kFiles.haar), async page => {
    let open = () => {};
    const gate = new Promise(resolve => (open = resolve));
    let [n, slow] = [0, true];
    await page.route(/quality=exact/, async route => {
      ++n;
      if (slow) {
        await gate;
      }
      await route.continue();
    });
    await page.locator('#environment-file').setInputFiles(kRoom);
    await until(() => n > 0, 'the question for exact weights');
    await page.locator('#clear').click();
    open();
    slow = false;
    await page.waitForTimeout(500);
    expect((await lit(page)).length === 0, 'late weights are not shown');
    await page.locator('#turn').fill('5');
    await until(() => page.evaluate(() => window.haarlightView.environment.isExact), 'the environment');
    const at = await page.evaluate(() => {
      const column = window.haarlightView.columns[0];
      return {least: column.indexOf(Math.min(...column)), most: Math.max(...column)};
    });
    await page.locator('#mode-paint').click();
    await page.locator('#strength').fill('1');
    for (let stroke = 0; stroke < 2; ++stroke) {
      const cell = [Math.floor(at.least / 8), at.least % 8];
      await drag(page, [cell, cell]);
    }
    const weight = await page.evaluate(k => window.haarlightView.columns[0][k], at.least);
    expect(nearTo(weight, at.most, 1e-9), `painted ${weight} on an environment whose brightest light gives ${at.most}`);
  }));

await suite.test('a broken environment says what, where and what to do', async () =>
  viewing(made('haar', ...kFiles.haar), async page => {
    const broken = path.join(folder, 'broken.hdr');
    fs.writeFileSync(broken, '#?RADIANCE\nnot a picture');
    await page.locator('#environment-file').setInputFiles(broken);
    await until(async () => /Hint: /.test(await textOf(page, '#environment-message')), 'what to do');
    expect(/broken\.hdr/.test(await textOf(page, '#environment-message')), 'the file is named');
  }, {allowed: [/status of 400/]}));

// ---- what a user does -----------------------------------------------------------------------

await suite.test('a light follows the pointer and the arrow keys', async () =>
  viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
    await drag(page, [[1, 1], [5, 6]]);
    expect(String(await lit(page)) === '46', `light ${await lit(page)} burns, not 46`);
    await settled(page);
    const {worst} = await compareWithPng(page, relight(haarlight, viewer.file, ['--light', '46'], folder).url);
    expect(worst <= 1, `differs by ${worst}`);
    await page.keyboard.press('ArrowUp');
    await page.keyboard.press('ArrowLeft');
    expect(String(await lit(page)) === '37', `light ${await lit(page)} burns, not 37`);
    expect(/light 37, row 4, column 5: weight 1/.test(await textOf(page, '#map-readout')), 'it is shown');
    await page.keyboard.press('End');
    expect(String(await lit(page)) === '63', 'End is the last light');
    await page.keyboard.press('ArrowDown');
    expect(String(await lit(page)) === '63', 'the cursor stays on the face');
    await settled(page);
    await until(async () => /haarlight relight haar\.hlb --light 63 --exposure [\d.e-]+ -o picture\.png/
      .test(await page.locator('#command').textContent()), 'the command');
  }));

await suite.test('paint, erase, colours, all dark', async () =>
  viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
    await page.locator('#clear').click();
    expect((await lit(page)).length === 0, 'all dark');
    await page.locator('#mode-paint').click();
    await page.locator('#brush').fill('1.5');
    await page.locator('#strength').fill('1');
    await page.locator('#colour').fill('#ff8000');
    await drag(page, [[2, 2], [2, 5]]);
    const painted = await lit(page);
    expect([18, 19, 20, 21].every(k => painted.includes(k)) && !painted.includes(63), `painted ${painted}`);
    await settled(page);
    const download = page.waitForEvent('download');
    await page.locator('#save-weights').click();
    await (await download).saveAs(path.join(folder, 'weights.json'));
    const {worst} = await compareWithPng(
      page, relight(haarlight, viewer.file, ['--weights', path.join(folder, 'weights.json')], folder).url);
    expect(worst <= 1, `painted light differs by ${worst}`);
    await page.locator('#mode-erase').focus();
    await page.keyboard.press('ArrowLeft');
    expect(await page.locator('#mode-paint').getAttribute('aria-checked') === 'true', 'arrows choose');
    await page.locator('#mode-erase').click();
    await drag(page, [[2, 2], [2, 5]]);
    const left = await lit(page);
    expect([18, 19, 20, 21].every(k => !left.includes(k)), `left ${left}`);
  }));

await suite.test('rows and columns of any number are painted where they stand', async () =>
  viewing(made('17x30', ...kFiles['17x30']), async (page, viewer) => {
    const shape = await page.locator('.face canvas').boundingBox();
    expect(Math.abs(shape.width / shape.height - 30 / 17) < 0.02, `a face ${shape.width} x ${shape.height}`);
    await drag(page, [[1, 1], [14, 27]], 30, 17);
    expect(String(await lit(page)) === String(14 * 30 + 27), `light ${await lit(page)} burns, not ${14 * 30 + 27}`);
    await page.keyboard.press('ArrowUp');
    expect(/light 417, row 13, column 27: weight 1/.test(await textOf(page, '#map-readout')),
      await textOf(page, '#map-readout'));
    await page.keyboard.press('End');
    expect(String(await lit(page)) === '509', 'End is the last light');
    await page.locator('#clear').click();
    await page.locator('#mode-paint').click();
    await page.locator('#brush').fill('1');
    await page.locator('#strength').fill('1');
    await drag(page, Array.from({length: 27}, (_, i) => [16, 3 + i]), 30, 17);
    const painted = await lit(page);
    const row = Array.from({length: 27}, (_, i) => 16 * 30 + 3 + i);
    expect(row.every(k => painted.includes(k)) && painted.every(k => k >= 14 * 30), `painted ${painted}`);
    await settled(page);
    const download = page.waitForEvent('download');
    await page.locator('#save-weights').click();
    const weights = path.join(folder, 'weights-17x30.json');
    await (await download).saveAs(weights);
    const {worst} = await compareWithPng(page, relight(haarlight, viewer.file, ['--weights', weights], folder).url);
    expect(worst <= 1, `painted light differs by ${worst}`);
  }));

await suite.test('exposure, hold, and Save PNG', async () =>
  viewing(made('colour', ...kFiles.colour), async (page, viewer) => {
    await drag(page, [[3, 3], [3, 4]]);
    await settled(page);
    await page.locator('#stops').fill('-1.5');
    await settled(page);
    const exposure = await page.evaluate(() => window.haarlightView.engine.exposure);
    const words = ['--light', '28', '--exposure', String(exposure)];
    expect((await compareWithPng(page, relight(haarlight, viewer.file, words, folder).url)).worst <= 1, 'the exposure');
    await page.locator('#hold').check();
    await drag(page, [[6, 6], [7, 7]]);
    await settled(page);
    expect(await page.evaluate(() => window.haarlightView.engine.exposure) === exposure, 'it is held');
    const download = page.waitForEvent('download');
    await page.locator('#save').click();
    const saved = path.join(folder, 'saved.png');
    expect((await download).suggestedFilename() === 'colour.png', 'its name');
    await (await download).saveAs(saved);
    const {worst} = await compareWithPng(page, `data:image/png;base64,${fs.readFileSync(saved).toString('base64')}`);
    expect(worst === 0, 'the file is what the canvas shows');
  }));

await suite.test('few terms beside all of them, and their difference', async () =>
  viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
    await setLights(page, nine, 9);
    await page.locator('#compare').check();
    await settled(page);
    const read = () => page.evaluate(() => {
      const {width, height, data} = window.haarlightView.renderer.pixels();
      return {width, height, data: Array.from(data)};
    });
    const panels = await read();
    expect(panels.width === 270 && panels.height === 70, `the canvas is ${panels.width} x ${panels.height}`);
    const amplify = 8;
    let [worst, apart] = [0, 0];
    for (let y = 0; y < 70; ++y) {
      for (let x = 0; x < 90; ++x) {
        const [a, b, d] = [0, 90, 180].map(left => panels.data[4 * (y * 270 + left + x)]);
        const expected = Math.min(255, Math.max(0, 127.5 + amplify * (a - b)));
        worst = Math.max(worst, Math.abs(d - expected));
        apart += a !== b ? 1 : 0;
      }
    }
    // a and b are rounded to 1/2 each before they are subtracted here, not there.
    expect(worst <= amplify + 1, `the difference is off by ${worst}`);
    expect(apart > 100, 'nine terms are not all of them');
    await page.locator('#compare').uncheck();
    await settled(page);
    const words = Object.entries(nine).map(([light, weight]) => ['--light', `${light}=${weight}`]).flat();
    const truth = relight(haarlight, viewer.file, [...words, '--terms', '9'], folder);
    expect((await compareWithPng(page, truth.url)).worst <= 1, 'one picture again');
  }));

await suite.test('the slider of terms goes from none to all', async () =>
  viewing(made('haar', ...kFiles.haar), async page => {
    await setLights(page, nine);
    const seen = [];
    for (const place of ['0', '1', '50', '99', '100']) {
      await page.locator('#terms').fill(place);
      await settled(page);
      seen.push(await page.evaluate(() => window.haarlightView.engine.status().terms));
    }
    const all = await page.evaluate(() => window.haarlightView.engine.status().termsAll);
    expect(seen[0] === 0 && seen[1] === 1 && seen[2] > 1 && seen[2] < seen[3] && seen[4] === all, `terms ${seen}`);
    await until(async () => /error at most/.test(await textOf(page, '#picture-facts')), 'the bound in words');
  }));

// ---- what is not there ----------------------------------------------------------------------

await suite.test('the first picture does not wait for the finest coefficients', async () => {
  const file = made('haar32', '--rig', path.join(source, 'configs/rigs/cube32.toml'), '--width', 64, '--height', 64, '--plate');
  const viewer = await new Viewer(programs).begin(file);
  try {
    let open = () => {};
    const gate = new Promise(resolve => (open = resolve));
    const page = await browser.page(`${viewer.url}/`, {}, [], fresh => fresh.route(/\/pages\/0\/[12]\//, async route => {
      await gate;
      await route.continue();
    }));
    await until(() => page.evaluate(() => window.haarlightView?.engine?.status().isWhole &&
      window.haarlightView.basis.isLoaded[0].filter(Boolean).length === 1), 'a picture of the first group');
    const early = await page.evaluate(() => window.haarlightView.engine.status());
    expect(early.bound > 0, 'what is missing is in the bound');
    // Words are told five times a second.
    await until(async () => /loading/.test(await textOf(page, '#loading')), 'the word that something is missing');
    open();
    await settled(page);
    const whole = await page.evaluate(() => window.haarlightView.engine.status());
    expect(whole.bound < early.bound, `the bound shrinks: ${early.bound}, then ${whole.bound}`);
  } finally {
    await viewer.end();
  }
});

await suite.test('a light is set while the server has not said yet whether there is a shadow on a receiver', async () => {
  const viewer = await new Viewer(programs).begin(made('haar', ...kFiles.haar));
  try {
    let answer = () => {};
    const gate = new Promise(resolve => (answer = resolve));
    const page = await browser.page(`${viewer.url}/`, {}, [], fresh => fresh.route(/\/v1\/hull$/, async route => {
      await gate;
      await route.continue();
    }));
    // Its card may be closed: what it holds, not what is seen of it.
    await until(() => page.evaluate(() => /--light/.test(document.querySelector('#command')?.textContent)),
      'the command with its light');
    answer();
    await settled(page);
  } finally {
    await viewer.end();
  }
});

await suite.test('a browser without WebGL 2 is told so', async () => {
  const viewer = await new Viewer(programs).begin(made('haar', ...kFiles.haar));
  try {
    const page = await browser.page(`${viewer.url}/`, {}, [], fresh => fresh.addInitScript(() => {
      HTMLCanvasElement.prototype.getContext = () => null;
    }));
    await until(async () => /WebGL 2[^]*Hint: /.test(await textOf(page, '#problem')), 'the message');
  } finally {
    await viewer.end();
  }
});

await suite.test('a lost graphics processor and a server that is gone are told', async () =>
  viewing(made('haar', ...kFiles.haar), async (page, viewer) => {
    await viewer.end();
    await page.locator('#environment-file').setInputFiles(kRoom);
    await until(async () => /does not answer[^]*Hint: /.test(await textOf(page, '#environment-message')), 'the message');
    await drag(page, [[3, 3], [4, 4]]);
    await settled(page);
    expect(String(await lit(page)) === '36', 'what is loaded still relights');
    await page.evaluate(() => window.haarlightView.renderer.gl.getExtension('WEBGL_lose_context').loseContext());
    await until(async () => /graphics processor has dropped[^]*Hint: /.test(await textOf(page, '#problem')), 'the message');
  }, {allowed: [/ERR_CONNECTION_REFUSED/]}));

await suite.test('a file too large for the page is shown in part, or refused when it is lossless', async () => {
  const cube = path.join(source, 'configs/rigs/cube32.toml');
  await viewing(made('large', '--rig', cube, '--width', 128, '--height', 96, '--noise', 0.1, '--plate'), async page => {
    expect(/The most important \d+ of 1024 pictures fill/.test(await textOf(page, '#loading')), await textOf(page, '#loading'));
    const status = await page.evaluate(() => window.haarlightView.engine.status());
    expect(status.isWhole && status.bound > 0.01, 'a picture with its bound');
  }, {words: ['--memory', '40M']});
  await viewing(made('large-lossless', '--rig', cube, '--width', 128, '--height', 96, '--max-error', 0), async page => {
    expect(/lossless file needs 25 MB[^]*Hint: compress/.test(await textOf(page, '#problem')), await textOf(page, '#problem'));
  }, {words: ['--memory', '40M'], isRefused: true});
});

// ---- everybody ------------------------------------------------------------------------------

await suite.test('names, roles, contrast, focus', async () =>
  viewing(made('import', ...kFiles.import), async page => {
    for (const theme of ['dark', 'light']) {
      await page.evaluate(name => (document.documentElement.dataset.theme = name), theme);
      const problems = [...await namesAndRoles(page), ...await contrast(page)];
      expect(problems.length === 0, `${theme}: ${problems.join('; ')}`);
    }
    const {reached, problems} = await tabOrder(page);
    expect(problems.length === 0, problems.join('; '));
    for (const id of ['terms', 'stops', 'hold', 'compare', 'save', 'mode-move', 'grid', 'clear', 'environment-file']) {
      expect(reached.includes(id), `Tab does not reach ${id}: ${reached}`);
    }
  }));

await suite.test('fits a phone', async () =>
  viewing(made('haar', ...kFiles.haar), async page => {
    const check = async () => {
      const problems = await fitsThePhone(page);
      expect(problems.length === 0, problems.join('; '));
    };
    await check();
    await page.locator('#compare').check();
    await settled(page);
    await check();
    const size = await page.evaluate(() => window.haarlightView.renderer.pixels().height);
    expect(size === 210, 'pictures to compare stand below one another');
  }, {context: {viewport: {width: 360, height: 740}, isMobile: true, hasTouch: true}}));

if (option('--images')) {
  await suite.test('pictures for the documents', async () => {
    const to = path.resolve(option('--images'));
    const demo = option('--demo') || path.join(source, 'out/demo/biplane.hlb');
    expect(fs.existsSync(demo), `no ${demo}: run ./demo first, or name a capture with --demo`);
    await viewing(demo, async page => {
      const shoot = async name => {
        await settled(page);
        await until(async () => /error at most/.test(await textOf(page, '#picture-facts')), 'the words');
        const file = path.join(to, `${name}.png`);
        await page.screenshot({path: file});
        expect(fs.statSync(file).size < 400_000, `${name} is too large for the documents`);
      };
      await page.locator('#environment-file').setInputFiles(kRoom);
      await until(() => page.evaluate(() => window.haarlightView.environment?.isExact), 'the room');
      await page.locator('#turn').fill('-20');
      await until(() => page.evaluate(() => window.haarlightView.environment.degrees === -20 &&
        window.haarlightView.environment.isExact), 'the turned room');
      await shoot('view');
      await drag(page, [[10, 25], [12, 24]], 32);
      await page.locator('#terms').fill('55');
      await page.locator('#compare').check();
      await page.setViewportSize({width: 1280, height: 560});
      await shoot('view-compare');
    }, {context: {colorScheme: 'dark', viewport: {width: 1280, height: 1040}}});
  });
}

await suite.test('no console errors, no foreign requests', () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});
await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
