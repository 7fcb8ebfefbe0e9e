// The daemon's page in a real browser against the real daemon and the virtual rig.
//   node page_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR]
// PROGRAMS: the build's folder apps/; MODULES: where playwright-core is installed; OUT: pictures and
// caches. --images also writes the screenshots of the documents there. scripts/page_test runs it.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, Rig, Suite, expect, sleep, until} from './harness.mjs';
import {takeImages, takeSmallImages} from './page_images.mjs';
import {allOffInReach, contrast, fitsThePhone, namesAndRoles, tabOrder} from './page_rules.mjs';

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

const browser = await new Browser().begin(modules);
const suite = new Suite(browser, option('--only'));

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

const mapIsThere = page =>
  until(async () => /[1-9]/.test(await textOf(page, '#legend')), 'the map of a session');

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
  // One or two may have been taken again by themselves: then they have another mark.
  const count = async name => Number(await page.locator('#legend li', {hasText: name}).locator('b').innerText());
  await until(async () => await count(/^committed/) + await count(/^taken again/) === 64, 'the map to be full')
    .catch(async error => expect(false, `${error.message}: ${await textOf(page, '#legend')}`));
});

await suite.test('a click on the map shows the frame and its proof in words', async () => {
  const page = await browser.page(rig.url);
  await mapIsThere(page);
  await clickCell(page, 3, 4);
  await until(async () => /confirmed this pattern/.test(await textOf(page, '#shot-words')), 'the proof');
  const words = await textOf(page, '#panel-shot');
  expect(/Shot 28: light 28 \(row 3, column 4\)/.test(words), `the right light: ${words.slice(0, 90)}`);
  expect(/undamaged and in sequence/.test(words), 'the frame is not called damaged');
  expect(/to spare/.test(words) && /Exposure 2\.00 ms, as requested/.test(words), 'margin and exposure');
  await until(async () => await isPainted(page, '#shot-picture') > 8, 'the frame on the page');
  await picture(page, 'evidence');
});

await suite.test('a shot is taken again', async () => {
  const page = await browser.page(rig.url);
  await mapIsThere(page);
  await clickCell(page, 0, 5);
  await page.locator('#reshoot:enabled').waitFor();
  await page.locator('#reshoot').click();
  await goOnAfterWarning(page);
  await until(async () => /attempt [2-9]/.test(await textOf(page, '#shot-verdict')), 'attempt 2', 60);
  const again = page.locator('#legend li', {hasText: /^taken again/});
  await until(async () => /[1-9]\d*$/.test((await again.innerText()).trim()), 'the mark on the map');
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
  return `all-off ${times[5].toFixed(0)} ms median, ${times[9].toFixed(0)} ms at most`;
});

await suite.test('everything by keyboard alone', async () => {
  const page = await browser.page(rig.url);
  await page.locator('#plan-start:enabled').waitFor();
  await page.locator('.grid').first().waitFor();  // comes by itself, perhaps later
  const {reached, problems} = await tabOrder(page);
  expect(problems.length === 0, problems.join('\n'));
  for (const id of ['all-off', 'theme', 'session', 'by-light', 'grid', 'tab-plan', 'plan-text', 'plan-start']) {
    expect(reached.some(name => name.includes(id)), `Tab never reaches ${id}: ${reached}`);
  }
  await page.locator('#tab-plan').focus();
  await page.keyboard.press('ArrowRight');
  expect(await page.locator('#panel-rig').isVisible(), 'arrow keys move over the tabs');
  await page.keyboard.press('ArrowRight');
  expect(await page.locator('#panel-log').isVisible(), 'and further');
  await page.locator('#tab-plan').click();
  await page.locator('#plan-preset').focus();
  await page.keyboard.press('Q');  // "Quick"
  await until(async () => /quick/.test(await page.locator('#plan-text').inputValue()), 'the preset');
  await page.locator('#plan-start:enabled').waitFor();
  await page.locator('#plan-start').focus();
  await page.keyboard.press('Enter');
  await page.locator('#warning[open]').waitFor();
  await page.keyboard.press('Space');  // the box has the focus
  await page.locator('#warning-go:enabled').waitFor();
  await page.locator('#warning-go').focus();
  await page.keyboard.press('Enter');
  await until(async () => await phaseOf(page) === 'done', 'the run to end', 60);
  await page.locator('.grid').focus();
  for (const key of ['Home', 'ArrowDown', 'ArrowDown', 'ArrowRight', 'End', 'ArrowLeft', 'PageDown', 'PageUp', 'ArrowDown']) {
    await page.keyboard.press(key);
  }
  const cell = await page.locator('[role="gridcell"]').textContent();
  expect(/light 14 \(row 1, column 6\): committed/.test(cell), `the reader's cell says: ${cell}`);
  await page.keyboard.press('Enter');
  await until(async () => /Shot 14/.test(await textOf(page, '#shot-title')), 'the shot opened by Enter');
  await page.keyboard.press('r');  // the warning was confirmed a moment ago
  await until(async () => /attempt [2-9]/.test(await textOf(page, '#shot-verdict')), 'taken again by the key r', 60);
  await page.locator('#tab-plan').click();
  await page.locator('#plan-text').focus();
  await page.keyboard.press('Escape');  // works while typing, too
  await until(async () => await phaseOf(page) === 'safe-off', 'all-off by Escape');
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press('p');
  await goOnAfterWarning(page);
  await until(async () => await phaseOf(page) !== 'safe-off', 'resumed by the key p');
  return `${reached.length} stops of Tab`;
});

