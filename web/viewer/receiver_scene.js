// SPDX-License-Identifier: Apache-2.0
// Draws the receiver with its shadow, and the hull as a solid under the same light, with WebGL. The solid's
// picture is kept, with its depth, until light or view change: software GL takes as long for its triangles
// as for ten pictures of the sheet.

import {dot, sum} from './hull.js';
import {NoGraphics, link} from './graphics.js';
import {kAlbedo} from './receiver_shape.js';

const kLights = 24;       // that shade the hull, groups of lights
const kSolidAlbedo = 0.62;
const kAmbient = 0.1;     // of all light at the plane, from everywhere: the solid's own shadows are not computed
const kNormalRounds = 4;
export const kFovDeg = 30;

const kCurve = `
vec3 curve(vec3 v) {
  v = clamp(v, 0.0, 1.0);
  return mix(12.92 * v, 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, step(vec3(0.0031308), v));
}`;

const kSheetVertex = `#version 300 es
uniform mat4 view;
uniform vec3 corner;
uniform vec3 across;
uniform vec3 down;
out vec2 at;
void main() {
  at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = view * vec4(corner + at.x * across + at.y * down, 1.0);
}`;

const kSheetFragment = `#version 300 es
precision highp float;
uniform sampler2D light;
uniform float exposure;
uniform float isBelow;
in vec2 at;
out vec4 colour;
${kCurve}
void main() {
  vec3 lit = curve(texture(light, at).rgb * exposure);
  colour = vec4(isBelow > 0.5 ? vec3(0.16) : lit, 1.0);
}`;

const kSolidVertex = `#version 300 es
precision highp float;
uniform mat4 view;
uniform int nLights;
uniform vec3 centres[${kLights}];
uniform vec3 emits[${kLights}];
uniform vec3 powers[${kLights}];
uniform vec3 ambient;
uniform vec3 up;
uniform float showsAssumed;
layout(location = 0) in vec3 vertex;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 tint;
out vec3 shade;
void main() {
  vec3 n = normalize(normal);
  vec3 light = ambient * (0.6 + 0.4 * dot(n, up));
  for (int k = 0; k < nLights; ++k) {
    vec3 to = centres[k] - vertex;
    float d2 = dot(to, to);
    light += powers[k] * max(0.0, dot(n, to)) * max(0.0, -dot(emits[k], to)) / (d2 * d2);
  }
  vec3 albedo = mix(vec3(${kSolidAlbedo}), tint * vec3(0.9), showsAssumed);
  shade = albedo * light;
  gl_Position = view * vec4(vertex, 1.0);
}`;

const kSolidFragment = `#version 300 es
precision highp float;
in vec3 shade;
out vec4 colour;
void main() { colour = vec4(shade, 1.0); }`;

const kLayerVertex = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0, 0.0, 1.0); }`;

// The solid's kept picture, finer than the canvas: the mean of its colours, the least of its depths.
const kLayerFragment = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D colours;
uniform sampler2D depths;
uniform int finer;      // once or twice as fine
uniform vec2 texel;     // 1 / the canvas's width, height
uniform float exposure;
out vec4 colour;
${kCurve}
void main() {
  vec4 mean = textureLod(colours, gl_FragCoord.xy * texel, 0.0);
  if (mean.a == 0.0) {
    discard;
  }
  float depth = 1.0;
  for (int j = 0; j < finer; ++j) {
    for (int i = 0; i < finer; ++i) {
      depth = min(depth, texelFetch(depths, ivec2(gl_FragCoord.xy) * finer + ivec2(i, j), 0).r);
    }
  }
  gl_FragDepth = depth;
  colour = vec4(curve(mean.rgb / mean.a * exposure), mean.a);
}`;

const kLineVertex = `#version 300 es
uniform mat4 view;
layout(location = 0) in vec3 vertex;
void main() { gl_Position = view * vec4(vertex, 1.0); }`;

const kLineFragment = `#version 300 es
precision highp float;
uniform vec4 ink;
out vec4 colour;
void main() { colour = ink; }`;

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = v => v.map(x => x / Math.hypot(...v));

/** Normals, each the mean of its neighbours' several times over: the voxels' steps are not shaded. */
function smoothed(normals, triangles) {
  let now = normals;
  for (let round = 0; round < kNormalRounds; ++round) {
    const next = new Float32Array(now.length);
    for (let t = 0; t < triangles.length; t += 3) {
      for (let axis = 0; axis < 3; ++axis) {
        const all = now[3 * triangles[t] + axis] + now[3 * triangles[t + 1] + axis] + now[3 * triangles[t + 2] + axis];
        next[3 * triangles[t] + axis] += all;
        next[3 * triangles[t + 1] + axis] += all;
        next[3 * triangles[t + 2] + axis] += all;
      }
    }
    for (let v = 0; v < next.length; v += 3) {
      const length = Math.hypot(next[v], next[v + 1], next[v + 2]) || 1;
      next[v] /= length;
      next[v + 1] /= length;
      next[v + 2] /= length;
    }
    now = next;
  }
  return now;
}

