// The daemon's page in a real browser against the real daemon and the virtual rig.
//   node page_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR]
// PROGRAMS: the build's folder apps/; MODULES: where playwright-core is installed; OUT: pictures and
// caches. --images also writes the screenshots of the documents there. scripts/page_test runs it.

import fs from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, Rig, Suite, expect, sleep, until} from './harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const option = name => {
  const i = process.argv.indexOf(name);
  return i < 0 ? '' : process.argv[i + 1];
};
const source = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const cache = path.join(out, 'cache');
fs.mkdirSync(cache, {recursive: true});

const kSmall = path.join(source, 'configs/rigs/small8.toml');
const kScene = path.join(source, 'configs/scenes/blocks.toml');
const kAllOffMs = 100;
const kLong = 'schema = 1\nname = "long"\npatterns = "one_at_a_time"\nrepeats = 200\n';

const suite = new Suite(option('--only'));
const browser = await new Browser().begin(modules);

const picture = (page, name, more = {}) =>
  page.screenshot({path: path.join(out, `${name}.png`), ...more});
const textOf = (page, selector) => page.locator(selector).innerText();
const phaseOf = page => page.locator('#phase').getAttribute('data-phase');

/** Says yes to the warning before flashing. */
async function goOnAfterWarning(page) {
  await page.locator('#warning[open]').waitFor();
  await page.locator('#warning-told').check();
  await page.locator('#warning-go').click();
}

async function startPlan(page, text) {
  await page.locator('#tab-plan').click();
  await page.locator('#plan-text').fill(text);
  await page.locator('#plan-start:enabled').waitFor();
  await page.locator('#plan-start').click();
  await goOnAfterWarning(page);
}

async function clickCell(page, row, col, rows = 8, cols = 8, map = 0) {
  const canvas = page.locator('.face canvas').nth(map);
  await canvas.scrollIntoViewIfNeeded();
  const box = await canvas.boundingBox();
  await page.mouse.click(box.x + (col + 0.5) * box.width / cols, box.y + (row + 0.5) * box.height / rows);
}

/** The canvas's colour at the middle of a cell's left edge, away from its sign. */
const isPainted = (page, selector) => page.locator(selector).evaluate(canvas => {
  const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  const seen = new Set();
  for (let i = 0; i < data.length; i += 4) {
    seen.add(data[i] << 16 | data[i + 1] << 8 | data[i + 2]);
  }
  return seen.size;
});

async function idle(rig) {
  await until(async () => {
    const {phase} = await rig.state();
    if (phase === 'safe-off') {
      await fetch(`${rig.url}/v1/resume`, {method: 'POST'});
    }
    if (!['idle', 'done', 'safe-off'].includes(phase)) {
      await fetch(`${rig.url}/v1/abort`, {method: 'POST'});
    }
    return ['idle', 'done'].includes(phase);
  }, 'the daemon to be free');
}

// ---- the small rig -------------------------------------------------------------------------

const rig = await new Rig(programs, cache).begin(kSmall, {scene: kScene});

await suite.test('loads, prices a plan and says what is wrong with another', async () => {
  const page = await browser.page(rig.url, {}, [/status of 400/]);
  await until(async () => (await textOf(page, '#phase')) === 'ready', 'the phase');
  expect((await page.title()).includes('small8'), 'the title names the rig');
  await until(async () => /64 with light/.test(await textOf(page, '#plan-cost')), 'the dry run');
  expect(/MB|kB/.test(await textOf(page, '#plan-cost')), 'the cost names disk space');
  await page.locator('#plan-text').fill('schema = 1\nname = "x"\npatterns = "all_at_once"\n');
  await until(async () => /plan:3/.test(await textOf(page, '#plan-error')), 'an error with its line');
  expect(await page.locator('#plan-start').isDisabled(), 'a broken plan cannot be started');
  await page.context().close();
});

