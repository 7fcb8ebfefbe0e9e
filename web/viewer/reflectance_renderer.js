// SPDX-License-Identifier: Apache-2.0
// A picture of 8-bit planes under a light from one direction. How bytes become colours there is a
// linear map that the server computes (include/haarlight/relight/reflectance/formats/reflectance.h, ColourMap); its product with
// every pixel's bytes is formed here.

import {NoGraphics, link} from './graphics.js';

const kSketched = 12;  // lights that the normals are taken from
const kSketchDegrees = [35, 65];  // of them from the zenith, in turn

const kVertex = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0, 0.0, 1.0);
}`;

const kCommon = (layers, isTinted) => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2DArray;
uniform sampler2DArray planes;
uniform vec2 size;      // of the planes
uniform vec2 corner;    // their upper left one, in pixels from the canvas's
uniform float texels;   // of the planes in a pixel of the canvas
uniform float below;    // the canvas's height
uniform bool isSmooth;  // between texels
${isTinted ? `uniform vec4 tint[${3 * layers}];  // layer by layer: R, G, B
uniform vec3 tintAdded;` : ''}
vec3 times(vec4 bytes, vec4 r, vec4 g, vec4 b) {
  return vec3(dot(bytes, r), dot(bytes, g), dot(bytes, b));
}
float linear(float v) {
  return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}
vec3 linear3(vec3 v) { return vec3(linear(v.r), linear(v.g), linear(v.b)); }
float coded(float v) {
  return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1.0 / 2.4) - 0.055;
}
vec3 coded3(vec3 v) { return vec3(coded(v.r), coded(v.g), coded(v.b)); }
vec2 place() { return (vec2(gl_FragCoord.x, below - gl_FragCoord.y) - corner) * texels; }
vec2 sampled(vec2 at) { return (isSmooth ? at : floor(at) + 0.5) / size; }
/** Of the textures of normals, whose rows run upwards. */
ivec2 normalAt(vec2 at) {
  ivec2 cell = clamp(ivec2(floor(at)), ivec2(0), ivec2(size) - 1);
  return ivec2(cell.x, int(size.y) - 1 - cell.y);
}
`;

/** The picture, alone or with gloss, or its normals. */
const showFragment = (layers, isTinted, isLinear) => `${kCommon(layers, isTinted)}
uniform vec4 factors[${3 * layers}];
uniform vec3 added;
uniform sampler2D normals;
uniform int mode;        // 0 picture, 1 with gloss, 2 normals
uniform vec3 halfway;    // between light and eye
uniform vec3 gloss;      // fraction of the picture, of the gloss, its exponent
out vec4 shown;
void main() {
  vec2 at = place();
  if (mode == 2) {
    shown = vec4(0.5 + 0.5 * texelFetch(normals, normalAt(at), 0).xyz, 1.0);
    return;
  }
  vec2 uv = sampled(at);
  vec3 colour = added;
  ${isTinted ? 'vec3 tinted = tintAdded;' : ''}
  for (int i = 0; i < ${layers}; ++i) {
    vec4 bytes = texture(planes, vec3(uv, i)) * 255.0;
    colour += times(bytes, factors[3 * i], factors[3 * i + 1], factors[3 * i + 2]);
    ${isTinted ? 'tinted += times(bytes, tint[3 * i], tint[3 * i + 1], tint[3 * i + 2]);' : ''}
  }
  ${isTinted ? 'colour *= tinted;' : ''}
  colour = clamp(colour, 0.0, 1.0);
  if (mode == 1) {
    float facing = max(0.0, dot(texelFetch(normals, normalAt(at), 0).xyz, halfway));
    vec3 light = ${isLinear ? 'colour' : 'linear3(colour)'};
    shown = vec4(coded3(clamp(gloss.x * light + gloss.y * pow(facing, gloss.z), 0.0, 1.0)), 1.0);
    return;
  }
  shown = vec4(${isLinear ? 'coded3(colour)' : 'colour'}, 1.0);
}`;

/** Normals by least squares of the model's own luminance under a few lights, as a Lambertian surface has it. */
const normalsFragment = (layers, isTinted, isLinear) => `${kCommon(layers, isTinted)}
uniform vec4 luminance[${kSketched * layers}];  // light by light, layer by layer
uniform float luminanceAdded[${kSketched}];
uniform vec3 solve[${kSketched}];               // the pseudo-inverse of the lights
out vec4 normal;
void main() {
  ivec2 at = ivec2(floor(place()));
  float values[${kSketched}];
  for (int k = 0; k < ${kSketched}; ++k) {
    values[k] = luminanceAdded[k];
  }
  ${isTinted ? 'vec3 tinted = tintAdded;' : ''}
  for (int i = 0; i < ${layers}; ++i) {
    vec4 bytes = texelFetch(planes, ivec3(at, i), 0) * 255.0;
    for (int k = 0; k < ${kSketched}; ++k) {
      values[k] += dot(bytes, luminance[${layers} * k + i]);
    }
    ${isTinted ? 'tinted += times(bytes, tint[3 * i], tint[3 * i + 1], tint[3 * i + 2]);' : ''}
  }
  vec3 sum = vec3(0.0);
  for (int k = 0; k < ${kSketched}; ++k) {
    float v = clamp(values[k]${isTinted ? ' * dot(tinted, vec3(0.2126, 0.7152, 0.0722))' : ''}, 0.0, 1.0);
    sum += solve[k] * ${isLinear ? 'v' : 'linear(v)'};
  }
  float size = length(sum);
  normal = vec4(size > 1e-6 ? sum / size : vec3(0.0, 0.0, 1.0), 1.0);
}`;

