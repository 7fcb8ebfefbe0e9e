// Relight's web folders as a browser shows them: Chromium decodes the pictures, a shader lights them by
// the rule of the viewer OpenLIME 1.2.6 (its constants, its 8-bit linear light and its opacity included),
// and the result, on a white page, is held against haarlight's.
//   node relightable_test.mjs PROGRAMS MODULES OUT [--only NAME]
// PROGRAMS: the build's folder apps/; MODULES: where playwright-core is installed; OUT: the folders.
// scripts/page_test BUILD --relightable runs it; OpenLIME itself is shown folders by
// scripts/openlime_check.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, Suite, expect} from './harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const option = name => process.argv.includes(name) ? process.argv[process.argv.indexOf(name) + 1] : '';
const source = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const folder = path.join(out, 'relightable');
fs.rmSync(folder, {recursive: true, force: true});

const sample = path.join(source, '../shared/data/formats/relight_hsh9_srgb_487x439.rti');
const input = fs.existsSync(sample) ? [sample] : [];
if (input.length === 0) {
  console.log('note: no ../shared/data here: smooth waves are shown instead of a capture');
}
execFileSync(path.join(programs, '../tests/web/made_relightable'), [folder, ...input]);
const lights = JSON.parse(fs.readFileSync(path.join(folder, 'lights.json'), 'utf8'));

const kTypes = {'.json': 'application/json', '.jpg': 'image/jpeg', '.png': 'image/png'};
const server = http.createServer((request, response) => {
  const name = path.join(folder, path.normalize(request.url).replace(/^\/+/, ''));
  if (request.url === '/') {
    response.setHeader('Content-Type', 'text/html');
    response.end('<!doctype html><title>relightable</title>');
  } else if (name.startsWith(folder) && fs.existsSync(name) && kTypes[path.extname(name)]) {
    response.setHeader('Content-Type', kTypes[path.extname(name)]);
    fs.createReadStream(name).pipe(response);
  } else {
    response.statusCode = request.url === '/favicon.ico' ? 204 : 404;
    response.end();
  }
});
await new Promise(resolve => server.listen(0, '127.0.0.1', resolve));
const url = `http://127.0.0.1:${server.address().port}/`;

/** In the page: functions that measure() uses. */
function prepare() {
  globalThis.load = async file => {
    const image = new Image();
    image.src = file;
    await image.decode();
    return image;
  };
  /** PSNR in dB of what `gl` shows on a white page against a picture in a file. */
  globalThis.decibelsOf = async (gl, file) => {
    const {width, height} = gl.canvas;
    const shown = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, shown);
    const flat = document.createElement('canvas');
    flat.width = width;
    flat.height = height;
    const context = flat.getContext('2d', {willReadFrequently: true});
    context.drawImage(await load(file), 0, 0);
    const truth = context.getImageData(0, 0, width, height).data;
    let squares = 0;
    for (let y = 0; y < height; ++y) {
      for (let x = 0; x < width; ++x) {
        for (let c = 0; c < 3; ++c) {  // readPixels begins at the lowest row
          const at = 4 * ((height - 1 - y) * width + x);
          const onWhite = Math.min(255, shown[at + c] + 255 - shown[at + 3]);
          const difference = onWhite - truth[4 * (y * width + x) + c];
          squares += difference * difference;
        }
      }
    }
    return 10 * Math.log10(255 * 255 * 3 * width * height / Math.max(squares, 1e-9));
  };
}

