// SPDX-License-Identifier: Apache-2.0
// Sums of pictures on the graphics processor.
//
// One instanced square per tile and output channel goes through the list of its pages and factors, and
// adds the clean plate: the pixels' gains times a polynomial of the position in the tile (docs/reference/basis-format.md).

import {link} from './graphics.js';
import {PageStore, kColumnBits, kLayerBits} from './page_store.js';

const kSumVertex = `#version 300 es
layout(location = 0) in ivec4 place;  // tile's column and row, output channel, page of shifts or -1
layout(location = 1) in ivec4 runs;   // of the list: pictures' begin and end, gains' begin and end
uniform ivec3 tiles;                  // columns, rows, output channels
uniform ivec2 page;                   // texels across and down
uniform ivec3 picture;                // width, height, tile's side
flat out ivec2 origin;
flat out ivec4 run;
flat out int shifts;
flat out ivec2 size;                  // of the tile
void main() {
  origin = ivec2(place.x, place.z * tiles.y + place.y) * page;
  run = runs;
  shifts = place.w;
  size = min(picture.zz, picture.xy - place.xy * picture.z);
  vec2 corner = vec2(origin + ivec2(gl_VertexID & 1, gl_VertexID >> 1) * page);
  gl_Position = vec4(2.0 * corner / vec2(tiles.x * page.x, tiles.y * tiles.z * page.y) - 1.0, 0.0, 1.0);
}`;

