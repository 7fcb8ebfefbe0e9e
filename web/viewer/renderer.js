// SPDX-License-Identifier: Apache-2.0
// Sums of pictures, and how they are shown.
//
// A sum is a texture of floats, output channels one below the other: pages where the graphics
// processor makes it (graphics_sums.js), the picture's rows where the processor does
// (processor_sums.js). A second pass turns sums into the display's values as the command's PNGs have
// them: times the exposure, sRGB, 8 bits. The processor does that too, but for differences.

import {NoGraphics, isSoftware, link} from './graphics.js';
import {GraphicsSums} from './graphics_sums.js';
import {Budget} from './page_store.js';
import {ProcessorSums} from './processor_sums.js';

const kShowVertex = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0, 0.0, 1.0);
}`;

// A pixel of a sum of pages. Its tile comes from a multiplication, exact below 2^22 pixels by the
// half that is added.
const kPagedValue = `
uniform ivec4 layout_;   // tile's side, page's texels across and down, rows of a channel
uniform float perTile;   // 1 / tile's side
float valueAt(sampler2D sum, ivec2 at, int channel) {
  ivec2 tile = ivec2((vec2(at) + 0.5) * perTile);
  ivec2 inside = at - tile * layout_.x;
  vec4 four = texelFetch(sum, tile * layout_.yz + ivec2(inside.x >> 2, inside.y + channel * layout_.w), 0);
  vec2 two = (inside.x & 2) == 0 ? four.xy : four.zw;
  return (inside.x & 1) == 0 ? two.x : two.y;
}`;

const kPlainValue = `
float valueAt(sampler2D sum, ivec2 at, int channel) {
  return texelFetch(sum, at + ivec2(0, channel * (lastRow + 1)), 0).x;
}`;

const kBytesFragment = `#version 300 es
precision highp float;
precision highp int;
uniform sampler2D first;
uniform ivec2 corner;
uniform int lastRow;
out vec4 colour;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) - corner;
  colour = vec4(texelFetch(first, ivec2(at.x, lastRow - at.y), 0).rgb, 1.0);
}`;

// One program for each number of channels, for pictures and for differences: software GL computes
// both sides of a condition.
const showFragment = (isPaged, channels, isDifference) => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D first;
uniform sampler2D second;
uniform ivec2 corner;    // of the panel, from the canvas's lower left
uniform int lastRow;     // of the picture
uniform float exposure;
uniform float amplify;   // of the difference
out vec4 colour;
${isPaged ? kPagedValue : kPlainValue}
float curve(sampler2D sum, ivec2 at, int channel) {
  float v = clamp(valueAt(sum, at, channel) * exposure, 0.0, 1.0);
  return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1.0 / 2.4) - 0.055;
}
vec3 displayOf(sampler2D sum, ivec2 at) {
  return vec3(${(channels === 1 ? [0] : [0, 1, 2]).map(c => `curve(sum, at, ${c})`).join(', ')});
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) - corner;
  at.y = lastRow - at.y;
  vec3 shown = displayOf(first, at);
  ${isDifference ? 'shown = 0.5 + amplify * (shown - displayOf(second, at));' : ''}
  colour = vec4(shown, 1.0);
}`;

export class Renderer {
  /**
   * @param sums  who makes them: graphics, processor, or else what suits the machine
   * @throws NoGraphics
   */
  constructor(canvas, basis, sums) {
    this.canvas = canvas;
    this.basis = basis;
    const gl = canvas.getContext('webgl2', {alpha: false, antialias: false, depth: false,
                                             preserveDrawingBuffer: true, powerPreference: 'high-performance'});
    if (!gl) {
      throw new NoGraphics('This browser offers no WebGL 2, which the page computes with.');
    }
    if (!gl.getExtension('EXT_color_buffer_float')) {
      throw new NoGraphics('This graphics processor cannot draw into textures of floats (EXT_color_buffer_float).');
    }
    this.gl = gl;
    const {side} = basis.about;
    this.pageAcross = side / 4;
    this.pageDown = side;
    this.pageTexels = this.pageAcross * this.pageDown;
    const largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (Math.max(basis.width, basis.tilesX * this.pageAcross, 3 * basis.tilesY * side) > largest) {
      throw new NoGraphics(`The picture of ${basis.width} x ${basis.height} pixels is larger than this ` +
        `graphics processor's textures of ${largest}.`);
    }
    this.isOnProcessor = sums === 'processor' || (sums !== 'graphics' && isSoftware(gl));
    this.sums = new (this.isOnProcessor ? ProcessorSums : GraphicsSums)(gl, basis, new Budget(basis.about.texture_bytes));
    this.showing = new Map();  // by channels and difference
    this.onePixel = new Uint8Array(4);
  }

