// How fast the viewer is in headless Chromium with software GL: docs/reference/viewer.md has its figures.
//   node view_bench.mjs PROGRAMS MODULES OUT [--demo BASIS.hlb] [--only NAME] [--runs N]
// scripts/page_test BUILD --bench-viewer runs it. It only prints figures, without limits.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, sleep} from './harness.mjs';
import {Viewer, settled} from './view_harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const option = (name, fallback) => {
  const i = process.argv.indexOf(name);
  return i < 0 ? fallback : process.argv[i + 1];
};
const source = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const only = option('--only', '');
const runs = Number(option('--runs', '9'));
const folder = path.join(out, 'view');
fs.mkdirSync(folder, {recursive: true});

const sorted = values => [...values].sort((a, b) => a - b);
const quantile = (values, share) => sorted(values)[Math.min(values.length - 1, Math.floor(share * values.length))];
const told = values => `median ${quantile(values, 0.5).toFixed(1)}, 95 % ${quantile(values, 0.95).toFixed(1)}, ` +
  `most ${Math.max(...values).toFixed(1)} (${values.length})`;

/** The made scene with noise under cube32's lights, where no page is empty: the worst case. Kept. */
function dense(size) {
  const file = path.join(folder, `dense${size}.hlb`);
  if (!fs.existsSync(file)) {
    execFileSync(path.join(programs, '../tests/web/made_basis'),
                 [file, '--rig', path.join(source, 'configs/rigs/cube32.toml'), '--width', `${size}`,
                  '--height', `${size}`, '--plate', '--noise', '0.05']);
  }
  return file;
}

/** Processor time of everything that this program has started, ms: what a busy machine leaves alone. */
function processorMs() {
  const stats = new Map();
  for (const pid of fs.readdirSync('/proc').filter(name => /^\d+$/.test(name))) {
    try {
      const fields = fs.readFileSync(`/proc/${pid}/stat`, 'utf8').split(') ').at(-1).split(' ');
      stats.set(pid, {parent: fields[1], ticks: Number(fields[11]) + Number(fields[12])});
    } catch { /* it has ended */ }
  }
  const isOurs = pid => pid === String(process.pid) || (stats.has(pid) && isOurs(stats.get(pid).parent));
  return [...stats].reduce((sum, [pid, {parent, ticks}]) => sum + (isOurs(parent) ? 10 * ticks : 0), 0);
}

const browser = await new Browser().begin(modules);

async function viewing(file, body, sums = '') {
  const viewer = await new Viewer(programs).begin(file);
  const page = await browser.page(`${viewer.url}/viewer/index.html?sums=${sums}`);
  await settled(page);
  const result = await body(page);
  await browser.closePages();
  await viewer.end();
  return result;
}

/** Time from the program's start, and from the page's, to pictures. */
async function measureStart(file) {
  const [served, first, whole] = [[], [], []];
  for (let run = 0; run < runs; ++run) {
    const viewer = await new Viewer(programs).begin(file);
    served.push(performance.now() - viewer.begun);
    const begun = performance.now();
    const page = await browser.page(`${viewer.url}/`);
    await page.waitForFunction(() => {
      const {engine, basis} = window.haarlightView ?? {};
      return engine?.isShown && basis.isLoaded[0].some(Boolean) && !engine.isStale;
    }, null, {polling: 10});
    first.push(performance.now() - begun);
    await settled(page);
    whole.push(performance.now() - begun);
    await browser.closePages();
    await viewer.end();
  }
  console.log(`${path.basename(file)}: program to address ${told(served)} ms`);
  console.log(`  page to first picture ${told(first)} ms`);
  console.log(`  page to every term loaded and shown ${told(whole)} ms`);
}

