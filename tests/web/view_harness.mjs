// A viewer's server and page for tests and benchmarks of it, and pictures made by the command.

import {execFileSync, spawn} from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import {expect} from './harness.mjs';

const children = new Set();
process.on('exit', () => children.forEach(child => child.kill('SIGKILL')));  // also after a failure

/** `haarlight view` on a basis file; `words`: more of its command line. */
export class Viewer {
  constructor(programs) {
    this.program = path.join(programs, 'haarlight/haarlight');
  }

  async begin(file, words = []) {
    this.file = file;
    this.begun = performance.now();
    this.process = spawn(this.program, ['view', file, ...words], {stdio: ['ignore', 'pipe', 'pipe']});
    children.add(this.process);
    this.process.once('exit', () => children.delete(this.process));
    let [said, problem] = ['', ''];
    this.process.stderr.on('data', text => (problem += text));
    this.url = await new Promise((resolve, reject) => {
      this.process.stdout.on('data', text => {
        said += text;
        const found = /on (http:\S+)\//.exec(said);
        if (found) {
          resolve(found[1]);
        }
      });
      this.process.once('exit', code => reject(new Error(`haarlight view ended with ${code}: ${problem}`)));
    });
    return this;
  }

  /** @return  its exit code */
  async end(signal = 'SIGINT') {
    if (this.process.exitCode === null && this.process.signalCode === null) {
      const ended = new Promise(resolve => this.process.once('exit', resolve));
      this.process.kill(signal);
      await ended;
    }
    return this.process.exitCode;
  }
}

/** Loaded, and everything on the canvas. */
export const settled = page => page.evaluate(async () => {
  await window.haarlightView.begun;
  await window.haarlightView.engine.settled();
});

/** The command's PNG of the same light. @return  a data URL */
export function relight(program, file, words, folder) {
  const out = path.join(folder, 'relit.png');
  const said = execFileSync(program, ['relight', file, ...words, '-o', out, '--force',
                                      '--report', path.join(folder, 'relit.json')], {encoding: 'utf8'});
  const report = JSON.parse(fs.readFileSync(path.join(folder, 'relit.json'), 'utf8'));
  return {url: `data:image/png;base64,${fs.readFileSync(out).toString('base64')}`, said, report};
}

/** How the canvas differs from a PNG: {worst, different} in codes of 255 and values. */
export async function compareWithPng(page, url) {
  const found = await page.evaluate(async address => {
    const image = new Image();
    image.src = address;
    await image.decode();
    const bitmap = await createImageBitmap(image, {colorSpaceConversion: 'none', premultiplyAlpha: 'none'});
    const scratch = new OffscreenCanvas(bitmap.width, bitmap.height);
    const context = scratch.getContext('2d');
    context.drawImage(bitmap, 0, 0);
    const truth = context.getImageData(0, 0, bitmap.width, bitmap.height).data;
    const {width, height, data} = window.haarlightView.renderer.pixels();
    if (width !== bitmap.width || height !== bitmap.height) {
      return {size: `${width} x ${height}, not ${bitmap.width} x ${bitmap.height}`};
    }
    let [worst, different, lit] = [0, 0, 0];
    for (let i = 0; i < data.length; ++i) {
      const difference = Math.abs(data[i] - truth[i]);
      worst = Math.max(worst, difference);
      different += difference > 0 ? 1 : 0;
      lit += i % 4 !== 3 && truth[i] > 20 ? 1 : 0;
    }
    return {worst, share: different / (0.75 * data.length), lit: lit / (0.75 * data.length)};
  }, url);
  expect(!found.size, `the canvas is ${found.size}`);
  expect(found.lit > 0.2, `the truth is dark: ${found.lit}`);
  return found;
}
