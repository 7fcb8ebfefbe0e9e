// The viewer's page in a real browser against the real server; its pictures against the command's.
//   node view_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR]
// PROGRAMS: the build's folder apps/; MODULES: where playwright-core is installed; OUT: pictures.
// scripts/page_test BUILD --viewer runs it.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, Suite, expect} from './harness.mjs';
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
    const page = await browser.page(`${viewer.url}/`, options.context, options.allowed);
    await settled(page);
    return await body(page, viewer);
  } finally {
    expect(await viewer.end() === 0, 'haarlight view ends well');
  }
}

/** Sets drives {light: drive} of one colour, and K. */
const setLights = (page, lights, terms = null) => page.evaluate(async ([given, k]) => {
  const view = window.haarlightView;
  const drives = new Float64Array(view.basis.nLights);
  Object.entries(given).forEach(([light, drive]) => (drives[light] = drive));
  view.engine.terms = k ?? Infinity;
  view.engine.setDrives([drives]);
  await view.engine.settled();
}, [lights, terms]);

/** The canvas against `haarlight relight` under the same lights. */
async function same(page, file, lights, terms = null) {
  await setLights(page, lights, terms);
  const words = Object.entries(lights).map(([light, drive]) => ['--light', `${light}=${drive}`]).flat();
  const truth = relight(haarlight, file, terms === null ? words : [...words, '--terms', String(terms)], folder);
  const {worst, share} = await compareWithPng(page, truth.url);
  expect(worst <= 1, `${path.basename(file)}, lights ${Object.keys(lights)}, ${terms ?? 'all'} terms: ` +
    `differs by ${worst} of 255 from the command's picture`);
  return share;
}

await suite.test('one light is the picture of haarlight relight', async () =>
  viewing(made('haar', '--rig', kSmall8, '--width', 90, '--height', 70, '--plate'), async (page, viewer) => {
    const share = await same(page, viewer.file, {27: 1});
    return `${(100 * share).toFixed(2)} % of the values differ, by one`;
  }));

await suite.test('no console errors, no foreign requests', () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});
await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