/** Frames a second with a number of terms in every frame, whatever it costs. */
async function measureFrames(file, terms, sums) {
  await viewing(file, async page => {
    const before = processorMs();
    const found = await page.evaluate(async ([k, seconds]) => {
      const {engine, basis, renderer} = window.haarlightView;
      engine.terms = k;
      engine.frameMs = Infinity;
      const weights = Array.from({length: 8}, (_, phase) => Float64Array.from({length: basis.nLights}, (_, i) =>
        (1.2 + Math.sin(0.37 * i + phase) + 4 * (i % 97 === phase ? 1 : 0)) / basis.nLights));
      await engine.settled();
      // New weights before every frame; the engine draws one picture per frame.
      const times = [];
      engine.termsDrawn = [];
      const begun = performance.now();
      let last = begun;
      while (last - begun < 1000 * seconds) {
        engine.setWeights([weights[times.length % weights.length]]);
        const now = await new Promise(resolve => requestAnimationFrame(() => resolve(performance.now())));
        times.push(now - last);
        last = now;
      }
      return {times: times.slice(5), drawn: engine.termsDrawn, pages: renderer.cost(engine.shownJob),
              tiles: basis.nTiles, ns: engine.nsPerTexel.value};
    }, [terms, 6]);
    if (found.drawn.some(n => n !== terms) || found.drawn.length < found.times.length) {
      throw new Error(`not every frame had a picture of ${terms} terms: ${found.drawn}`);
    }
    const used = (processorMs() - before) / found.drawn.length;
    const ms = quantile(found.times, 0.5);
    console.log(`${path.basename(file)}, ${terms} terms in every frame, summed by ${sums} (${found.pages} pages, ${found.tiles} tiles): ` +
      `${(1000 / ms).toFixed(1)} frames a second; ${told(found.times)} ms; ${used.toFixed(1)} ms of processor time per frame; ` +
      `load ${os.loadavg()[0].toFixed(1)} on ${os.cpus().length} processors`);
  }, sums);
}

/** From the pointer's movement to the frame after its picture. */
async function measureDrag(file, mode) {
  await viewing(file, async page => {
    if (mode === 'paint') {
      await page.locator('#all-lights').click();
      await page.locator('#mode-erase').click();
    }
    await settled(page);
    const box = await page.locator('.face canvas').first().boundingBox();
    const at = turn => [box.x + box.width * (0.5 + 0.4 * Math.cos(turn)), box.y + box.height * (0.5 + 0.4 * Math.sin(1.3 * turn))];
    await page.mouse.move(...at(0));
    await page.mouse.down();
    await page.evaluate(() => {
      const {engine} = window.haarlightView;
      engine.latencies = [];
      engine.termsDrawn = [];
    });
    for (let i = 0; i < 200; ++i) {
      await page.mouse.move(...at(i / 16));
      await sleep(12);
    }
    await page.mouse.up();
    const found = await page.evaluate(() => {
      const {latencies, termsDrawn} = window.haarlightView.engine;
      return {latencies, termsDrawn};
    });
    const released = performance.now();
    await settled(page);
    const terms = await page.evaluate(() => window.haarlightView.engine.status().terms);
    console.log(`${path.basename(file)}, ${mode}: movement to picture ${told(found.latencies)} ms, ` +
      `${quantile(found.termsDrawn, 0.5)} terms meanwhile (least ${Math.min(...found.termsDrawn)}); ` +
      `all ${terms} terms ${(performance.now() - released).toFixed(0)} ms after the last movement; ` +
      `load ${os.loadavg()[0].toFixed(1)}`);
  });
}

