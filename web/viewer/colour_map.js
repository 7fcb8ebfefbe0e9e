// SPDX-License-Identifier: Apache-2.0
// How a pixel's bytes become a colour under a light: relight/reflectance/formats/reflectance.cpp, operation by
// operation, for folders that no server stands behind.

const kLeast = 0.001;  // of the sum of radial functions: what counts

function ptmTerms([u, v]) {
  return [u * u, v * v, u * v, u, v, 1];
}

function hshTerms([x, y, z], n, order4) {
  const root = value => Math.sqrt(value / Math.PI);
  const c = Math.min(1, Math.max(0, z));
  const q = Math.sqrt(c - c * c);
  const rho = Math.hypot(x, y);
  const [cos1, sin1] = rho > 0 ? [x / rho, y / rho] : [1, 0];
  const [cos2, sin2] = [cos1 * cos1 - sin1 * sin1, 2 * cos1 * sin1];
  const m = 2 * c - 1;
  const h = [root(0.5), root(6) * cos1 * q, root(1.5) * m, root(6) * sin1 * q];
  if (n > 4) {
    h.push(root(30) * cos2 * (c * c - c), root(30) * cos1 * m * q, root(2.5) * (1 - 6 * c + 6 * c * c),
           root(30) * sin1 * m * q, root(30) * sin2 * (c * c - c));
  }
  if (n > 9) {
    const [cos3, sin3] = [cos2 * cos1 - sin2 * sin1, sin2 * cos1 + cos2 * sin1];
    const power = order4 === 'exact' ? q * q * q : q * q;
    const p5 = 1 - 5 * c + 5 * c * c;
    h.push(2 * root(35) * cos3 * power, root(210) * cos2 * m * (c * c - c), 2 * root(21) * cos1 * q * p5,
           root(3.5) * (-1 + c * (12 + c * (-30 + c * 20))), 2 * root(21) * sin1 * q * p5,
           root(210) * sin2 * m * (c * c - c), 2 * root(35) * sin3 * power);
  }
  return h;
}

/** The light at its azimuth, at least so high: radians. */
function raised([x, y, z], least) {
  if (least <= 0 || z >= Math.sin(least)) {
    return [x, y, z];
  }
  const rho = Math.hypot(x, y);
  return rho === 0 ? [Math.cos(least), 0, Math.sin(least)]
    : [Math.cos(least) / rho * x, Math.cos(least) / rho * y, Math.sin(least)];
}

/** [[node, weight], …] of a grid on the octahedral map. */
function gridWeights(n, [x, y, z]) {
  const s = Math.abs(x) + Math.abs(y) + Math.max(z, 0);
  const position = v => s > 0 ? (v / s + 1) / 2 * (n - 1) : (n - 1) / 2;
  const [column, row] = [position(x + y), position(y - x)];
  const cell = v => Math.min(n - 2, Math.max(0, Math.floor(v)));
  const [i, j] = [cell(column), cell(row)];
  const [fx, fy] = [column - i, row - j];
  const at = j * n + i;
  return [[at, (1 - fx) * (1 - fy)], [at + 1, fx * (1 - fy)], [at + n, (1 - fx) * fy], [at + n + 1, fx * fy]];
}

/** Of radial functions without a stated width: as OpenLIME's. */
function adaptiveWeights(squares) {
  const [alpha, beta] = [8, 2];
  const distances = squares.map(Math.sqrt);
  const weights = distances.map(distance => Math.exp(-beta * distance));
  const far = distances.reduce((sum, distance, i) => sum + weights[i] * distance, 0);
  const factor = far > 0 ? alpha * weights.reduce((a, b) => a + b) / far : 0;
  const nearest = squares.reduce((a, b) => Math.min(a, b));
  const sizes = squares.map(square => Math.exp(-factor * (square - nearest)));
  const sum = sizes.reduce((a, b) => a + b);
  return sizes.map((size, node) => [node, size / sum]);
}

/** The same of radial functions around the lights. */
function radialWeights(lights, sigma, direction) {
  const squares = lights.map(light => light.reduce((sum, v, i) => sum + (direction[i] - v) ** 2, 0));
  if (sigma <= 0) {
    return adaptiveWeights(squares);
  }
  const nearest = squares.reduce((a, b) => Math.min(a, b));
  const sizes = squares.map(square => Math.exp((nearest - square) / (sigma * sigma)));
  const sum = sizes.reduce((a, b) => a + b);
  const kept = [...sizes.entries()].filter(([, size]) => size > kLeast * sum || size === 1);
  const all = kept.reduce((total, [, size]) => total + size, 0);
  return kept.map(([node, size]) => [node, size / all]);
}

/** {factors: three lists, one number per plane; added: three numbers}. @param light  unit vector */
export function colourMap(model, light) {
  const {basis, colour, terms: n, scales} = model;
  const factors = [0, 1, 2].map(() => new Array(scales.length).fill(0));
  const added = [0, 0, 0];
  if (colour === 'pca') {
    const nodes = basis === 'bilinear' ? gridWeights(model.resolution, light)
      : radialWeights(model.lights, model.sigma, light);
    for (const [node, weight] of nodes) {
      for (let c = 0; c < 3; ++c) {
        added[c] += weight * model.axes[0][3 * node + c];
        for (let p = 0; p < n; ++p) {
          factors[c][p] += weight * model.axes[p + 1][3 * node + c];
        }
      }
    }
  } else {
    const values = basis === 'ptm' ? ptmTerms(light)
      : hshTerms(raised(light, model.least_elevation), n, model.order4);
    factors.forEach((row, c) => values.forEach((value, j) => (row[(colour === 'rgb' ? c * n : 0) + j] = value)));
  }
  factors.forEach((row, c) => scales.forEach(([scale, offset], p) => {
    added[c] += row[p] * offset;
    row[p] *= scale;
  }));
  return {factors, added};
}
