// SPDX-License-Identifier: Apache-2.0
// What every user of WebGL here needs.

/** What the browser lacks, in words for the user. */
export class NoGraphics extends Error {}

export function link(gl, vertex, fragment) {
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

/** Whether the processor plays the graphics processor. */
export function isSoftware(gl) {
  let name = gl.getParameter(gl.RENDERER);
  if (/^WebKit/.test(name)) {  // which hides the name there
    const info = gl.getExtension('WEBGL_debug_renderer_info');
    name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : name;
  }
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}
