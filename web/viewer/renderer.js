// Sums of pictures on the graphics processor, and how they are shown.
//
// A sum is a texture of floats that holds pages: four neighbouring pixels of a row in a texel, tiles
// side by side as in the picture, output channels one below the other. One instanced square a tile
// and channel goes through the list of its pages and factors. The second pass turns sums into the
// display's values as the command's PNGs have them: times the exposure, sRGB, 8 bits.

import {Budget, PageStore, kColumnBits, kLayerBits} from './page_store.js';

const kSumVertex = `#version 300 es
layout(location = 0) in ivec4 place;  // tile's column and row, output channel, page of shifts or -1
layout(location = 1) in ivec4 runs;   // of the list: pictures' begin and end, plates' begin and end
uniform ivec3 tiles;                  // columns, rows, output channels
uniform ivec2 page;                   // texels across and down
flat out ivec2 origin;
flat out ivec4 run;
flat out int shifts;
void main() {
  origin = ivec2(place.x, place.z * tiles.y + place.y) * page;
  run = runs;
  shifts = place.w;
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
uniform isampler2DArray widePages;
uniform sampler2D list;  // a texel: page and factor, page and factor
uniform ivec2 page;
uniform float step_;
flat in ivec2 origin;
flat in ivec4 run;
flat in int shifts;
out vec4 sum;
int texel;
ivec3 placeOf(int number) {
  int at = number * (page.x * page.y) + texel;
  return ivec3(at & ${(1 << kColumnBits) - 1}, (at >> ${kColumnBits}) & ${(1 << (kLayerBits - kColumnBits)) - 1},
               at >> ${kLayerBits});
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) - origin;
  texel = at.y * page.x + at.x;
  vec4 s = vec4(0.0);
  for (int i = run.x; i < run.y; ++i) {
    vec4 pair = texelFetch(list, ivec2(i & 1023, i >> 10), 0);
    s += pair.y * vec4(texelFetch(pages, placeOf(int(pair.x)), 0));
    s += pair.w * vec4(texelFetch(pages, placeOf(int(pair.z)), 0));
  }
  s *= step_;
  for (int i = shifts; i >= 0; i = -1) {  // a loop: software GL runs an if's inside in any case
    s *= exp2(-vec4(texelFetch(pages, placeOf(i), 0)));
  }
  for (int i = run.z; i < run.w; ++i) {
    vec4 pair = texelFetch(list, ivec2(i & 1023, i >> 10), 0);
    s += pair.y * vec4(texelFetch(widePages, placeOf(int(pair.x)), 0));
    s += pair.w * vec4(texelFetch(widePages, placeOf(int(pair.z)), 0));
  }
  sum = s;
}`;

const kShowVertex = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0, 0.0, 1.0);
}`;

// One program for each number of channels, for pictures and for differences: software GL computes
// both sides of a condition. A pixel's tile comes from a multiplication, exact below 2^22 pixels by
// the half that is added.
const showFragment = (channels, isDifference) => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D first;
uniform sampler2D second;
uniform ivec2 corner;    // of the panel, from the canvas's lower left
uniform ivec4 layout_;   // tile's side, page's texels across and down, rows of a channel
uniform int lastRow;     // of the picture
uniform float perTile;   // 1 / tile's side
uniform float exposure;
uniform float amplify;   // of the difference
out vec4 colour;
float curve(sampler2D sum, ivec2 texel, int place) {
  vec4 four = texelFetch(sum, texel, 0);
  vec2 two = (place & 2) == 0 ? four.xy : four.zw;
  float v = clamp(((place & 1) == 0 ? two.x : two.y) * exposure, 0.0, 1.0);
  return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1.0 / 2.4) - 0.055;
}
vec3 displayOf(sampler2D sum, ivec2 texel, int place) {
  return vec3(${(channels === 1 ? [0] : [0, 1, 2])
    .map(c => `curve(sum, texel + ivec2(0, ${c} * layout_.w), place)`).join(', ')});
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) - corner;
  at.y = lastRow - at.y;
  ivec2 tile = ivec2((vec2(at) + 0.5) * perTile);
  ivec2 inside = at - tile * layout_.x;
  ivec2 texel = tile * layout_.yz + ivec2(inside.x >> 2, inside.y);
  int place = inside.x & 3;
  vec3 shown = displayOf(first, texel, place);
  ${isDifference ? 'shown = 0.5 + amplify * (shown - displayOf(second, texel, place));' : ''}
  colour = vec4(shown, 1.0);
}`;

/** What the browser lacks, in words for the person. */
export class NoGraphics extends Error {}

function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const words = gl.getAttachedShaders(program).map(shader => gl.getShaderInfoLog(shader)).join('\n');
    throw new NoGraphics(`This browser's graphics driver refuses the page's programs: ${words}`);
  }
  const uniforms = {};
  const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) ?? 0;
  for (let i = 0; i < count; ++i) {
    const {name} = gl.getActiveUniform(program, i);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return {program, uniforms};
}

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