/** In the page: PSNR in dB of the folder's pictures under each light against the PNGs. */
async function measure([name, directions]) {
  const info = await (await fetch(`${name}/info.json`)).json();
  const {width, height, nplanes, type, colorspace} = info;
  const {scale, bias, range} = info.materials[0];
  const nPictures = Math.ceil(nplanes / 3);

  // How much each plane counts in R, G and B under a light, and what is added.
  const weights = light => {
    const planes = new Float32Array(3 * nplanes);
    const added = [0, 0, 0];
    const [x, y, z] = light;
    if (colorspace === 'mrgb') {
      const side = info.resolution, s = Math.abs(x) + Math.abs(y) + Math.abs(z);
      const column = ((x + y) / s + 1) / 2 * (side - 1), row = ((y - x) / s + 1) / 2 * (side - 1);
      const c = Math.min(side - 2, Math.floor(column)), r = Math.min(side - 2, Math.floor(row));
      const nodes = [[c, r], [c + 1, r], [c, r + 1], [c + 1, r + 1]].map(([i, j]) =>
        [i + j * side, (1 - Math.abs(column - i)) * (1 - Math.abs(row - j))]);
      for (let k = 0; k < 3; ++k) {
        for (const [node, weight] of nodes) {
          added[k] += weight * info.basis[3 * node + k] / 255;
          for (let p = 0; p < nplanes; ++p) {
            const byte = info.basis[((p + 1) * side * side + node) * 3 + k];
            planes[3 * p + k] += weight * (byte - 127) / range[p];
          }
        }
      }
      return {planes, added};
    }
    let terms = [1, x, y, x * x, x * y, y * y];
    if (type === 'hsh') {
      const pi = 3.1415, phi = Math.atan2(y, x), theta = Math.min(Math.acos(z), pi / 2 - 0.15);
      const c = Math.cos(theta), q = Math.sqrt(c - c * c), m = 2 * c - 1;
      const root = n => Math.sqrt(n / pi);
      terms = [root(0.5), root(6) * Math.cos(phi) * q, root(1.5) * m, root(6) * q * Math.sin(phi),
               root(30) * Math.cos(2 * phi) * (c * c - c), root(30) * Math.cos(phi) * m * q,
               root(2.5) * (1 - 6 * c + 6 * c * c), root(30) * m * q * Math.sin(phi),
               root(30) * (c * c - c) * Math.sin(2 * phi)];
    }
    for (let p = 0; p < nplanes; ++p) {
      if (colorspace === 'lrgb') {  // the first picture is the colour, the others are the luminance
        planes[3 * p] = p < 3 ? 0 : terms[p - 3];
      } else {
        planes[3 * p + p % 3] = terms[Math.floor(p / 3)];
      }
    }
    return {planes, added};
  };

  const canvas = document.createElement('canvas');
  canvas.width = width;
  canvas.height = height;
  const gl = canvas.getContext('webgl2', {preserveDrawingBuffer: true, antialias: false});
  if (!gl) {
    throw new Error('no WebGL 2');
  }
  const compile = (kind, text) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
      throw new Error(gl.getShaderInfoLog(shader));
    }
    return shader;
  };
  const pictures = [...Array(nPictures).keys()];
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, `#version 300 es
    out vec2 at;
    void main() {  // one triangle over the whole picture, its rows from the top
      at = vec2(gl_VertexID == 1 ? 2 : 0, gl_VertexID == 2 ? 2 : 0);
      gl_Position = vec4(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0, 1);
    }`));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float;
    in vec2 at;
    out vec4 colour;
    uniform vec3 added, scale[${nPictures}], bias[${nPictures}], weight[${nplanes}];
    ${pictures.map(k => `uniform sampler2D plane${k};`).join('\n')}
    void main() {
      vec3 sum = added, value;
      ${pictures.map(k => `
      value = (texture(plane${k}, at).rgb - bias[${k}]) * scale[${k}];
      sum += weight[${3 * k}] * value.r + weight[${3 * k + 1}] * value.g + weight[${3 * k + 2}] * value.b;`)
        .join('\n')}
      ${colorspace === 'lrgb' ? 'colour = sum.r * vec4((texture(plane0, at).rgb - bias[0]) * scale[0], 1);'
                              : 'colour = vec4(sum, 1);'}
      colour.rgb = pow(colour.rgb, vec3(2.2));  // as light, into 8 bits
    }`));
  const coding = gl.createProgram();
  gl.attachShader(coding, compile(gl.VERTEX_SHADER, `#version 300 es
    out vec2 at;
    void main() {
      at = vec2(gl_VertexID == 1 ? 2 : 0, gl_VertexID == 2 ? 2 : 0);
      gl_Position = vec4(2.0 * at - 1.0, 0, 1);
    }`));
  gl.attachShader(coding, compile(gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float;
    in vec2 at;
    out vec4 colour;
    uniform sampler2D light;
    void main() {
      colour = texture(light, at);
      colour.rgb = pow(colour.rgb, vec3(1.0 / 2.2));
    }`));
  for (const each of [program, coding]) {
    gl.linkProgram(each);
    if (!gl.getProgramParameter(each, gl.LINK_STATUS)) {
      throw new Error(gl.getProgramInfoLog(each));
    }
  }
  const light = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + nPictures);
  gl.bindTexture(gl.TEXTURE_2D, light);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  const frame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, light, 0);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  gl.useProgram(coding);
  gl.uniform1i(gl.getUniformLocation(coding, 'light'), nPictures);
  gl.useProgram(program);
  const uniform = text => gl.getUniformLocation(program, text);
  for (const k of pictures) {
    gl.activeTexture(gl.TEXTURE0 + k);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, await load(`${name}/plane_${k}.jpg`));
    gl.uniform1i(uniform(`plane${k}`), k);
  }
  gl.uniform3fv(uniform('scale'), scale);
  gl.uniform3fv(uniform('bias'), bias);

  const decibels = [];
  for (let i = 0; i < directions.length; ++i) {
    const {planes, added} = weights(directions[i]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.useProgram(program);
    gl.uniform3fv(uniform('weight'), planes);
    gl.uniform3fv(uniform('added'), added);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    gl.useProgram(coding);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    decibels.push(await decibelsOf(gl, `${name}_${i}.png`));
  }
  return decibels;
}

const browser = await new Browser().begin(modules);
const suite = new Suite(browser, option('--only'));
const check = async found => {
  const decibels = found.sort((a, b) => a - b);
  const median = decibels[(decibels.length - 1) / 2];
  expect(median >= 38, `median ${median.toFixed(1)} dB, all: ${decibels.map(d => d.toFixed(1)).join(' ')}`);
  return `median ${median.toFixed(1)} dB, worst ${decibels[0].toFixed(1)} dB over ${decibels.length} lights`;
};
for (const name of ['ptm', 'lptm', 'hsh', 'bilinear']) {
  await suite.test(`a web folder of ${name} shows haarlight's pictures`, async () => {
    const page = await browser.page(url);
    await page.evaluate(prepare);
    return check(await page.evaluate(measure, [name, lights]));
  });
}
await browser.end();
server.close();
for (const problem of browser.problems) {
  console.log(`FAILED  ${problem}`);
}
process.exit(suite.failed > 0 || suite.run === 0 || browser.problems.length > 0 ? 1 : 0);