  get stores() {
    return this.sums.stores;
  }

  /** A texture for a sum of up to three channels. */
  makeSum() {
    const {gl} = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return {texture, channels: 0};
  }

  /**
   * Sums a job's pictures.
   * @param job  one {channel, pictures, factors, polynomials} per output channel
   * @param first, last  units [first, last) of tile + output channel * tiles; all, if left out
   */
  sum(sum, job, first = 0, last = job.length * this.basis.nTiles) {
    if (sum.channels !== job.length) {
      this.sums.shape(sum, job.length);
      sum.channels = job.length;
    }
    this.sums.sum(sum, job, first, last);
  }

  /** Pages that a job's sums read, the plate not counted: what they cost. */
  cost(job) {
    let pages = 0;
    for (const {channel, pictures} of job) {
      const {pagesOf} = this.basis.pages[channel];
      for (const picture of pictures) {
        pages += pagesOf[picture];
      }
    }
    return pages;
  }

  /** Waits until everything requested is drawn. */
  finish() {
    const {gl} = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, this.onePixel);
  }

  /** A sum's values, each pixel and channel once, of every `step`-th row; in no order. */
  read(sum, step = 1) {
    return this.sums.read(sum, step);
  }

  /**
   * Shows sums beside or below one another.
   * @param panels  {first, second, amplify} each: amplify 0 shows `first`, else their difference
   */
  show(panels, exposure, isStacked) {
    const {gl, canvas, basis} = this;
    const {width, height} = basis;
    const [w, h] = isStacked ? [width, height * panels.length] : [width * panels.length, height];
    if (canvas.width !== w || canvas.height !== h) {
      canvas.width = w;
      canvas.height = h;
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    panels.forEach(({first, second, amplify}, i) => {
      const [left, top] = isStacked ? [0, i * height] : [i * width, 0];
      const isOfBytes = this.isOnProcessor && amplify === 0;
      gl.activeTexture(gl.TEXTURE0);
      if (isOfBytes) {
        this.sums.loadDisplay(first, exposure);
      } else if (this.isOnProcessor) {
        this.sums.load(first);
        this.sums.load(second);
      }
      const {program, uniforms} = this.programToShow(first.channels, isOfBytes, amplify > 0);
      gl.useProgram(program);
      gl.uniform1i(uniforms.first, 0);
      if (!this.isOnProcessor) {
        gl.uniform4i(uniforms.layout_, basis.about.tile, this.pageAcross, this.pageDown, basis.tilesY * this.pageDown);
        gl.uniform1f(uniforms.perTile, 1 / basis.about.tile);
      }
      gl.uniform1i(uniforms.lastRow, height - 1);
      gl.uniform1f(uniforms.exposure, exposure);
      gl.uniform2i(uniforms.corner, left, h - top - height);
      if (amplify > 0) {
        gl.uniform1i(uniforms.second, 1);
        gl.uniform1f(uniforms.amplify, amplify);
        gl.activeTexture(gl.TEXTURE1);
        gl.bindTexture(gl.TEXTURE_2D, second.texture);
      }
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, first.texture);
      gl.viewport(left, h - top - height, width, height);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    });
  }

  programToShow(channels, isOfBytes, isDifference) {
    const key = isOfBytes ? 'bytes' : `${channels} ${isDifference}`;
    if (!this.showing.has(key)) {
      this.showing.set(key, link(this.gl, kShowVertex,
        isOfBytes ? kBytesFragment : showFragment(!this.isOnProcessor, channels, isDifference)));
    }
    return this.showing.get(key);
  }

  /** What the canvas shows, 4 bytes per pixel, from the upper left. */
  pixels() {
    const {gl, canvas} = this;
    const {width, height} = canvas;
    const upward = new Uint8Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upward);
    const downward = new Uint8ClampedArray(upward.length);
    for (let y = 0; y < height; ++y) {
      downward.set(upward.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
    }
    return {width, height, data: downward};
  }
}