export class Renderer {
  /** @throws NoGraphics */
  constructor(canvas, basis) {
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
    this.largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (Math.max(basis.width, basis.tilesX * this.pageAcross, 3 * basis.tilesY * side) > this.largest) {
      throw new NoGraphics(`The picture of ${basis.width} x ${basis.height} pixels is larger than this ` +
        `graphics processor's textures of ${this.largest}.`);
    }
    const budget = new Budget(basis.about.texture_bytes);
    this.stores = {
      small: new PageStore(gl, basis.isLossless ? 'half' : 'int8', this.pageTexels, budget),
      wide: new PageStore(gl, 'int16', this.pageTexels, budget),
    };
    this.summing = link(gl, kSumVertex, sumFragment(!basis.isLossless));
    this.showing = new Map();  // by channels and difference
    this.list = new Growing(Float32Array, 4096);
    this.instances = new Growing(Int32Array, 1024);
    this.onePixel = new Uint8Array(4);
    this.readBuffer = new Float32Array(0);
    this.listTexture = gl.createTexture();
    this.listRows = 0;
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

  /** A texture for a sum of up to three channels. */
  makeSum() {
    const {gl, basis} = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    const [width, height] = [basis.tilesX * this.pageAcross, basis.tilesY * this.pageDown];
    return {texture, width, rows: height, channels: 0, frame: gl.createFramebuffer()};
  }

  shape(sum, channels) {
    const {gl} = this;
    if (sum.channels !== channels) {
      gl.bindTexture(gl.TEXTURE_2D, sum.texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, sum.width, sum.rows * channels, 0, gl.RGBA, gl.FLOAT, null);
      gl.bindFramebuffer(gl.FRAMEBUFFER, sum.frame);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, sum.texture, 0);
      sum.channels = channels;
    }
  }

  /** Pages that a job's sums read, plates not counted: what they cost. */
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

  /** Appends pairs (page, factor), an even number of them. @return  [begin, end) in texels */
  addRun(table, tile, pictures, factors, base, scale) {
    const {entries, nTiles} = table;
    const {list} = this;
    const begin = list.n / 4;
    list.room(16 * pictures.length + 4);
    const {values} = list;
    let {n} = list;
    for (let i = 0; i < pictures.length; ++i) {
      const entry = entries[pictures[i] * nTiles + tile];
      if (entry >= 0) {
        let factor = scale * factors[pictures[i]];
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

  /**
   * Sums a job's pictures.
   * @param job  one {channel, pictures, factors, plate} an output channel
   * @param first, last  units [first, last) of tile + output channel * tiles; all, if left out
   */
  sum(sum, job, first = 0, last = job.length * this.basis.nTiles) {
    const {gl, basis, list, instances, summing} = this;
    this.shape(sum, job.length);
    list.n = 0;
    instances.n = 0;
    instances.room(8 * (last - first));
    for (let unit = first; unit < last; ++unit) {
      const out = Math.floor(unit / basis.nTiles);
      const tile = unit % basis.nTiles;
      const {channel, pictures, factors, plate} = job[out];
      const [a, b] = this.addRun(basis.pages[channel], tile, pictures, factors, 256, 1);
      const [c, d] = basis.hasPlate
        ? this.addRun(basis.plates[channel], tile, basis.plateRange, plate, 65536, basis.about.plate.step) : [0, 0];
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
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.stores.wide.texture);
    gl.useProgram(summing.program);
    gl.uniform1i(summing.uniforms.pages, 0);
    gl.uniform1i(summing.uniforms.widePages, 1);
    gl.uniform1i(summing.uniforms.list, 2);
    gl.uniform3i(summing.uniforms.tiles, basis.tilesX, basis.tilesY, job.length);
    gl.uniform2i(summing.uniforms.page, this.pageAcross, this.pageDown);
    gl.uniform1f(summing.uniforms.step_, basis.isLossless ? basis.about.half_scale : basis.about.step);
    gl.bindFramebuffer(gl.FRAMEBUFFER, sum.frame);
    gl.viewport(0, 0, sum.width, sum.rows * job.length);
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

  /** Waits until everything asked for is drawn. */
  finish() {
    const {gl} = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, this.onePixel);
  }

  /** A sum's values, each pixel and channel once, of every `step`-th row; in no order. */
  read(sum, step = 1) {
    const {gl, basis} = this;
    const n = 4 * sum.width * sum.rows * sum.channels;
    if (this.readBuffer.length !== n) {
      this.readBuffer = new Float32Array(n);
    }
    const all = this.readBuffer;
    gl.bindFramebuffer(gl.FRAMEBUFFER, sum.frame);
    gl.readPixels(0, 0, sum.width, sum.rows * sum.channels, gl.RGBA, gl.FLOAT, all);
    const {tile, side} = basis.about;
    const across = 4 * sum.width;
    const values = new Float32Array(basis.width * Math.ceil(basis.height / step) * sum.channels);
    let at = 0;
    for (let channel = 0; channel < sum.channels; ++channel) {
      for (let y = 0; y < basis.height; y += step) {
        const row = (channel * sum.rows + Math.floor(y / tile) * side + y % tile) * across;
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
      const {program, uniforms} = this.programToShow(first.channels, amplify > 0);
      gl.useProgram(program);
      gl.uniform1i(uniforms.first, 0);
      gl.uniform4i(uniforms.layout_, basis.about.tile, this.pageAcross, this.pageDown, first.rows);
      gl.uniform1i(uniforms.lastRow, height - 1);
      gl.uniform1f(uniforms.perTile, 1 / basis.about.tile);
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

  programToShow(channels, isDifference) {
    const key = `${channels} ${isDifference}`;
    if (!this.showing.has(key)) {
      this.showing.set(key, link(this.gl, kShowVertex, showFragment(channels, isDifference)));
    }
    return this.showing.get(key);
  }

  /** What the canvas shows, 4 bytes a pixel, from the upper left. */
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