await suite.test('names, contrast in both schemes, nothing sticks out on a phone', async () => {
  let n = 0;
  for (const [name, options] of [
    ['dark', {colorScheme: 'dark'}], ['light', {colorScheme: 'light'}],
    ['phone', {colorScheme: 'dark', viewport: {width: 360, height: 740}, isMobile: true, hasTouch: true}]]) {
    const page = await browser.page(rig.url, options);
    await mapIsThere(page);
    await page.evaluate(() => {  // what is rarely shown is checked as well
      for (const id of ['lost', 'suspended', 'off-note']) {
        document.getElementById(id).hidden = false;
      }
      document.getElementById('lost').textContent = 'Connection lost.';
      document.getElementById('suspended-title').textContent = 'Suspended: the camera is lost.';
      document.getElementById('suspended-detail').textContent = 'no frame for 1.2 s';
      document.getElementById('off-note').className = 'banner bad';
      document.getElementById('off-note').textContent = 'ALL OFF WAS NOT ANSWERED.';
    });
    if (name === 'phone') {
      await page.locator('.face canvas').first().tap({position: {x: 20, y: 20}});
    } else {
      await clickCell(page, 1, 1);
    }
    await until(async () => /confirmed/.test(await textOf(page, '#shot-words')), 'the evidence');
    for (const tab of ['shot', 'live', 'plan', 'rig', 'log']) {
      await page.locator(`#tab-${tab}`).click();
      for (const rule of [namesAndRoles, contrast, allOffInReach, ...(name === 'phone' ? [fitsThePhone] : [])]) {
        const problems = await rule(page);
        ++n;
        expect(problems.length === 0, `${name}, ${tab}, ${rule.name}: ${problems.join('; ')}`);
      }
    }
    for (const dialog of ['warning', 'login', 'sure']) {
      await page.evaluate(id => document.getElementById(id).showModal(), dialog);
      const problems = await contrast(page);
      expect(problems.length === 0, `${name}, ${dialog}: ${problems.join('; ')}`);
      await page.evaluate(id => document.getElementById(id).close(), dialog);
    }
    }
  return `${n} rules held`;
});