/** Column by column: clip = projection * (world from camera)^-1, the camera's x right, y down, z forward. */
function clipFromWorld(eye, right, downward, forward, focal, centre, near, far) {
  // x_clip = fx x + cx z, y_clip = -(fy y + cy z), w = z, of camera coordinates, in halves of the picture.
  const rows = [
    sum([focal[0], right], [centre[0], forward]), sum([-focal[1], downward], [-centre[1], forward]),
    sum([(far + near) / (far - near), forward]), forward,
  ];
  const matrix = new Float32Array(16);
  rows.forEach((row, r) => {
    for (let c = 0; c < 3; ++c) {
      matrix[4 * c + r] = row[c];
    }
    matrix[12 + r] = -dot(row, eye);
  });
  matrix[14] -= 2 * far * near / (far - near);
  return matrix;
}

export class ReceiverScene {
  /** @throws NoGraphics */
  constructor(canvas, hull, shape) {
    Object.assign(this, {canvas, hull, shape, showsAssumed: false, exposure: 1, lights: null, isFromCamera: false});
    const gl = canvas.getContext('webgl2', {alpha: false, antialias: true, preserveDrawingBuffer: true,
                                             powerPreference: 'high-performance'});
    if (!gl) {
      throw new NoGraphics('This browser offers no WebGL 2, which the page draws with.');
    }
    if (!gl.getExtension('EXT_color_buffer_float')) {
      throw new NoGraphics('This graphics processor cannot draw into textures of floats (EXT_color_buffer_float).');
    }
    this.gl = gl;
    this.sheet = link(gl, kSheetVertex, kSheetFragment);
    this.solid = link(gl, kSolidVertex, kSolidFragment);
    this.line = link(gl, kLineVertex, kLineFragment);
    this.layer = {...link(gl, kLayerVertex, kLayerFragment), key: '', finer: 0, colours: this.makeTexture(gl.LINEAR),
                  depths: this.makeTexture(gl.NEAREST), frame: gl.createFramebuffer()};
    this.texture = this.makeTexture(gl.LINEAR);
    this.loadHull();
    const {centre, width_mm: width, height_mm: height} = hull.about.plane;
    const [a, b] = hull.about.grid.axes;
    this.outline = this.vertexArray([[0, Float32Array.from(
      [[-1, -1], [1, -1], [1, 1], [-1, 1]].flatMap(([i, j]) => sum([1, centre], [0.5 * i * width, a], [0.5 * j * height, b]))), 3]]);
    this.rim = gl.createBuffer();
    this.rimArray = gl.createVertexArray();
    gl.bindVertexArray(this.rimArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.rim);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    this.reset();
  }

