// The 2-D Haar transform of relight/basis/haar.cpp, operation by operation: the same bits.

/** In place on n x n numbers at `start`. */
export function haarForward(x, start, n) {
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

export function haarInverse(x, start, n) {
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