await suite.test('a preview warns, lights, marks clipping, and stores nothing', async () => {
  await idle(rig);
  const page = await browser.page(rig.url);
  await mapIsThere(page);
  const sessions = fs.readdirSync(path.join(rig.folder, 'sessions')).length;
  await page.locator('#tab-live').click();
  await page.locator('#live-lights').fill('0-63');
  await page.locator('#live-exposure').fill('8000');
  await page.locator('#live-start').click();
  await goOnAfterWarning(page);
  await until(async () => /[1-9]\d*\.\d\d % saturated/.test(await textOf(page, '#live-facts')), 'saturation told');
  const red = () => page.locator('#live-picture').evaluate(canvas => {
    const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let n = 0;
    for (let i = 0; i < data.length; i += 4) {
      n += data[i] === 255 && data[i + 1] === 32 && data[i + 2] === 32 ? 1 : 0;
    }
    return n;
  });
  await until(async () => await red() > 50, 'the saturated pixels in red');
  await page.locator('#live-clipping').uncheck();
  await until(async () => await red() === 0, 'no red without the marking');
  await until(async () => /lights on/.test(await textOf(page, '#lights')), 'the lights to be told as on');
  await page.locator('#live-stop').click();
  await until(async () => (await rig.state()).lights === 'off', 'dark again');
  await until(async () => /camera is idle/.test(await textOf(page, '#live-hint')), 'no stale picture');
  expect(fs.readdirSync(path.join(rig.folder, 'sessions')).length === sessions, 'a preview stores nothing');
});

await suite.test('the live picture: a region pixel by pixel, its sharpness and histogram', async () => {
  await idle(rig);
  const page = await browser.page(rig.url);
  const asked = [];
  page.on('request', request => asked.push(request.url()));
  await page.locator('#live-lights').evaluate(input => {
    input.value = '0-63';
  });
  await fetch(`${rig.url}/v1/preview`, {method: 'POST', body: JSON.stringify({lights: [27, 28], exposure_us: 200})});
  await until(async () => (await rig.state()).is_preview, 'light');
  await sleep(600);
  expect(!asked.some(url => url.includes('/preview')), 'no picture is asked for before somebody looks');
  await page.locator('#tab-live').click();
  await until(async () => /Frame \d+ at/.test(await textOf(page, '#live-facts')), 'a picture');
  expect(/All 64 × 48 pixels/.test(await textOf(page, '#live-place')), await textOf(page, '#live-place'));
  expect(await page.locator('#live-zoom [aria-checked="true"]').innerText() === 'Whole', 'the whole at first');
  await page.locator('#live-zoom button', {hasText: '8:1'}).click();
  const place = () => page.locator('#live-place').innerText();
  const columns = text => Number(/Columns (\d+)–/.exec(text)?.[1]);
  await until(async () => /Columns/.test(await place()), 'a crop');
  const first = await place();
  const size = await page.locator('#live-picture').evaluate(canvas => [canvas.width, canvas.clientWidth]);
  expect(size[0] < 64 && Math.abs(size[1] - 8 * size[0]) <= 1, `8 screen pixels per sensor pixel: ${size}`);
  await page.locator('#live-frame').focus();
  await page.keyboard.press('ArrowLeft');
  await until(async () => columns(await place()) < columns(first), 'the crop to move by a key');
  const left = columns(await place());
  const box = await page.locator('#live-frame').boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 - 40, box.y + box.height / 2, {steps: 4});
  await page.mouse.up();
  await until(async () => columns(await place()) === left + 5, `5 pixels further: ${await place()}`);
  await page.keyboard.press('0');
  await until(async () => /All 64/.test(await place()), 'the whole again');
  await until(async () => Number(await textOf(page, '#live-sharp-value')) > 0, 'a sharpness');
  await until(async () => /best so far [\d.]+/.test(await textOf(page, '#live-sharp-best')), 'the best so far');
  expect(/All: mean [\d\u202f]+, .* % saturated/.test(await textOf(page, '#live-counts')), 'the counts in words');
  expect(/clipping from/.test(await textOf(page, '#live-axis')), 'the clip level is named');
  const ink = () => page.locator('#live-histogram').evaluate(canvas => {
    const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return data.reduce((n, v, i) => n + (i % 4 === 3 && v > 0 ? 1 : 0), 0);
  });
  const logarithmic = await ink();
  await page.locator('#live-log').uncheck();
  await until(async () => await ink() < 0.8 * logarithmic, 'linear counts stand lower');
  // Sharpness does not follow the exposure; a longer one only needs to stay below clipping.
  const sharpness = async () => (await (await fetch(`${rig.url}/v1/preview/facts`)).json()).sharpness;
  const short = await sharpness();
  await fetch(`${rig.url}/v1/abort`, {method: 'POST'});
  await idle(rig);
  await fetch(`${rig.url}/v1/preview`, {method: 'POST', body: JSON.stringify({lights: [27, 28], exposure_us: 100})});
  await until(async () => (await rig.state()).step === 'collect', 'light');
  await sleep(700);
  const half = await sharpness();
  expect(short.share_used === 1, `nothing is saturated: ${short.share_used}`);
  expect(half.level_dn < 0.7 * short.level_dn, `half the light: ${half.level_dn} of ${short.level_dn}`);
  expect(Math.abs(half.value / short.value - 1) < 0.05, `the same sharpness: ${half.value}, ${short.value}`);
  await fetch(`${rig.url}/v1/abort`, {method: 'POST'});
  return `${short.value.toFixed(3)} and ${half.value.toFixed(3)} at half the exposure`;
});

