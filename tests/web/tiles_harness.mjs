// Pictures of published tiles, at full size, against the command's PNG.

import {expect} from './harness.mjs';

/**
 * How what the canvas shows at 100 % differs from the same part of a PNG, in codes of 255.
 * @return  {worst, pixels}: of how many pixels
 */
export async function compareFullPixels(page, url) {
  const found = await page.evaluate(async address => {
    const image = new Image();
    image.src = address;
    await image.decode();
    const bitmap = await createImageBitmap(image, {colorSpaceConversion: 'none', premultiplyAlpha: 'none'});
    const {renderer} = window.haarlightView;
    if (renderer.scale !== 1) {
      return {problem: `the scale is ${renderer.scale}`};
    }
    const {width, height, data} = renderer.pixels();
    const [left, top] = renderer.origin;
    const [x0, y0] = [Math.max(0, left), Math.max(0, top)];
    const [x1, y1] = [Math.min(width, left + bitmap.width), Math.min(height, top + bitmap.height)];
    if (bitmap.width !== renderer.width || bitmap.height !== renderer.height) {
      return {problem: `${renderer.width} x ${renderer.height}, not ${bitmap.width} x ${bitmap.height}`};
    }
    const scratch = new OffscreenCanvas(x1 - x0, y1 - y0);
    const context = scratch.getContext('2d');
    context.drawImage(bitmap, left - x0, top - y0);
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
