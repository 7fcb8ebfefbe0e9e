// SPDX-License-Identifier: Apache-2.0
// A picture with clipping marked. The daemon sends an indexed PNG: greys, and two colours that
// stand for "saturated" (red) and "at or below black" (blue) exactly.

const kSaturated = [255, 32, 32];
const kBlack = [30, 80, 255];
const isColour = (data, i, colour) =>
  data[i] === colour[0] && data[i + 1] === colour[1] && data[i + 2] === colour[2];

export class Picture {
  constructor(canvas, clippingBox, gainSlider, gainText) {
    this.canvas = canvas;
    this.clippingBox = clippingBox;
    this.gainSlider = gainSlider;
    this.gainText = gainText;
    this.pixels = null;
    for (const input of [clippingBox, gainSlider]) {
      input.addEventListener('input', () => this.draw());
    }
  }

  /** @param blob  the daemon's PNG */
  async show(blob) {
    const bitmap = await createImageBitmap(blob, {colorSpaceConversion: 'none'});
    const scratch = new OffscreenCanvas(bitmap.width, bitmap.height);
    const context = scratch.getContext('2d', {willReadFrequently: true});
    context.drawImage(bitmap, 0, 0);
    bitmap.close();
    this.pixels = context.getImageData(0, 0, scratch.width, scratch.height);
    this.draw();
  }

  clear() {
    this.pixels = null;
    this.canvas.width = 4;
    this.canvas.height = 3;
  }

  draw() {
    const stops = Number(this.gainSlider.value);
    this.gainText.textContent = `×${Number((2 ** stops).toFixed(1))}`;
    if (!this.pixels) {
      return;
    }
    const {width, height, data} = this.pixels;
    // Brightening acts on light, not on code values: x2.4 on the curve's exponent.
    const gain = 2 ** (stops / 2.4);
    const marks = this.clippingBox.checked;
    const out = new ImageData(width, height);
    const stripe = Math.max(2, Math.round(width / 160));
    for (let y = 0, i = 0; y < height; ++y) {
      for (let x = 0; x < width; ++x, i += 4) {
        let [r, g, b] = [data[i], data[i + 1], data[i + 2]];
        if (isColour(data, i, kSaturated)) {
          if (!marks) {
            r = g = b = 255;
          } else if (Math.floor((x + y) / stripe) % 2) {
            [r, g, b] = [70, 0, 0];
          }
        } else if (isColour(data, i, kBlack)) {
          if (!marks) {
            r = g = b = 0;
          }
        } else {
          r = g = b = Math.min(255, r * gain);
        }
        out.data[i] = r;
        out.data[i + 1] = g;
        out.data[i + 2] = b;
        out.data[i + 3] = 255;
      }
    }
    this.canvas.width = width;
    this.canvas.height = height;
    this.canvas.parentElement.classList.toggle('small', width < 300);
    this.canvas.getContext('2d').putImageData(out, 0, 0);
  }
}
