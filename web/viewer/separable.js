// SPDX-License-Identifier: Apache-2.0
// The DCT and the standard Haar transform of relight/basis/separable_basis.cpp, in the same order: along
// every row of a grid, then along every column. Standard Haar has the same bits; the DCT those of its cosines.

/** C[i][k] by frequency i and light k, row by row. */
function dctMatrix(n) {
  const matrix = new Float64Array(n * n);
  for (let i = 0; i < n; ++i) {
    const scale = Math.sqrt((i === 0 ? 1 : 2) / n);
    for (let k = 0; k < n; ++k) {
      matrix[i * n + k] = scale * Math.cos(Math.PI * ((2 * k + 1) * i % (4 * n)) / (2 * n));
    }
  }
  return matrix;
}

const matrices = new Map();  // by side

function matrixOf(n) {
  if (!matrices.has(n)) {
    matrices.set(n, dctMatrix(n));
  }
  return matrices.get(n);
}

/** In place on a line of n numbers `stride` apart. */
function dctLine(x, first, stride, n, isForward) {
  const matrix = matrixOf(n);
  const line = new Float64Array(n);
  for (let from = 0; from < n; ++from) {
    const value = x[first + from * stride];
    for (let to = 0; value !== 0 && to < n; ++to) {
      line[to] += value * (isForward ? matrix[to * n + from] : matrix[from * n + to]);
    }
  }
  line.forEach((value, i) => (x[first + i * stride] = value));
}

const kRootHalf = 1 / Math.SQRT2;

/** All levels of 2^m numbers: sums first, then details. */
function haarLine(x, first, stride, n, isForward) {
  const old = new Float64Array(n);
  const split = length => {
    for (let i = 0; i < length / 2; ++i) {
      x[first + i * stride] = kRootHalf * (old[2 * i] + old[2 * i + 1]);
      x[first + (length / 2 + i) * stride] = kRootHalf * (old[2 * i] - old[2 * i + 1]);
    }
  };
  const join = length => {
    for (let i = 0; i < length / 2; ++i) {
      x[first + 2 * i * stride] = kRootHalf * (old[i] + old[length / 2 + i]);
      x[first + (2 * i + 1) * stride] = kRootHalf * (old[i] - old[length / 2 + i]);
    }
  };
  for (let length = isForward ? n : 2; length > 1 && length <= n; length = isForward ? length / 2 : 2 * length) {
    for (let i = 0; i < length; ++i) {
      old[i] = x[first + i * stride];
    }
    isForward ? split(length) : join(length);
  }
}

function transform(x, start, {rows, cols}, line, isForward) {
  for (let row = 0; row < rows; ++row) {
    line(x, start + row * cols, 1, cols, isForward);
  }
  for (let col = 0; col < cols; ++col) {
    line(x, start + col, cols, rows, isForward);
  }
}

/** In place on rows x cols numbers at `start`. */
export const dctForward = (x, start, grid) => transform(x, start, grid, dctLine, true);
export const dctInverse = (x, start, grid) => transform(x, start, grid, dctLine, false);
export const standardHaarForward = (x, start, grid) => transform(x, start, grid, haarLine, true);
export const standardHaarInverse = (x, start, grid) => transform(x, start, grid, haarLine, false);