/** (A^T A)^-1 A^T of n directions, one column per direction. */
function pseudoInverse(lights) {
  const gram = Array.from({length: 3}, (_, i) =>
    Array.from({length: 3}, (_, j) => lights.reduce((sum, l) => sum + l[i] * l[j], 0)));
  const [[a, b, c], [, d, e], [, , f]] = gram;
  const cofactors = [[d * f - e * e, c * e - b * f, b * e - c * d],
                     [c * e - b * f, a * f - c * c, b * c - a * e],
                     [b * e - c * d, b * c - a * e, a * d - b * b]];
  const determinant = a * cofactors[0][0] + b * cofactors[0][1] + c * cofactors[0][2];
  return lights.map(l => cofactors.map(row => (row[0] * l[0] + row[1] * l[1] + row[2] * l[2]) / determinant));
}

/** The lights of the normals. */
export const sketchLights = Array.from({length: kSketched}, (_, k) => {
  const tilt = kSketchDegrees[k % 2] * Math.PI / 180;
  const turn = 2 * Math.PI * k / kSketched;
  return [Math.sin(tilt) * Math.cos(turn), Math.sin(tilt) * Math.sin(turn), Math.cos(tilt)];
});

/** A texture of planes, and once they are wanted of normals: the whole picture, or a tile of it. */
export class PlaneTexture {
  /** @param isWhole  no coarser levels stand beside it: it has its own */
  constructor(gl, width, height, layers, isWhole = false) {
    Object.assign(this, {gl, width, height, layers, isWhole, normals: null});
    this.planes = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.planes);
    const levels = isWhole ? 1 + Math.floor(Math.log2(Math.max(width, height))) : 1;
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, levels, gl.RGBA8, width, height, layers);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }

  /** Puts one layer into the graphics processor's memory. @param pixels  RGBA bytes, or a decoded picture */
  load(layer, pixels) {
    const {gl} = this;
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.planes);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, this.width, this.height, 1, gl.RGBA,
      gl.UNSIGNED_BYTE, pixels);
  }

  /** After the last load(). */
  complete() {
    if (this.isWhole) {
      this.gl.bindTexture(this.gl.TEXTURE_2D_ARRAY, this.planes);
      this.gl.generateMipmap(this.gl.TEXTURE_2D_ARRAY);
    }
  }

  bind(isSmooth) {
    const {gl} = this;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.planes);
    const filter = isSmooth ? gl.LINEAR : gl.NEAREST;
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, isSmooth && this.isWhole ? gl.LINEAR_MIPMAP_LINEAR : filter);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, filter);
  }

  /** Of every texel: planes, and normals in half precision. */
  static texelBytes(layers) {
    return 4 * layers + 8;
  }

  get bytes() {
    return this.width * this.height * PlaneTexture.texelBytes(this.layers);
  }

  end() {
    this.gl.deleteTexture(this.planes);
    this.gl.deleteTexture(this.normals);
  }
}