  makeTexture(filter) {
    const {gl} = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter],
                                 [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) {
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    }
    return texture;
  }

  vertexArray(lists) {
    const {gl} = this;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [index, values, size] of lists) {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, size, values instanceof Uint8Array ? gl.UNSIGNED_BYTE : gl.FLOAT,
                             values instanceof Uint8Array, 0, 0);
    }
    return array;
  }

  loadHull() {
    const {gl, hull} = this;
    this.hullArray = this.vertexArray([[0, hull.vertices, 3], [1, smoothed(hull.normals, hull.triangles), 3], [2, hull.colours, 3]]);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, hull.triangles, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  /** The view to begin with: from the side that the capture's camera is on. */
  reset() {
    const {about} = this.hull;
    const [a, b, n] = about.grid.axes;
    const eye = about.camera.world_from_cam.map(row => row[3]);
    const to = sum([1, eye], [-1, about.plane.centre]);
    this.azimuth = Math.atan2(dot(to, b), dot(to, a)) + 0.35;
    this.elevation = 0.56;
    this.target = sum([1, about.plane.centre], [0.05 * about.high_mm, n]);
    this.distance = 0.9 * Math.hypot(this.shape.across, this.shape.along) / (2 * Math.tan(0.5 * kFovDeg * Math.PI / 180));
    this.isFromCamera = false;
  }

  orbit(turn, rise) {
    this.isFromCamera = false;
    this.azimuth += turn;
    this.elevation = Math.min(1.55, Math.max(-0.3, this.elevation + rise));
  }

  zoom(factor) {
    this.isFromCamera = false;
    this.distance = Math.min(20 * this.shape.across, Math.max(0.3 * this.shape.across, this.distance * factor));
  }

  /** mm of the world, about, that a pixel of the page shows in the middle. */
  get mmPerPixel() {
    return 2 * this.distance * Math.tan(0.5 * kFovDeg * Math.PI / 180) / Math.max(1, this.canvas.clientHeight);
  }

  /** As a scene file has it: {size, eye, target, up, fovDeg}. */
  camera() {
    const {about} = this.hull;
    const [a, b, n] = about.grid.axes;
    const size = [this.canvas.width, this.canvas.height];
    if (this.isFromCamera) {
      const m = about.camera.world_from_cam;
      const eye = m.map(row => row[3]);
      const forward = m.map(row => row[2]);
      return {size, eye, target: sum([1, eye], [500, forward]), up: m.map(row => -row[1]),
              fovDeg: 2 * Math.atan(0.5 * about.camera.size[1] / about.camera.focal[1]) * 180 / Math.PI};
    }
    const out = sum([Math.cos(this.elevation) * Math.cos(this.azimuth), a], [Math.cos(this.elevation) * Math.sin(this.azimuth), b],
                    [Math.sin(this.elevation), n]);
    return {size, eye: sum([1, this.target], [this.distance, out]), target: this.target, up: n, fovDeg: kFovDeg};
  }

  clip({size, eye, target, up, fovDeg}) {
    const forward = unit(sum([1, target], [-1, eye]));
    const right = unit(cross(forward, up));
    const downward = cross(forward, right);
    const focal = 1 / Math.tan(0.5 * fovDeg * Math.PI / 180);
    const far = Math.hypot(...sum([1, target], [-1, eye])) + 10 * this.shape.across;
    return clipFromWorld(eye, right, downward, forward, [focal * size[1] / size[0], focal], [0, 0], 5, far);
  }

  /** @param picture  of ShadowEngine */
  setPicture({cols, rows, sums, sheet}) {
    const {gl} = this;
    const texels = new Float32Array(4 * cols * rows);
    for (let p = 0, from = 0, to = 0; p < cols * rows; ++p, from += 6, to += 4) {
      texels[to] = sums[from];
      texels[to + 1] = sums[from + 1];
      texels[to + 2] = sums[from + 2];
    }
    // Half floats end at 65504 and lose below 6e-5: in units of what is shown as white.
    for (let i = 0; i < texels.length; ++i) {
      texels[i] *= this.exposure * kAlbedo / Math.PI;
    }
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, cols, rows, 0, gl.RGBA, gl.FLOAT, texels);
    this.drawn = sheet;
  }

  /** Lights that shade the solid. @param groups  {centre, emits, power (three colours, times area)}: world, mm */
  setLights(groups, ambient) {
    this.lights = {groups: groups.slice(0, kLights), ambient};
    this.layer.key = '';
  }

  /** @param finer  times as fine as the canvas the solid's edges are drawn, where it changes */
  draw(finer = 1) {
    const {gl, canvas} = this;
    const scale = Math.min(1.5, devicePixelRatio || 1);
    const [w, h] = [Math.max(16, Math.round(canvas.clientWidth * scale)), Math.max(16, Math.round(canvas.clientHeight * scale))];
    if (canvas.width !== w || canvas.height !== h) {
      canvas.width = w;
      canvas.height = h;
    }
    const camera = this.camera();
    const view = this.clip(camera);
    gl.enable(gl.DEPTH_TEST);
    if (this.lights) {
      this.keepSolid(view, finer);
    }
    gl.viewport(0, 0, w, h);
    gl.clearColor(0.055, 0.067, 0.086, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawLine(view, this.outline, [0.43, 0.7, 1, 1]);
    if (this.drawn) {
      this.drawSheet(view, camera);
    }
    if (this.lights) {
      this.drawLayer(view);
    }
  }

  drawLine(view, array, ink) {
    const {gl, line} = this;
    gl.useProgram(line.program);
    gl.uniformMatrix4fv(line.uniforms.view, false, view);
    gl.uniform4f(line.uniforms.ink, ...ink);
    gl.bindVertexArray(array);
    gl.drawArrays(gl.LINE_LOOP, 0, 4);
  }

  /** The sheet stands where the shadow on it was computed, also while the next is being computed. */
  drawSheet(view, camera) {
    const {gl, sheet, drawn} = this;
    gl.useProgram(sheet.program);
    gl.uniformMatrix4fv(sheet.uniforms.view, false, view);
    gl.uniform3f(sheet.uniforms.corner, ...drawn.corner);
    gl.uniform3f(sheet.uniforms.across, ...drawn.across);
    gl.uniform3f(sheet.uniforms.down, ...drawn.down);
    gl.uniform1f(sheet.uniforms.exposure, 1);
    gl.uniform1f(sheet.uniforms.isBelow, dot(drawn.normal, sum([1, camera.eye], [-1, drawn.corner])) < 0 ? 1 : 0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    const {corner, across, down} = drawn;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.rim);
    gl.bufferData(gl.ARRAY_BUFFER, Float32Array.from([corner, sum([1, corner], [1, across]),
      sum([1, corner], [1, across], [1, down]), sum([1, corner], [1, down])].flat()), gl.DYNAMIC_DRAW);
    this.drawLine(view, this.rimArray, [0.75, 0.78, 0.82, 1]);
  }

  /** Draws the solid into its own textures, unless they hold this view and light at least as finely. */
  keepSolid(view, finer) {
    const {gl, canvas: {width, height}, layer} = this;
    const key = `${width} ${height} ${this.showsAssumed} ${view.join(' ')}`;
    if (layer.key === key && layer.finer >= finer) {
      return;
    }
    Object.assign(layer, {key, finer});
    const [w, h] = [width * finer, height * finer];
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.frame);
    if (layer.width !== w || layer.height !== h) {
      Object.assign(layer, {width: w, height: h});
      gl.bindTexture(gl.TEXTURE_2D, layer.colours);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, w, h, 0, gl.RGBA, gl.HALF_FLOAT, null);
      gl.bindTexture(gl.TEXTURE_2D, layer.depths);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.DEPTH_COMPONENT24, w, h, 0, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT, null);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, layer.colours, 0);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, layer.depths, 0);
    }
    gl.viewport(0, 0, w, h);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawSolid(view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  drawSolid(view) {
    const {gl, solid, lights, hull} = this;
    const {uniforms} = solid;
    gl.useProgram(solid.program);
    gl.uniformMatrix4fv(uniforms.view, false, view);
    const {groups, ambient} = lights;
    // Half floats: in units of the light at the plane.
    const unitOf = 1 / (this.unit = Math.max(1e-30, ...ambient));
    gl.uniform1i(uniforms.nLights, groups.length);
    if (groups.length > 0) {
      gl.uniform3fv(uniforms['centres[0]'], groups.flatMap(({centre}) => centre));
      gl.uniform3fv(uniforms['emits[0]'], groups.flatMap(({emits}) => emits));
      gl.uniform3fv(uniforms['powers[0]'], groups.flatMap(({power}) => power.map(x => x * unitOf)));
    }
    gl.uniform3f(uniforms.ambient, ...ambient.map(x => kAmbient * x * unitOf));
    gl.uniform3f(uniforms.up, ...hull.about.grid.axes[2]);
    gl.uniform1f(uniforms.showsAssumed, this.showsAssumed ? 1 : 0);
    gl.bindVertexArray(this.hullArray);
    gl.drawElements(gl.TRIANGLES, hull.triangles.length, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
  }

  /** Lays the kept solid over what is drawn, behind what is nearer. */
  drawLayer(view) {
    const {gl, layer, canvas} = this;
    gl.useProgram(layer.program);
    gl.uniform1i(layer.uniforms.colours, 0);
    gl.uniform1i(layer.uniforms.depths, 1);
    gl.uniform1i(layer.uniforms.finer, layer.finer);
    gl.uniform2f(layer.uniforms.texel, 1 / canvas.width, 1 / canvas.height);
    gl.uniform1f(layer.uniforms.exposure, this.exposure * this.unit / Math.PI);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, layer.depths);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, layer.colours);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(...this.boundsOfSolid(view));
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ZERO, gl.ONE);
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.disable(gl.BLEND);
    gl.disable(gl.SCISSOR_TEST);
  }

  /** Left, bottom, width, height in the canvas of all that the solid may cover. */
  boundsOfSolid(view) {
    const {canvas: {width, height}, hull: {box}} = this;
    const [low, high] = [[1, 1], [-1, -1]];
    for (let corner = 0; corner < 8; ++corner) {
      const p = [0, 1, 2].map(i => box[(corner >> i) & 1][i]);
      const [x, y, w] = [0, 1, 3].map(r => view[r] * p[0] + view[4 + r] * p[1] + view[8 + r] * p[2] + view[12 + r]);
      if (w <= 0) {
        return [0, 0, width, height];
      }
      [x / w, y / w].forEach((v, i) => {
        low[i] = Math.min(low[i], v);
        high[i] = Math.max(high[i], v);
      });
    }
    const at = (v, n) => Math.round(Math.min(1, Math.max(0, 0.5 + 0.5 * v)) * n);
    const [left, bottom] = [at(low[0], width), at(low[1], height)];
    return [left, bottom, at(high[0], width) - left + 1, at(high[1], height) - bottom + 1];
  }

  /** What the canvas shows, 4 bytes per pixel, from the upper left. */
  pixels() {
    const {gl, canvas: {width, height}} = this;
    const upward = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upward);
    const data = new Uint8ClampedArray(upward.length);
    for (let y = 0; y < height; ++y) {
      data.set(upward.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
    }
    return {width, height, data};
  }
}