await suite.test('with repeats every light fills with its shots', async () => {
  await idle(rig);
  const page = await browser.page(rig.url);
  await startPlan(page, 'schema = 1\nname = "bracket"\npatterns = "one_at_a_time"\nrepeats = 30\norder = "bit_reversed"\n');
  await until(async () => (await rig.state()).committed > 100, 'some shots', 60);
  await page.locator('#pause').click();
  await until(async () => await phaseOf(page) === 'paused', 'the pause');
  const {committed, session} = await rig.state();
  await sleep(1500);
  await page.locator('.grid').focus();
  await page.keyboard.press('Home');
  const words = await until(async () => {
    const text = await page.locator('#map-readout').textContent();
    return /of its 30 shots done/.test(text) && text;
  }, 'how much of a light is done, in words');
  const marks = (await (await fetch(`${rig.url}/v1/sessions/${session}/map`)).json()).marks;
  expect(marks.length === 1920, 'thirty shots per light');
  const greens = await page.locator('.face canvas').evaluate(canvas => {
    const colour = getComputedStyle(document.documentElement).getPropertyValue('--m-committed').trim();
    const probe = document.createElement('canvas').getContext('2d');
    probe.fillStyle = colour;
    probe.fillRect(0, 0, 1, 1);
    const [r, g, b] = probe.getImageData(0, 0, 1, 1).data;
    const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let n = 0;
    for (let i = 0; i < data.length; i += 4) {
      n += data[i] === r && data[i + 1] === g && data[i + 2] === b ? 1 : 0;
    }
    return n / (canvas.width * canvas.height);
  });
  const share = committed / 1920;
  expect(Math.abs(greens - 0.88 * 0.88 * share) < 0.05, `${greens} of the map is filled, ${share} is done`);
  await clickCell(page, 0, 0);
  await page.locator('#shot-choice select').waitFor();
  expect(await page.locator('#shot-choice option').count() === 30, 'a choice of all its shots');
  await picture(page, 'brackets');
  await idle(rig);
  return words;
});

await suite.test('the devices, what to do about them, and their history', async () => {
  await idle(rig);
  const page = await browser.page(rig.url, {}, [/status of 404/]);
  await page.locator('#tab-rig').click();
  const devices = () => textOf(page, '#devices');
  await until(async () => /controller/.test(await devices()) && /camera main/.test(await devices()), 'the devices');
  expect(/rests|delivers/.test(await devices()) && /GB free/.test(await devices()), `found: ${await devices()}`);
  await until(async () => /Power of the lights/.test(await textOf(page, '#charts')), 'the charts');
  await startPlan(page, kLong);
  await page.locator('#tab-rig').click();
  await until(async () => /Temperature of the controller\s*\d+\.\d °C/.test(await textOf(page, '#charts')), 'a temperature');
  await until(async () => /[1-9]\d* \/s/.test(await textOf(page, '#charts')), 'frames a second');
  await until(async () => /delivers frames/.test(await devices()), 'a camera at work');
  rig.signal('sim', 'SIGSTOP');
  await until(async () => await page.locator('#devices .wrong').count() > 0, 'a lost device');
  const words = await page.locator('#devices .wrong .cure').first().innerText();
  expect(/switched on|cable/.test(words), `what to do: ${words}`);
  rig.signal('sim', 'SIGCONT');
  await until(async () => await page.locator('#devices .wrong').count() === 0, 'it to be good again', 60);
  await idle(rig);
  return words;
});

