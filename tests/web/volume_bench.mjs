// How fast a volume turns in the browser: from the movement to the picture, and from the last movement to the exact
// picture, of cube.toml and of a mesh of 196 608 tetrahedra. scripts/page_test BUILD --bench-volume runs it.

import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import {Browser} from './harness.mjs';
import {Viewer, settled} from './view_harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const folder = path.join(out, 'volume');
fs.mkdirSync(folder, {recursive: true});
const kSide = 32;  // cells along each edge, six tetrahedra each
const kMoves = 40;

/** A cube of kSide³ boxes in six tetrahedra each (Kuhn), with a field that is no plane. */
function writeMesh(file) {
  const n = kSide + 1;
  const [points, field, cells] = [[], [], []];
  for (let z = 0; z < n; ++z) {
    for (let y = 0; y < n; ++y) {
      for (let x = 0; x < n; ++x) {
        const p = [x, y, z].map(v => v / kSide);
        points.push(p.join(' '));
        field.push((p[0] + p[1] + p[2] + 0.3 * Math.sin(9 * p[0]) * Math.sin(9 * p[1]) * Math.sin(9 * p[2])) / 3);
      }
    }
  }
  const steps = [1, n, n * n];
  const orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
  for (let z = 0; z < kSide; ++z) {
    for (let y = 0; y < kSide; ++y) {
      for (let x = 0; x < kSide; ++x) {
        const at = x + n * (y + n * z);
        orders.forEach(([a, b], i) => {
          const corners = [at, at + steps[a], at + steps[a] + steps[b], at + n * n + n + 1];
          cells.push((i < 3 ? corners : [corners[1], corners[0], corners[2], corners[3]]).join(' '));
        });
      }
    }
  }
  fs.writeFileSync(file, `# vtk DataFile Version 3.0\ncube\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS ${points.length} double\n` +
    `${points.join('\n')}\nCELLS ${cells.length} ${5 * cells.length}\n${cells.map(c => `4 ${c}`).join('\n')}\n` +
    `CELL_TYPES ${cells.length}\n${'10\n'.repeat(cells.length)}POINT_DATA ${points.length}\nSCALARS linear double 1\n` +
    `LOOKUP_TABLE default\n${field.join('\n')}\n`);
  return cells.length;
}

/** Processor time of a process so far, ms. */
const kTick = 10;  // of /proc, ms
const processorMs = pid => {
  const words = fs.readFileSync(`/proc/${pid}/stat`, 'utf8').split(') ')[1].split(' ');
  return kTick * (Number(words[11]) + Number(words[12]));
};
const middle = values => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];
const at95 = values => [...values].sort((a, b) => a - b)[Math.ceil(0.95 * values.length) - 1];
const text = fs.readFileSync('configs/volumes/cube.toml', 'utf8');
fs.copyFileSync('configs/volumes/cube.vtu', path.join(folder, 'cube.vtu'));
const nCells = writeMesh(path.join(folder, 'many.vtk'));
const browser = await new Browser().begin(modules);
console.log(`${os.cpus().length} cores; load ${os.loadavg()[0].toFixed(1)}`);
for (const [name, mesh] of [['cube.toml', 'cube.vtu'], [`${nCells} tetrahedra`, 'many.vtk']]) {
  for (const side of [300, 512]) {
    const scene = path.join(folder, 'bench.toml');
    fs.writeFileSync(scene, text.replace('cube.vtu', mesh).replace('[256, 256]', `[${side}, ${side}]`));
    const viewer = await new Viewer(programs).begin(scene);
    const page = await browser.page(`${viewer.url}/`);
    await settled(page);
    const exact = await page.evaluate(() => window.haarlightView.shown.facts.seconds);
    const box = await page.locator('#picture').boundingBox();
    await page.mouse.move(box.x + 100, box.y + 100);
    await page.mouse.down();
    await page.evaluate(() => (window.haarlightView.engine.latencies.length = 0));
    const before = processorMs(viewer.process.pid);
    const begun = performance.now();
    for (let i = 0; i < kMoves; ++i) {
      await page.mouse.move(box.x + 100 + 4 * i, box.y + 100 + i);
      await page.waitForTimeout(50);
    }
    const spent = performance.now() - begun;
    const [latencies, shrink] = await page.evaluate(() => {
      const {engine} = window.haarlightView;
      return [[...engine.latencies], engine.shrink];
    });
    const cost = (processorMs(viewer.process.pid) - before) / latencies.length;
    await page.mouse.up();
    const rested = performance.now();
    await settled(page);
    console.log(`${name}, ${side} x ${side}: ${(1000 * latencies.length / spent).toFixed(1)} previews per second, ` +
      `movement to picture ${middle(latencies).toFixed(0)} ms, 95 % within ${at95(latencies).toFixed(0)} ms, ` +
      `${cost.toFixed(0)} ms of processor time each, previews ${shrink} times smaller at the end; the exact picture ${exact.toFixed(2)} s, ` +
      `shown ${((performance.now() - rested) / 1000).toFixed(1)} s after the last movement`);
    await browser.closePages();
    await viewer.end();
  }
}
await browser.end();
