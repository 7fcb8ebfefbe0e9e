// How soon published folders show a picture, and what a 45-megapixel fit costs to publish.
//   node publish_bench.mjs PROGRAMS MODULES OUT [BASIS.hlb]...
// scripts/page_test BUILD --bench-publish out/demo/biplane.hlb runs it.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import {Browser, expect} from './harness.mjs';
import {StaticServer} from './static_server.mjs';
import {compareFullPixels, writeWaves} from './tiles_harness.mjs';
import {compareWithPng, relight, settled} from './view_harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const bases = process.argv.slice(5);
const haarlight = path.join(programs, 'haarlight/haarlight');
const folder = path.join(out, 'publish-bench');
fs.rmSync(folder, {recursive: true, force: true});
fs.mkdirSync(folder, {recursive: true});

const kTimes = 7;
const middle = values => [...values].sort((a, b) => a - b)[values.length >> 1];
const told = values => `${Math.round(middle(values))} ms in the middle of ${values.length}, at most ${Math.round(Math.max(...values))}`;

function publish(file, name, ...words) {
  const site = path.join(folder, name);
  const report = path.join(folder, `${name}.json`);
  const begun = process.hrtime.bigint();
  const said = execFileSync(haarlight, ['publish', file, '-o', site, '--quiet', '--report', report, ...words], {encoding: 'utf8'});
  const {details} = JSON.parse(fs.readFileSync(report, 'utf8'));
  console.log(said.trim());
  console.log(`  ${(Number(process.hrtime.bigint() - begun) / 1e9).toFixed(1)} s` +
    (details['peak memory bytes'] ? `, ${(details['peak memory bytes'] / 1e9).toFixed(2)} GB at most` : ''));
  return site;
}

const browser = await new Browser().begin(modules);

/** From the address to the first picture, and to the last part of it. */
async function measure(site, isFirst, body) {
  const [first, whole] = [[], []];
  const server = await new StaticServer().begin(site);
  for (let i = 0; i < kTimes; ++i) {
    const begun = performance.now();
    const page = await browser.page(server.url);
    await page.waitForFunction(isFirst, null, {polling: 5});
    first.push(performance.now() - begun);
    await settled(page);
    whole.push(performance.now() - begun);
    if (i === kTimes - 1) {
      await body(page);
    }
    await browser.closePages();
  }
  await server.end();
  console.log(`  page to first picture ${told(first)}`);
  console.log(`  page to the whole view ${told(whole)}; load ${os.loadavg()[0].toFixed(1)}`);
  expect(middle(first) <= 2000, 'the first picture came later than 2 s');
}

for (const basis of bases) {
  const site = publish(basis, path.basename(basis, '.hlb'));
  await measure(site, () => {
    const {engine, basis} = window.haarlightView ?? {};
    return engine?.isShown && basis.isLoaded[0].some(Boolean) && !engine.isStale;
  }, async page => {
    const n = await page.evaluate(async () => {
      const view = window.haarlightView;
      const weights = new Float64Array(view.basis.nLights);
      weights[weights.length >> 1] = 1;
      view.engine.setWeights([weights]);
      await view.engine.settled();
      return weights.length >> 1;
    });
    const {worst} = await compareWithPng(page, relight(haarlight, basis, ['--light', String(n)], folder).url);
    console.log(`  light ${n}: at most ${worst} of 255 from the command's picture`);
    expect(worst <= 1, 'not the same picture');
    await page.screenshot({path: path.join(folder, `${path.basename(basis, '.hlb')}.png`)});
  });
}

const large = writeWaves(path.join(folder, 'large.ptm'), 9000, 5000);
const site = publish(large, 'large', '--mm-per-pixel', '0.01', '--title', '45 megapixels');
await measure(site, () => window.haarlightView?.firstAt > 0, async page => {
  await page.screenshot({path: path.join(folder, 'large-fit.png')});
  const light = await page.evaluate(() => window.haarlightView.shown.light);
  const png = path.join(site, 'relit.png');
  execFileSync(haarlight, ['convert', large, png, '--light', light.join(','), '--force', '--quiet']);
  await page.locator('#zoom').selectOption('1');
  await page.evaluate(() => {
    window.haarlightView.renderer.pan([-3000, -1800]);
    window.haarlightView.panZoom.moved();
  });

  await settled(page);
  const {worst, pixels} = await compareFullPixels(page, 'relit.png');
  console.log(`  at 100 %: ${pixels} pixels, at most ${worst} of 255 from the command's picture`);
  expect(worst <= 1, 'not the same picture');
  await page.screenshot({path: path.join(folder, 'large-full.png')});
});
fs.rmSync(large);

expect(browser.problems.length === 0, browser.problems.join('\n'));
await browser.end();