await suite.test('a suspended run says why and what to do, and goes on', async () => {
  await idle(rig);
  const page = await browser.page(rig.url);
  await startPlan(page, kLong);
  await until(async () => (await rig.state()).committed > 5, 'some shots');
  rig.signal('sim', 'SIGSTOP');
  await until(async () => await page.locator('#suspended').isVisible(), 'the banner');
  const words = await until(async () => {
    const text = await textOf(page, '#suspended');
    return /lost/.test(text) && text;
  }, 'the reason');
  expect(/Check its cable/.test(words) && /resumes by itself/.test(words), `what to do: ${words}`);
  rig.signal('sim', 'SIGCONT');
  await until(async () => await phaseOf(page) === 'running', 'the run to go on', 60);
  await until(async () => !(await page.locator('#suspended').isVisible()), 'the banner to go');
  rig.order('interlock open');
  await until(async () => /The interlock is open.*Close the rig/s.test(await textOf(page, '#suspended')),
              'the interlock and what to do');
  expect((await rig.state()).lights === 'off', 'dark behind an open interlock');
  rig.order('interlock closed');
  await until(async () => await phaseOf(page) === 'running', 'the run to go on', 60);
});

await suite.test('a killed daemon: a banner, nothing old shown as live, and recovery', async () => {
  const page = await browser.page(rig.url, {}, [/ERR_CONNECTION|ERR_INCOMPLETE|ERR_EMPTY|Failed to load/]);
  await until(async () => await phaseOf(page) === 'running', 'a run');
  await page.locator('#tab-live').click();
  await page.locator('#live-hint').waitFor({state: 'hidden'});
  const begun = Date.now();
  rig.signal('daemon', 'SIGKILL');
  await until(async () => /Connection lost/.test(await textOf(page, '#lost')), 'the banner', 5);
  const ms = Date.now() - begun;
  expect(await page.locator('#live-hint').isVisible(), 'no live picture without a daemon');
  expect(await phaseOf(page) === 'lost', 'the phase is not told as known');
  expect(/not known/.test(await textOf(page, '#lights')), 'the lights are not told as known');
  expect(await textOf(page, '#run-left') === '', 'no time left is told');
  await page.locator('#all-off').click();
  await until(async () => /NOT ANSWERED/.test(await textOf(page, '#off-note')), 'a loud word');
  await rig.beginDaemon();
  await until(async () => !(await page.locator('#lost').isVisible()), 'the banner to go');
  const then = (await rig.state()).committed;
  await until(async () => (await rig.state()).committed > then, 'the run to go on by itself');
  await until(async () => await phaseOf(page) === 'running', 'the page to follow');
  await page.locator('#log-none').waitFor({state: 'hidden'});  // the events flow again
  rig.signal('daemon', 'SIGSTOP');  // alive for the network, and silent
  await until(async () => /Connection lost/.test(await textOf(page, '#lost')), 'the banner', 15);
  rig.signal('daemon', 'SIGCONT');
  await until(async () => !(await page.locator('#lost').isVisible()), 'the banner to go');
  return `banner after ${ms} ms`;
});

await suite.test('an earlier session is looked at, and an unfinished one gone on with', async () => {
  await idle(rig);
  const page = await browser.page(rig.url);
  await until(async () => (await page.locator('#session option').count()) > 2, 'the sessions');
  const ids = await page.locator('#session option').allInnerTexts();
  const unfinished = ids.find(text => /aborted|unfinished/.test(text));
  const finished = ids.find(text => /^\d{8}-\d{6}-\w+$/.test(text));
  await page.locator('#session').selectOption({label: finished});
  await until(async () => /not at what runs now/.test(await textOf(page, '#old-session')), 'the note');
  await until(async () => /committed 6\d/.test((await textOf(page, '#legend')).replace(/\s+/g, ' ')), 'its map');
  await clickCell(page, 2, 2);
  await until(async () => /confirmed this pattern/.test(await textOf(page, '#shot-words')), 'its evidence');
  await page.locator('#reshoot:enabled').click();
  await goOnAfterWarning(page);
  await until(async () => /attempt \d/.test(await textOf(page, '#shot-verdict')), 'an earlier session reopened and shot again', 60);
  await until(async () => await phaseOf(page) === 'done', 'the end');
  await page.locator('#session').selectOption({label: unfinished});
  await page.locator('#go-on').click();
  await goOnAfterWarning(page);
  await until(async () => await phaseOf(page) === 'running', 'it to go on');
});