await suite.test('a run needs the warning confirmed, then runs to its end', async () => {
  const page = await browser.page(rig.url);
  await page.locator('#plan-start:enabled').waitFor();
  await page.locator('#plan-start').click();
  await page.locator('#warning[open]').waitFor();
  expect(await page.locator('#warning-go').isDisabled(), 'going on needs the box ticked');
  expect(/seizures/.test(await textOf(page, '#warning')), 'the warning names the danger');
  await page.locator('#warning-cancel').click();
  await sleep(300);
  expect((await rig.state()).session === null, 'nothing was started without the confirmation');
  await page.locator('#plan-preset').selectOption({label: 'Quick: every light once'});
  await page.locator('#plan-start:enabled').waitFor();
  await page.locator('#plan-start').click();
  await goOnAfterWarning(page);
  await until(async () => await phaseOf(page) === 'done', 'the run to end', 60);
  await until(async () => /64 of 64/.test(await textOf(page, '#run-facts')), '64 of 64 shots');
  const committed = page.locator('#legend li', {hasText: 'committed'});
  await until(async () => /64/.test(await committed.innerText()), 'the map to be full');
  await page.context().close();
});

await suite.test('a click on the map shows the frame and its proof in words', async () => {
  const page = await browser.page(rig.url);
  await until(async () => /64/.test(await textOf(page, '#legend')), 'the map');
  await clickCell(page, 3, 4);
  await until(async () => /confirmed this pattern/.test(await textOf(page, '#shot-words')), 'the proof');
  const words = await textOf(page, '#panel-shot');
  expect(/Shot 28: light 28 \(row 3, column 4\)/.test(words), `the right light: ${words.slice(0, 90)}`);
  expect(/to spare/.test(words) && /Exposure 2\.00 ms, as asked/.test(words), 'margin and exposure');
  await until(async () => await isPainted(page, '#shot-picture') > 8, 'the frame on the page');
  await picture(page, 'evidence');
  await page.context().close();
});

await suite.test('a shot is taken again', async () => {
  const page = await browser.page(rig.url);
  await until(async () => /64/.test(await textOf(page, '#legend')), 'the map');
  await clickCell(page, 0, 5);
  await page.locator('#reshoot:enabled').waitFor();
  await page.locator('#reshoot').click();
  await goOnAfterWarning(page);
  await until(async () => /attempt 2/.test(await textOf(page, '#shot-verdict')), 'attempt 2', 60);
  const again = page.locator('#legend li', {hasText: /^taken again/});
  await until(async () => /1$/.test((await again.innerText()).trim()), 'the mark on the map');
  await page.context().close();
});

await suite.test('pause, resume, time left, all-off within 100 ms, abort', async () => {
  const page = await browser.page(rig.url);
  await startPlan(page, kLong);
  await until(async () => /left/.test(await textOf(page, '#run-left')), 'a time left');
  await page.locator('#pause').click();
  await until(async () => await phaseOf(page) === 'paused', 'the pause');
  await until(async () => (await rig.state()).lights === 'off', 'dark in the pause');
  const paused = (await rig.state()).committed;
  await page.locator('#resume').click();
  await goOnAfterWarning(page);
  await until(async () => (await rig.state()).committed > paused + 5, 'more shots');
  await page.locator('#all-off').click();
  const note = await until(async () =>
    /took the order in (\d+) ms/.exec(await textOf(page, '#off-note')), 'the answer to all-off');
  await until(async () => await phaseOf(page) === 'safe-off', 'safe-off');
  await until(async () => /lights off/.test(await textOf(page, '#lights')), 'the controller to say dark');
  const times = [Number(note[1])];
  for (let i = 0; i < 9; ++i) {
    times.push(await page.evaluate(async () => {
      const begun = performance.now();
      await fetch('/v1/all-off', {method: 'POST'});
      return performance.now() - begun;
    }));
  }
  times.sort((a, b) => a - b);
  expect(times[5] <= kAllOffMs, `all-off took ${times[5]} ms, median of 10`);
  await page.locator('#resume').click();
  await goOnAfterWarning(page);
  await until(async () => await phaseOf(page) === 'running', 'running again');
  await page.locator('#abort').click();
  await page.locator('#sure-go').click();
  await until(async () => await phaseOf(page) === 'idle', 'the end');
  await page.context().close();
  return `all-off ${times[5].toFixed(0)} ms median, ${times[9].toFixed(0)} ms at most`;
});

await idle(rig);
await rig.end();
await suite.test('no console errors, no foreign requests', () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});
await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
