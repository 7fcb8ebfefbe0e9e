// SPDX-License-Identifier: Apache-2.0
// A worker that casts the hull's shadow: what ShadowEngine (shadow_engine.js) asks of it.

import {HullShadow, castRows, castingDistances} from './hull_shadow.js';

let shadow = null;
let plan = null;

addEventListener('message', ({data}) => {
  if (data.hull) {
    shadow = new HullShadow(data.hull.size, castingDistances(data.hull.size, data.hull.voxels));
    postMessage({isReady: true});
  } else if (data.plan) {
    ({plan} = data);
  } else {
    const {face, begin, end, from, to} = data.unit;
    const begun = performance.now();
    const sums = castRows(shadow, face.grid, face.cols, begin, end, plan, from, to);
    postMessage({sums, ms: performance.now() - begun}, [sums.buffer]);
  }
});