await suite.test('ten open pages leave a connection for all-off', async () => {
  await idle(rig);
  const first = await browser.page(rig.url);
  const pages = [first];
  while (pages.length < 10) {
    const page = await first.context().newPage();
    await page.goto(rig.url);
    pages.push(page);
  }
  for (const page of pages) {
    await until(async () => ['idle', 'done'].includes(await phaseOf(page)), 'every page to be live');
  }
  const last = pages.at(-1);
  await last.locator('#all-off').click();
  const note = await until(async () =>
    /took the order in (\d+) ms/.exec(await textOf(last, '#off-note')), 'the answer to all-off', 10);
  for (const page of pages) {
    await until(async () => await phaseOf(page) === 'safe-off', 'every page to follow');
    await until(async () => /safe-off/.test(await page.locator('#log').innerText()
      .catch(() => '') || await page.locator('#log').textContent()), 'every page to hear the event');
  }
  return `${note[1]} ms`;
});

await suite.test('a map of 6144 lights is drawn in a moment', async () => {
  const page = await browser.page(rig.url);
  const ms = await page.evaluate(async () => {
    const {GridMap} = await import('/map.js');
    const map = new GridMap({title: 'large', rows: 64, cols: 96, count: 6144, describe: i => `${i}`,
                             open() {}, moved() {}});
    document.getElementById('maps').append(map.root);
    await new Promise(requestAnimationFrame);
    const times = [];
    for (let i = 0; i < 20; ++i) {
      const begun = performance.now();
      map.set('.*~o?xwr'.repeat(768).slice(i % 8) + '.'.repeat(i % 8));
      map.canvas.getContext('2d').getImageData(0, 0, 1, 1);  // until it is really drawn
      times.push(performance.now() - begun);
    }
    return times.sort((a, b) => a - b)[10];
  });
  expect(ms < 200, `${ms} ms`);
  return `${ms.toFixed(1)} ms, median of 20`;
});

