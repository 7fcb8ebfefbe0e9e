// SPDX-License-Identifier: Apache-2.0
// The 2-D Haar transform of relight/basis/haar.cpp, operation by operation: the same bits.

const isPlain = ({rows, cols}) => rows === cols && Number.isInteger(Math.log2(rows));

/** In place on rows x cols numbers at `start`. */
export function haarForward(x, start, grid) {
  isPlain(grid) ? plainForward(x, start, grid.rows) : unbalancedForward(x, start, grid);
}

export function haarInverse(x, start, grid) {
  isPlain(grid) ? plainInverse(x, start, grid.rows) : unbalancedInverse(x, start, grid);
}

function plainForward(x, start, n) {
  const scratch = new Float64Array(n * n);
  for (let m = n; m > 1; m /= 2) {
    const h = m / 2;
    for (let row = 0; row < m; ++row) {
      for (let col = 0; col < m; ++col) {
        scratch[row * m + col] = x[start + row * n + col];
      }
    }
    for (let i = 0; i < h; ++i) {
      for (let j = 0; j < h; ++j) {
        const top = 2 * i * m + 2 * j;
        const bottom = top + m;
        const sumTop = scratch[top] + scratch[top + 1];
        const sumBottom = scratch[bottom] + scratch[bottom + 1];
        const differenceTop = scratch[top] - scratch[top + 1];
        const differenceBottom = scratch[bottom] - scratch[bottom + 1];
        const ll = start + i * n + j;
        const yd = ll + h * n;
        x[ll] = (sumTop + sumBottom) * 0.5;
        x[ll + h] = (differenceTop + differenceBottom) * 0.5;
        x[yd] = (sumTop - sumBottom) * 0.5;
        x[yd + h] = (differenceTop - differenceBottom) * 0.5;
      }
    }
  }
}

function plainInverse(x, start, n) {
  const scratch = new Float64Array(n * n);
  for (let m = 2; m <= n; m *= 2) {
    const h = m / 2;
    for (let row = 0; row < m; ++row) {
      for (let col = 0; col < m; ++col) {
        scratch[row * m + col] = x[start + row * n + col];
      }
    }
    for (let i = 0; i < h; ++i) {
      for (let j = 0; j < h; ++j) {
        const ll = i * m + j;
        const yd = ll + h * m;
        const sumTop = scratch[ll] + scratch[yd];
        const sumBottom = scratch[ll] - scratch[yd];
        const differenceTop = scratch[ll + h] + scratch[yd + h];
        const differenceBottom = scratch[ll + h] - scratch[yd + h];
        const top = start + 2 * i * n + 2 * j;
        const bottom = top + n;
        x[top] = (sumTop + differenceTop) * 0.5;
        x[top + 1] = (sumTop - differenceTop) * 0.5;
        x[bottom] = (sumBottom + differenceBottom) * 0.5;
        x[bottom + 1] = (sumBottom - differenceBottom) * 0.5;
      }
    }
  }
}

/** Along one side of n lights, for each level: its length and the parts of each pair's values in their sum. */
function levelsOf(n) {
  const levels = [];
  let counts = new Array(n).fill(1);
  while (counts.length > 1) {
    const pairs = [];
    const merged = [];
    for (let j = 0; j + 1 < counts.length; j += 2) {
      const both = counts[j] + counts[j + 1];
      pairs.push([Math.sqrt(counts[j] / both), Math.sqrt(counts[j + 1] / both)]);
      merged.push(both);
    }
    if (counts.length % 2 === 1) {
      merged.push(counts[counts.length - 1]);
    }
    levels.push({length: counts.length, pairs});
    counts = merged;
  }
  return levels;
}

/** Lines as [first, stride, level], along x and along y, in the order of the forward transform. */
function linesOf({rows, cols}, start) {
  const [alongX, alongY] = [levelsOf(cols), levelsOf(rows)];
  const lines = [];
  for (let i = 0; i < Math.max(alongX.length, alongY.length); ++i) {
    const height = alongY[i]?.length ?? 1;
    const width = alongX[i]?.length ?? 1;
    for (let row = 0; alongX[i] && row < height; ++row) {
      lines.push([start + row * cols, 1, alongX[i]]);
    }
    for (let col = 0; alongY[i] && col < width; ++col) {
      lines.push([start + col, cols, alongY[i]]);
    }
  }
  return lines;
}

function unbalancedForward(x, start, grid) {
  for (const [first, stride, {length, pairs}] of linesOf(grid, start)) {
    const h = (length + 1) >> 1;
    const line = new Float64Array(length);
    pairs.forEach(([a, b], j) => {
      const [u, v] = [x[first + 2 * j * stride], x[first + (2 * j + 1) * stride]];
      line[j] = a * u + b * v;
      line[j + h] = b * u - a * v;
    });
    if (length % 2 === 1) {
      line[h - 1] = x[first + (length - 1) * stride];
    }
    line.forEach((value, j) => (x[first + j * stride] = value));
  }
}

function unbalancedInverse(x, start, grid) {
  for (const [first, stride, {length, pairs}] of linesOf(grid, start).reverse()) {
    const h = (length + 1) >> 1;
    const line = new Float64Array(length);
    pairs.forEach(([a, b], j) => {
      const [s, d] = [x[first + j * stride], x[first + (j + h) * stride]];
      line[2 * j] = a * s + b * d;
      line[2 * j + 1] = b * s - a * d;
    });
    if (length % 2 === 1) {
      line[length - 1] = x[first + (h - 1) * stride];
    }
    line.forEach((value, j) => (x[first + j * stride] = value));
  }
}