/** Turning an environment: the server's quick weights alone, then from the slider's movement to the picture. */
async function measureTurn(file) {
  await viewing(file, async page => {
    await page.locator('#environment-file').setInputFiles(path.join(source, 'configs/environments/room.hdr'));
    await page.waitForFunction(() => window.haarlightView.environment?.isExact);
    await settled(page);
    const asked = await page.evaluate(async () => {
      const times = [];
      for (let i = 0; i < 60; ++i) {
        const begun = performance.now();
        await (await fetch(`/v1/environments/${window.haarlightView.environment.id}/weights?rotate=${0.5 + 3 * i}&quality=quick`)).json();
        times.push(performance.now() - begun);
      }
      return times;
    });
    await page.locator('#turn').focus();
    await page.evaluate(() => {
      const {engine} = window.haarlightView;
      engine.latencies = [];
      engine.termsDrawn = [];
    });
    for (let i = 0; i < 100; ++i) {
      await page.keyboard.press('ArrowRight');
      await sleep(12);
    }
    const found = await page.evaluate(() => {
      const {latencies, termsDrawn} = window.haarlightView.engine;
      return {latencies, termsDrawn};
    });
    console.log(`${path.basename(file)}, turn: quick weights of an angle ${told(asked)} ms; ` +
      `movement to picture ${told(found.latencies)} ms, ${quantile(found.termsDrawn, 0.5)} terms meanwhile; ` +
      `load ${os.loadavg()[0].toFixed(1)}`);
  });
}

/** Raising and lowering the receiver under some light, then its exact picture. @param light  set in the page */
async function measureReceiver(file, name, light) {
  await viewing(file, async page => {
    await page.locator('#show-receiver').click();
    await page.evaluate(() => window.haarlightView.receiver.opened);
    await light(page);
    await page.evaluate(() => window.haarlightView.receiver.engine.settled());
    await page.locator('#receiver').focus();
    await page.evaluate(() => (window.haarlightView.receiver.engine.latencies = []));
    for (let i = 0; i < 100; ++i) {
      await page.keyboard.press(i % 40 < 20 ? 'ArrowDown' : 'ArrowUp');
      await sleep(12);
    }
    const meanwhile = await page.locator('#receiver-facts').innerText();
    const latencies = await page.evaluate(() => window.haarlightView.receiver.engine.latencies);
    const moved = performance.now();
    await page.evaluate(() => window.haarlightView.receiver.engine.settled());
    const rest = performance.now() - moved;
    console.log(`${path.basename(file)}, receiver under ${name}: movement to picture ${told(latencies)} ms; meanwhile: ${meanwhile} ` +
      `Exact ${(rest / 1000).toFixed(2)} s after the last movement; load ${os.loadavg()[0].toFixed(1)}`);
  });
}

/** Lights of weight 1. */
const lightsOn = list => page => page.evaluate(on => {
  const {receiver, basis} = window.haarlightView;
  const weights = new Float64Array(basis.nLights);
  on.forEach(k => (weights[k % basis.nLights] = 1));
  receiver.setWeights([weights]);
}, list);

const demo = option('--demo', path.join(source, 'out/demo/biplane.hlb'));
if (!fs.existsSync(demo)) {
  throw new Error(`no ${demo}: run ./demo, or give --demo`);
}
const parts = {
  start: async () => measureStart(demo),
  frames: async () => {
    await measureFrames(dense(256), 64, 'processor');
    await measureFrames(dense(256), 64, 'graphics');
  },
  drag: async () => {
    await measureDrag(demo, 'move');
    await measureDrag(dense(512), 'move');
    await measureDrag(dense(512), 'paint');
  },
  receiver: async () => {
    await measureReceiver(demo, 'one light', lightsOn([528]));
    await measureReceiver(demo, 'nine lights', lightsOn(Array.from({length: 9}, (_, i) => 100 + 90 * i)));
    await measureReceiver(demo, 'a room', async page => {
      await page.locator('#environment-file').setInputFiles(path.join(source, 'configs/environments/room.hdr'));
      await page.waitForFunction(() => window.haarlightView.environment?.isExact);
    });
  },
  turn: async () => {
    await measureTurn(demo);
    await measureTurn(dense(512));
  },
};
for (const [name, part] of Object.entries(parts)) {
  if (!only || only === name) {
    await part();
  }
}
await browser.end();
for (const problem of browser.problems) {
  console.log(`PROBLEM ${problem}`);
}