await suite.test('every action of the page has a verb of the command', () => {
  const scripts = fs.readdirSync(path.join(source, 'web')).filter(name => name.endsWith('.js'));
  const text = scripts.map(name => fs.readFileSync(path.join(source, 'web', name), 'utf8')).join('\n');
  const paths = new Set([...text.matchAll(/(?:post|postUrgent|act)\(\s*[`'](\/v1\/[a-z-]+)/g)].map(match => match[1]));
  const verbs = {'/v1/run': 'capture', '/v1/dry-run': 'plan'};
  expect(paths.size >= 8, `the page posts to ${[...paths]}`);
  for (const one of paths) {
    const verb = verbs[one] || one.slice('/v1/'.length);
    const help = execFileSync(path.join(programs, 'haarlight/haarlight'), [verb, '--help']).toString();
    expect(new RegExp(`haarlight ${verb} `).test(help), `haarlight has no verb ${verb} for ${one}`);
  }
  return [...paths].join(' ');
});

await idle(rig);
await rig.end();

// ---- several faces, odd grids, a token -----------------------------------------------------

const kToken = 'a-token-of-the-lab-0123456789';
const odd = await new Rig(programs, cache).begin(kSmall, {
  scene: kScene, token: kToken,
  change: text => {
    const [head, face, rest] = text.split(/(?=\[\[face\]\])|(?=\[\[plane\]\])/);
    const one = face.replace(/^rows = .*/m, 'rows = 5').replace(/^cols = .*/m, 'cols = 7');
    const two = face.replace(/^id = .*/m, 'id = "side"').replace(/^rows = .*/m, 'rows = 3')
      .replace(/^cols = .*/m, 'cols = 4').replace(/^centre = .*/m, 'centre = [900.0, 0.0, 500.0]')
      .replace(/^u = .*/m, 'u = [0.0, 1.0, 0.0]').replace(/^v = .*/m, 'v = [0.0, 0.0, 1.0]')
      .replace(/^emits = .*/m, 'emits = [-1.0, 0.0, 0.0]');
    return head + one + two + rest;
  },
});

await suite.test('the token is asked for, refused when wrong, and then remembered', async () => {
  const page = await browser.page(odd.url, {}, [/status of 401/]);
  await until(async () => await phaseOf(page) === 'idle', 'reading without the token on the loopback');
  await page.locator('#tab-plan').click();
  await page.locator('#plan-preset').selectOption({label: 'Quick: every light once'});
  await page.locator('#plan-start:enabled').waitFor();
  await page.locator('#plan-start').click();
  await goOnAfterWarning(page);
  await page.locator('#login[open]').waitFor();
  await page.locator('#login-token').fill('not-the-token-at-all');
  await page.locator('#login-token').press('Enter');
  await until(async () => /not the token/.test(await textOf(page, '#login-error')), 'the refusal');
  expect((await odd.state()).phase === 'idle', 'nothing began without the token');
  await page.locator('#login-token').fill(kToken);
  await page.locator('#login-token').press('Enter');
  await until(async () => await phaseOf(page) === 'done', 'the run', 60);
  const cookies = await page.context().cookies();
  expect(cookies.length === 1 && cookies[0].httpOnly && cookies[0].sameSite === 'Strict',
         'a cookie that scripts cannot read and other sites cannot send');
  expect(!JSON.stringify(await page.evaluate(() => ({...localStorage, ...sessionStorage, c: document.cookie})))
    .includes(kToken), 'the token is kept nowhere in the page');
  await page.reload();
  await until(async () => await phaseOf(page) === 'done', 'the page again');
  await page.locator('#all-off').click();
  await until(async () => /took the order/.test(await textOf(page, '#off-note')), 'no second question');
  await page.locator('#resume').click();
  await goOnAfterWarning(page);
  await until(async () => await phaseOf(page) !== 'safe-off', 'resumed');
});

await suite.test('two faces with odd grids', async () => {
  const page = await browser.page(odd.url);
  await until(async () => (await page.locator('.face').count()) === 2, 'two maps');
  await until(async () => /47/.test(await textOf(page, '#legend')), '47 shots');
  await clickCell(page, 2, 3, 3, 4, 1);
  await until(async () => /light 46 of face side \(row 2, column 3\)/.test(await textOf(page, '#shot-title')), 'the last light');
  await clickCell(page, 4, 0, 5, 7, 0);
  await until(async () => /light 28 of face top \(row 4, column 0\)/.test(await textOf(page, '#shot-title')), 'light 28');
  await picture(page, 'two-faces');
});

await suite.test('a plan named like a script stays text', async () => {
  const page = await browser.page(odd.url, {}, [/status of 401/]);
  page.on('dialog', dialog => {
    browser.problems.push(`a script ran: ${dialog.message()}`);
    dialog.dismiss();
  });
  const name = '<script>alert(1)</script><img src=x onerror=alert(2)>';
  await page.locator('#tab-plan').click();
  await page.locator('#plan-text').fill(
    `schema = 1\nname = "${name}"\npatterns = "list"\n[[pattern]]\nlights = [0, 1]\n[[pattern]]\nlights = [45]\n`);
  await page.locator('#plan-start:enabled').waitFor();
  await page.locator('#plan-start').click();
  await page.locator('#warning[open]').waitFor();
  expect((await textOf(page, '#warning-text')).includes(name), 'the name is text in the warning');
  await page.locator('#warning-told').check();
  await page.locator('#warning-go').click();
  await page.locator('#login[open]').waitFor();
  await page.locator('#login-token').fill(kToken);
  await page.locator('#login-token').press('Enter');
  await until(async () => (await textOf(page, '#run-title')).includes(name), 'the name is text in the title', 60);
  await until(async () => await phaseOf(page) === 'done', 'the run', 60);
  expect(await page.locator('main img, main script').count() === 0, 'no element came from the name');
  await page.locator('#by-shot').click();
  await until(async () => (await page.locator('.face h3').innerText()).includes('2 shots'), 'the shots');
});

await odd.end();

if (option('--images')) {
  await suite.test('pictures for the documents', async () => {
    const to = path.resolve(option('--images'));
    await takeSmallImages(browser, programs, cache, source, to);
    await takeImages(browser, programs, cache, source, to);
  });
}

await suite.test('no console errors, no foreign requests', () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});
await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
