// A picture of 8-bit planes under a light from one direction. How bytes become colours there is a
// linear map that the server computes (relight/formats/reflectance.h, ColourMap); its product with
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
uniform int lastRow;
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
ivec2 place() { return ivec2(int(gl_FragCoord.x), lastRow - int(gl_FragCoord.y)); }
`;

/** The picture, alone or with gloss, or its normals. */
const showFragment = (layers, isTinted, isLinear) => `${kCommon(layers, isTinted)}
uniform vec4 factors[${3 * layers}];
uniform vec3 added;
uniform sampler2D normals;
uniform int mode;        // 0 picture, 1 with gloss, 2 normals
uniform vec3 halfway;    // between light and eye
uniform vec3 gloss;      // share of the picture, of the gloss, its exponent
out vec4 shown;
void main() {
  ivec2 at = place();
  if (mode == 2) {
    shown = vec4(0.5 + 0.5 * texelFetch(normals, ivec2(gl_FragCoord.xy), 0).xyz, 1.0);
    return;
  }
  vec3 colour = added;
  ${isTinted ? 'vec3 tinted = tintAdded;' : ''}
  for (int i = 0; i < ${layers}; ++i) {
    vec4 bytes = texelFetch(planes, ivec3(at, i), 0) * 255.0;
    colour += times(bytes, factors[3 * i], factors[3 * i + 1], factors[3 * i + 2]);
    ${isTinted ? 'tinted += times(bytes, tint[3 * i], tint[3 * i + 1], tint[3 * i + 2]);' : ''}
  }
  ${isTinted ? 'colour *= tinted;' : ''}
  colour = clamp(colour, 0.0, 1.0);
  if (mode == 1) {
    float facing = max(0.0, dot(texelFetch(normals, ivec2(gl_FragCoord.xy), 0).xyz, halfway));
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
  ivec2 at = place();
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

/** (A^T A)^-1 A^T of n directions, a column a direction. */
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

export class ReflectanceRenderer {
  /** @throws NoGraphics */
  constructor(canvas, about) {
    const gl = canvas.getContext('webgl2', {alpha: false, antialias: false, depth: false,
                                             preserveDrawingBuffer: true});
    if (!gl) {
      throw new NoGraphics('This browser offers no WebGL 2, which the page computes with.');
    }
    if (!gl.getExtension('EXT_color_buffer_float')) {
      throw new NoGraphics('This graphics processor cannot draw into textures of floats (EXT_color_buffer_float).');
    }
    Object.assign(this, {gl, canvas, about});
    this.layers = Math.ceil(about.planes / 4);
    // Pixels are averaged until they fit the graphics processor and the page's memory.
    const {width, height} = about.picture;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const bytes = shrink => Math.ceil(width / shrink) * Math.ceil(height / shrink) * (4 * this.layers + 8);
    this.shrink = 1;
    while (Math.max(width, height) / this.shrink > most || bytes(this.shrink) > about.texture_bytes) {
      ++this.shrink;
    }
    if (this.shrink > about.most_shrink) {
      throw new NoGraphics(`The picture of ${width} x ${height} pixels is too large for this page.`);
    }
    this.width = Math.ceil(width / this.shrink);
    this.height = Math.ceil(height / this.shrink);
    canvas.width = this.width;
    canvas.height = this.height;
    this.planes = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.planes);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA8, this.width, this.height, this.layers);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    this.normals = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.normals);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, this.width, this.height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    const kind = [this.layers, about.tint !== null, about.transfer === 'linear'];
    this.toShow = link(gl, kVertex, showFragment(...kind));
    this.toNormals = link(gl, kVertex, normalsFragment(...kind));
  }

  /** Puts four planes into the graphics processor's memory. */
  load(layer, bytes) {
    const {gl} = this;
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.planes);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, this.width, this.height, 1, gl.RGBA,
      gl.UNSIGNED_BYTE, new Uint8Array(bytes));
  }

  /** Factors of a map as the shaders take them: layer by layer R, G, B of four planes each. */
  packed(factors) {
    const all = new Float32Array(12 * this.layers);
    factors.forEach((row, c) => row.forEach((value, p) => {
      all[12 * (p >> 2) + 4 * c + (p & 3)] = value;
    }));
    return all;
  }

  use({program, uniforms}) {
    const {gl, about} = this;
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.planes);
    gl.uniform1i(uniforms.planes, 0);
    gl.uniform1i(uniforms.lastRow, this.height - 1);
    if (about.tint) {
      gl.uniform4fv(uniforms['tint[0]'], this.packed(about.tint.factors));
      gl.uniform3fv(uniforms.tintAdded, about.tint.added);
    }
    gl.viewport(0, 0, this.width, this.height);
  }

  /** @param maps  ColourMaps of sketchLights */
  makeNormals(maps) {
    const {gl, layers} = this;
    const weights = [0.2126, 0.7152, 0.0722];
    const luminance = new Float32Array(4 * layers * kSketched);
    maps.forEach(({factors}, k) => {
      for (let p = 0; p < factors[0].length; ++p) {
        luminance[4 * layers * k + p] = weights.reduce((sum, w, c) => sum + w * factors[c][p], 0);
      }
    });
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.normals, 0);
    this.use(this.toNormals);
    const {uniforms} = this.toNormals;
    gl.uniform4fv(uniforms['luminance[0]'], luminance);
    gl.uniform1fv(uniforms['luminanceAdded[0]'],
      maps.map(({added}) => weights.reduce((sum, w, c) => sum + w * added[c], 0)));
    gl.uniform3fv(uniforms['solve[0]'], pseudoInverse(sketchLights).flat());
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
  }

  /**
   * @param map  ColourMap of the light
   * @param light  unit vector
   * @param look  {mode: picture, specular or normals; diffuse, gloss, shine}
   */
  show(map, light, {mode, diffuse, gloss, shine}) {
    const {gl} = this;
    this.use(this.toShow);
    const {uniforms} = this.toShow;
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.normals);
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

  /** What the canvas shows, 4 bytes a pixel, from the upper left. */
  pixels() {
    const {gl, width, height} = this;
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
