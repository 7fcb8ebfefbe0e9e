// SPDX-License-Identifier: Apache-2.0
// How bright a linear picture is shown: apps/haarlight/display_exposure.cpp's rule.

const kShare = 0.995;  // of the values are shown as white or less

/** The k-th smallest of `values`, which are put into another order. */
export function kthSmallest(values, k) {
  let [low, high] = [0, values.length - 1];
  while (low < high) {
    const pivot = values[(low + high) >> 1];
    let [i, j] = [low, high];
    while (i <= j) {
      while (values[i] < pivot) ++i;
      while (values[j] > pivot) --j;
      if (i <= j) {
        [values[i], values[j]] = [values[j], values[i]];
        ++i;
        --j;
      }
    }
    if (k <= j) {
      high = j;
    } else if (k >= i) {
      low = i;
    } else {
      break;
    }
  }
  return values[k];
}

/** @param values  used up */
export function displayExposure(values) {
  if (values.length === 0) {
    return 1;
  }
  const at = kthSmallest(values, Math.floor(kShare * (values.length - 1)));
  return at > 0 ? 1 / at : 1;
}
