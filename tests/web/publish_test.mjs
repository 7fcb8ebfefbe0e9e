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
  const drives = new Float64Array(view.basis.nLights);
  Object.entries(given).forEach(([light, drive]) => (drives[light] = drive));
  view.engine.terms = k ?? Infinity;
  view.engine.setDrives([drives]);
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
  import: ['--grid', 8, '--width', 50, '--height', 40, '--channels', 3],
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
  const {site, said} = publish(file, 'cut-site', '--terms', 40, '--title', 'Cut');
  const error = Number(/at most (\S+) \(/.exec(said)[1]);
  expect(/40 of 64 terms/.test(said) && error > 0.01 && error < 1, said);
  return showing(site, async page => {
    await setLights(page, {27: 1});
    const facts = await until(async () => /^.*error at most.*$/m.exec(await textOf(page, '#picture-facts'))?.[0], 'the bound');
    const bound = Number(/error at most (\S+) %/.exec(facts)?.[1]) / 100;
    expect(bound > error, `one light may be worse than all together: ${facts}`);
    expect(await page.evaluate(() => window.haarlightView.basis.isComplete), 'all that is published is loaded');
    expect(/40 of 64 terms are published/.test(await textOf(page, '#loading')), await textOf(page, '#loading'));
    expect(/Error\s+at most/.test(await textOf(page, '#notes')), await textOf(page, '#notes'));
    // The linear picture, before exposure, against the command's floats of the whole file.
    const {worst} = await compareWithPng(page, relight(haarlight, file, ['--light', '27'], folder).url);
    expect(worst > 1, 'something is missing in it');
    return `bound of one light ${bound}, of all ${error}; the 8-bit picture differs by ${worst}`;
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

await suite.test('a lying server: each missing, torn or foreign file is named with a cure', async () => {
  const {site} = publish(made('lies', ...kBases.haar), 'lies-site');
  const html = Buffer.from('<!doctype html><title>Not here</title>');
  const lies = {
    'missing': [/about\.json$/, () => ({status: 404}), /is missing/],
    'missing data': [/pages\/0\/.*bin$/, () => ({status: 404, type: 'text/html', bytes: html}), /is missing/],
    'status 503': [/gains.*bin$/, () => ({status: 503, bytes: html}), /status 503/],
    'a page of its own': [/tables\.bin$/, () => ({type: 'text/html', bytes: html}), /a page of its own/],
    'torn': [/pages\/0\/.*bin$/, bytes => ({bytes: bytes.subarray(0, bytes.length / 2)}), /belong there/],
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
      expect(words.test(problem) && /Cure: copy the published folder/.test(problem) && pattern.test(problem.split('\n')[1]),
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

//OBJECTS

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