const sumFragment = isInteger => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;
precision highp isampler2DArray;
uniform ${isInteger ? 'isampler2DArray' : 'sampler2DArray'} pages;
uniform isampler2DArray gains;
uniform sampler2D list;  // a texel: page and factor, page and factor; after the gains their polynomial
uniform ivec2 page;
uniform int plateSide;   // degree of the polynomial + 1
uniform float step_;
flat in ivec2 origin;
flat in ivec4 run;
flat in int shifts;
flat in ivec2 size;
out vec4 sum;
int texel;
vec4 listed(int i) {
  return texelFetch(list, ivec2(i & 1023, i >> 10), 0);
}
ivec3 placeOf(int number) {
  int at = number * (page.x * page.y) + texel;
  return ivec3(at & ${(1 << kColumnBits) - 1}, (at >> ${kColumnBits}) & ${(1 << (kLayerBits - kColumnBits)) - 1},
               at >> ${kLayerBits});
}
// sum over a, b of coefficient[b][a] T_a(x) T_b(y), four coefficients of a row in a texel of the list
vec4 polynomial(int from, int n, vec4 x, float y) {
  vec4 all = vec4(0.0);
  vec2 t = vec2(1.0, y);
  for (int b = 0; b < n; ++b) {
    vec4 row = vec4(0.0);
    vec4 even = vec4(1.0);
    vec4 odd = x;
    for (int a = 0; a < n; a += 4) {
      vec4 four = listed(from++);
      row += four.x * even + four.y * odd;
      even = 2.0 * x * odd - even;
      odd = 2.0 * x * even - odd;
      row += four.z * even + four.w * odd;
      even = 2.0 * x * odd - even;
      odd = 2.0 * x * even - odd;
    }
    all += t.x * row;
    t = vec2(t.y, 2.0 * y * t.y - t.x);
  }
  return all;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) - origin;
  texel = at.y * page.x + at.x;
  vec4 s = vec4(0.0);
  for (int i = run.x; i < run.y; ++i) {
    vec4 pair = listed(i);
    s += pair.y * vec4(texelFetch(pages, placeOf(int(pair.x)), 0));
    s += pair.w * vec4(texelFetch(pages, placeOf(int(pair.z)), 0));
  }
  s *= step_;
  for (int i = shifts; i >= 0; i = -1) {  // a loop: software GL runs an if's inside in any case
    s *= exp2(-vec4(texelFetch(pages, placeOf(i), 0)));
  }
  vec4 gain = vec4(0.0);
  for (int i = run.z; i < run.w; ++i) {
    vec4 pair = listed(i);
    gain += pair.y * vec4(texelFetch(gains, placeOf(int(pair.x)), 0));
    gain += pair.w * vec4(texelFetch(gains, placeOf(int(pair.z)), 0));
  }
  vec4 x = vec4(8 * at.x) + vec4(1.0, 3.0, 5.0, 7.0);
  sum = s + gain * polynomial(run.w, run.w > run.z ? plateSide : 0, x / float(size.x) - 1.0,
                              float(2 * at.y + 1) / float(size.y) - 1.0);
}`;

const kFirst = Int32Array.of(0);  // the one picture of gains
const kOnce = Float64Array.of(1);

/** Numbers that grow in place. */
class Growing {
  constructor(Type, size) {
    this.values = new Type(size);
    this.n = 0;
  }

  room(more) {
    if (this.n + more > this.values.length) {
      const larger = new this.values.constructor(Math.max(2 * this.values.length, this.n + more));
      larger.set(this.values.subarray(0, this.n));
      this.values = larger;
    }
  }
}

export class GraphicsSums {
  constructor(gl, basis, budget) {
    Object.assign(this, {gl, basis});
    const {side} = basis.about;
    this.pageAcross = side / 4;
    this.pageDown = side;
    this.sumWidth = basis.tilesX * this.pageAcross;
    this.sumRows = basis.tilesY * this.pageDown;
    this.largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const texels = this.pageAcross * this.pageDown;
    this.stores = {
      small: new PageStore(gl, basis.isLossless ? 'half' : 'int8', texels, budget),
      gains: new PageStore(gl, 'int16', texels, budget),
    };
    this.summing = link(gl, kSumVertex, sumFragment(!basis.isLossless));
    this.list = new Growing(Float32Array, 4096);
    this.instances = new Growing(Int32Array, 1024);
    this.readBuffer = new Float32Array(0);
    this.listTexture = gl.createTexture();
    this.listRows = 0;
    this.frame = gl.createFramebuffer();
    this.instanceBuffer = gl.createBuffer();
    this.sumArray = gl.createVertexArray();
    gl.bindVertexArray(this.sumArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.instanceBuffer);
    for (const location of [0, 1]) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribIPointer(location, 4, gl.INT, 32, 16 * location);
      gl.vertexAttribDivisor(location, 1);
    }
    gl.bindVertexArray(null);
  }

  /** Appends pairs (page, factor), an even number of them. @return  [begin, end) in texels */
  addRun(table, tile, pictures, factors, base) {
    const {entries, nTiles} = table;
    const {list} = this;
    const begin = list.n / 4;
    list.room(16 * pictures.length + 4);
    const {values} = list;
    let {n} = list;
    for (let i = 0; i < pictures.length; ++i) {
      const entry = entries[pictures[i] * nTiles + tile];
      if (entry >= 0) {
        let factor = factors[pictures[i]];
        for (let page = entry >> 3, digits = entry & 7; digits >= 0; --digits, ++page, factor *= base) {
          values[n++] = page;
          values[n++] = factor;
        }
      }
    }
    if (n % 4 !== 0) {
      values[n++] = 0;
      values[n++] = 0;
    }
    list.n = n;
    return [begin, n / 4];
  }

  /** Appends a tile's polynomial, each of its rows filled up to whole texels. */
  addPolynomial(polynomials, tile) {
    const side = this.basis.plateSide;
    const across = 4 * Math.ceil(side / 4);
    const {list} = this;
    list.room(across * side);
    list.values.fill(0, list.n, list.n + across * side);
    for (let row = 0; row < side; ++row, list.n += across) {
      const from = (tile * side + row) * side;
      list.values.set(polynomials.subarray(from, from + side), list.n);
    }
  }

  /**
   * Gives a sum so many channels: pages, four neighbouring pixels of a row in a texel, tiles side by
   * side as in the picture, channels one below the other.
   */
  shape(sum, channels) {
    const {gl, sumWidth, sumRows} = this;
    gl.bindTexture(gl.TEXTURE_2D, sum.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, sumWidth, sumRows * channels, 0, gl.RGBA, gl.FLOAT, null);
  }

  /** As Renderer.sum() says, into sum's texture. */
  sum(sum, job, first, last) {
    const {gl, basis, list, instances, summing} = this;
    list.n = 0;
    instances.n = 0;
    instances.room(8 * (last - first));
    for (let unit = first; unit < last; ++unit) {
      const out = Math.floor(unit / basis.nTiles);
      const tile = unit % basis.nTiles;
      const {channel, pictures, factors, polynomials} = job[out];
      const [a, b] = this.addRun(basis.pages[channel], tile, pictures, factors, 256);
      const [c, d] = polynomials ? this.addRun(basis.gains[channel], tile, kFirst, kOnce, 65536) : [0, 0];
      if (d > c) {
        this.addPolynomial(polynomials, tile);
      }
      const shifts = basis.shifts[channel].entries[tile];
      instances.values.set([tile % basis.tilesX, Math.floor(tile / basis.tilesX), out, shifts < 0 ? -1 : shifts >> 3,
                            a, b, c, d], instances.n);
      instances.n += 8;
    }
    gl.activeTexture(gl.TEXTURE2);
    this.uploadList();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.stores.small.texture);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.stores.gains.texture);
    gl.useProgram(summing.program);
    gl.uniform1i(summing.uniforms.pages, 0);
    gl.uniform1i(summing.uniforms.gains, 1);
    gl.uniform1i(summing.uniforms.list, 2);
    gl.uniform3i(summing.uniforms.tiles, basis.tilesX, basis.tilesY, job.length);
    gl.uniform2i(summing.uniforms.page, this.pageAcross, this.pageDown);
    gl.uniform3i(summing.uniforms.picture, basis.width, basis.height, basis.about.tile);
    gl.uniform1i(summing.uniforms.plateSide, basis.plateSide);
    gl.uniform1f(summing.uniforms.step_, basis.step);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, sum.texture, 0);
    gl.viewport(0, 0, this.sumWidth, this.sumRows * job.length);
    gl.bindVertexArray(this.sumArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.instanceBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, instances.values.subarray(0, instances.n), gl.STREAM_DRAW);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, last - first);
    gl.bindVertexArray(null);
  }

  uploadList() {
    const {gl, list} = this;
    gl.bindTexture(gl.TEXTURE_2D, this.listTexture);
    const rows = Math.max(1, Math.ceil(list.n / 4096));
    list.room(rows * 4096 - list.n);
    if (rows > this.listRows) {
      this.listRows = Math.min(2 * rows, this.largest);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 1024, this.listRows, 0, gl.RGBA, gl.FLOAT, null);
    }
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 1024, rows, gl.RGBA, gl.FLOAT, list.values);
  }

  /** As Renderer.read() says. */
  read(sum, step) {
    const {gl, basis, sumWidth, sumRows} = this;
    const n = 4 * sumWidth * sumRows * sum.channels;
    if (this.readBuffer.length !== n) {
      this.readBuffer = new Float32Array(n);
    }
    const all = this.readBuffer;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, sum.texture, 0);
    gl.readPixels(0, 0, sumWidth, sumRows * sum.channels, gl.RGBA, gl.FLOAT, all);
    const {tile, side} = basis.about;
    const across = 4 * sumWidth;
    const values = new Float32Array(basis.width * Math.ceil(basis.height / step) * sum.channels);
    let at = 0;
    for (let channel = 0; channel < sum.channels; ++channel) {
      for (let y = 0; y < basis.height; y += step) {
        const row = (channel * sumRows + Math.floor(y / tile) * side + y % tile) * across;
        for (let x = 0; x < basis.width; x += tile) {
          const from = row + x / tile * side;
          const part = Math.min(tile, basis.width - x);
          values.set(all.subarray(from, from + part), at);
          at += part;
        }
      }
    }
    return values;
  }
}
