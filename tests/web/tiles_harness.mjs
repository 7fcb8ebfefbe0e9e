// Pictures lit by direction of any size, and what their tiles show at full size against the command's PNG.

import fs from 'node:fs';
import {expect} from './harness.mjs';

/** Numbers that repeat from run to run. */
function dice(seed) {
  let state = seed;
  return () => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0) / 2 ** 32;
}

/** Coefficients of a wavy surface with grain, in three colours: a PTM, written row by row. */
export function writeWaves(file, width, height) {
  const out = fs.openSync(file, 'w');
  fs.writeSync(out, `PTM_1.2\nPTM_FORMAT_RGB\n${width}\n${height}\n0.5 0.5 0.5 0.5 0.5 1 \n128 128 128 128 128 0 \n`);
  const draw = dice(3);
  const row = Buffer.alloc(6 * width);
  for (let c = 0; c < 3; ++c) {
    for (let y = 0; y < height; ++y) {
      const [b, d] = [110 + 20 * Math.cos(y / 7), 128 + 90 * Math.cos(y / 23)];
      for (let x = 0; x < width; ++x) {
        const at = 6 * x;
        const grain = 30 * draw();
        row[at] = 110 + 20 * Math.sin(x / 9);
        row[at + 1] = b;
        row[at + 2] = 128 + grain / 3;
        row[at + 3] = 128 + 90 * Math.sin(x / 31 + c);
        row[at + 4] = d;
        row[at + 5] = 110 + 20 * c + grain + (x + y) % 17;
      }
      fs.writeSync(out, row);
    }
  }
  fs.closeSync(out);
  return file;
}

/**
 * How what the canvas shows at 100 % differs from the same part of a PNG, in codes of 255.
 * @return  {worst, pixels}: of how many pixels
 */
export async function compareFullPixels(page, url) {
  const found = await page.evaluate(async address => {
    const image = new Image();
    image.src = address;
    await image.decode();
    const {renderer} = window.haarlightView;
    if (renderer.scale !== 1) {
      return {problem: `the scale is ${renderer.scale}`};
    }
    const {width, height, data} = renderer.pixels();
    const [left, top] = renderer.origin;
    const [x0, y0] = [Math.max(0, left), Math.max(0, top)];
    const [x1, y1] = [Math.min(width, left + image.naturalWidth), Math.min(height, top + image.naturalHeight)];
    if (image.naturalWidth !== renderer.width || image.naturalHeight !== renderer.height) {
      return {problem: `${renderer.width} x ${renderer.height}, not ${image.naturalWidth} x ${image.naturalHeight}`};
    }
    const bitmap = await createImageBitmap(image, x0 - left, y0 - top, x1 - x0, y1 - y0,
                                           {colorSpaceConversion: 'none', premultiplyAlpha: 'none'});
    const scratch = new OffscreenCanvas(x1 - x0, y1 - y0);
    const context = scratch.getContext('2d');
    context.drawImage(bitmap, 0, 0);
    const truth = context.getImageData(0, 0, x1 - x0, y1 - y0).data;
    let [worst, lit] = [0, 0];
    for (let y = y0; y < y1; ++y) {
      for (let x = x0; x < x1; ++x) {
        for (let c = 0; c < 3; ++c) {
          const is = data[4 * (y * width + x) + c];
          const should = truth[4 * ((y - y0) * (x1 - x0) + x - x0) + c];
          worst = Math.max(worst, Math.abs(is - should));
          lit += should > 20 ? 1 : 0;
        }
      }
    }
    const pixels = (x1 - x0) * (y1 - y0);
    return {worst, pixels, lit: lit / (3 * pixels)};
  }, url);
  expect(!found.problem, found.problem);
  expect(found.lit > 0.2, `the truth is dark: ${found.lit}`);
  return found;
}