/** Draws textures of planes, lit, anywhere on the canvas. */
export class RelitPainter {
  /**
   * @param about  of `/v1/reflectance`
   * @param slots  of each plane: its layer and which of the four bytes there
   * @throws NoGraphics
   */
  constructor(canvas, about, slots) {
    const gl = canvas.getContext('webgl2', {alpha: false, antialias: false, depth: false,
                                             preserveDrawingBuffer: true});
    if (!gl) {
      throw new NoGraphics('This browser offers no WebGL 2, which the page computes with.');
    }
    if (!gl.getExtension('EXT_color_buffer_float')) {
      throw new NoGraphics('This graphics processor cannot draw into textures of floats (EXT_color_buffer_float).');
    }
    Object.assign(this, {gl, canvas, about, slots});
    this.layers = 1 + slots.reduce((most, [layer]) => Math.max(most, layer), 0);
    this.empty = gl.createTexture();  // what a sampler is bound to that is not looked at
    gl.bindTexture(gl.TEXTURE_2D, this.empty);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, 1, 1);
    const kind = [this.layers, about.tint !== null, about.transfer === 'linear'];
    this.toShow = link(gl, kVertex, showFragment(...kind));
    this.toNormals = link(gl, kVertex, normalsFragment(...kind));
    this.sketchMaps = null;
  }

  /** Factors of a map as the shaders take them: layer by layer R, G, B of four bytes each. */
  packed(factors) {
    const all = new Float32Array(12 * this.layers);
    factors.forEach((row, c) => row.forEach((value, p) => {
      const [layer, byte] = this.slots[p];
      all[12 * layer + 4 * c + byte] = value;
    }));
    return all;
  }

  /** @param rect  {x, y, width, height} of whole pixels of the target, from its upper left; corner, texels: of the planes there */
  use({program, uniforms}, texture, {below, rect, corner, texels, isSmooth}) {
    const {gl, about} = this;
    gl.useProgram(program);
    texture.bind(isSmooth);
    gl.uniform1i(uniforms.planes, 0);
    gl.uniform2f(uniforms.size, texture.width, texture.height);
    gl.uniform2f(uniforms.corner, ...corner);
    gl.uniform1f(uniforms.texels, texels);
    gl.uniform1f(uniforms.below, below);
    gl.uniform1i(uniforms.isSmooth, isSmooth ? 1 : 0);
    if (about.tint) {
      gl.uniform4fv(uniforms['tint[0]'], this.packed(about.tint.factors));
      gl.uniform3fv(uniforms.tintAdded, about.tint.added);
    }
    gl.viewport(rect.x, below - rect.y - rect.height, rect.width, rect.height);
  }

  /** A whole texture, pixel by pixel. */
  static whole({width, height}) {
    return {below: height, rect: {x: 0, y: 0, width, height}, corner: [0, 0], texels: 1, isSmooth: false};
  }

  /** Normals of one texture, from this.sketchMaps: ColourMaps of sketchLights. */
  makeNormals(texture) {
    const {gl, layers} = this;
    const weights = [0.2126, 0.7152, 0.0722];
    const luminance = new Float32Array(4 * layers * kSketched);
    this.sketchMaps.forEach(({factors}, k) => this.slots.forEach(([layer, byte], p) => {
      luminance[4 * (layers * k + layer) + byte] = weights.reduce((sum, w, c) => sum + w * factors[c][p], 0);
    }));
    texture.normals = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture.normals);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, texture.width, texture.height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture.normals, 0);
    this.use(this.toNormals, texture, RelitPainter.whole(texture));
    const {uniforms} = this.toNormals;
    gl.uniform4fv(uniforms['luminance[0]'], luminance);
    gl.uniform1fv(uniforms['luminanceAdded[0]'],
      this.sketchMaps.map(({added}) => weights.reduce((sum, w, c) => sum + w * added[c], 0)));
    gl.uniform3fv(uniforms['solve[0]'], pseudoInverse(sketchLights).flat());
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
  }

  /**
   * @param map  ColourMap of the light
   * @param light  unit vector
   * @param look  {mode: picture, specular or normals; diffuse, gloss, shine}
   * @param where  as of use()
   */
  paint(texture, where, map, light, {mode, diffuse, gloss, shine}) {
    const {gl} = this;
    if (mode !== 'picture' && !texture.normals) {
      this.makeNormals(texture);
    }
    this.use(this.toShow, texture, where);
    const {uniforms} = this.toShow;
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, texture.normals ?? this.empty);
    gl.uniform1i(uniforms.normals, 1);
    gl.uniform4fv(uniforms['factors[0]'], this.packed(map.factors));
    gl.uniform3fv(uniforms.added, map.added);
    gl.uniform1i(uniforms.mode, ['picture', 'specular', 'normals'].indexOf(mode));
    const [x, y, z] = light;
    const size = Math.hypot(x, y, z + 1);
    gl.uniform3f(uniforms.halfway, x / size, y / size, (z + 1) / size);
    gl.uniform3f(uniforms.gloss, diffuse, gloss, shine);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /** What the canvas shows, 4 bytes per pixel, from the upper left. */
  pixels() {
    const {gl, canvas: {width, height}} = this;
    const upward = new Uint8Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upward);
    const data = new Uint8ClampedArray(upward.length);
    for (let y = 0; y < height; ++y) {
      data.set(upward.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
    }
    return {width, height, data};
  }
}

/** The whole picture in one texture, four planes per layer as the server sends them. */
export class ReflectanceRenderer extends RelitPainter {
  /** @throws NoGraphics */
  constructor(canvas, about) {
    super(canvas, about, Array.from({length: about.planes}, (_, p) => [p >> 2, p & 3]));
    const {gl} = this;
    // Pixels are averaged until they fit the graphics processor and the page's memory.
    const {width, height} = about.picture;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const bytes = shrink => Math.ceil(width / shrink) * Math.ceil(height / shrink) * PlaneTexture.texelBytes(this.layers);
    this.shrink = 1;
    while (Math.max(width, height) / this.shrink > most || bytes(this.shrink) > about.texture_bytes) {
      ++this.shrink;
    }
    if (this.shrink > about.most_shrink) {
      throw new NoGraphics(`The picture of ${width} x ${height} pixels is too large for this page.`);
    }
    canvas.width = Math.ceil(width / this.shrink);
    canvas.height = Math.ceil(height / this.shrink);
    this.texture = new PlaneTexture(gl, canvas.width, canvas.height, this.layers);
  }

  load(layer, bytes) {
    this.texture.load(layer, new Uint8Array(bytes));
  }

  show(map, light, look) {
    this.paint(this.texture, RelitPainter.whole(this.texture), map, light, look);
  }
}
