// SPDX-License-Identifier: Apache-2.0
// How much of a light each point of a receiver gets past the shadow hull: relight/hull/hull_caster.cpp
// and relight/shadow/receiver_light.cpp in JavaScript. Runs in workers (shadow_worker.js).
//
// Everything here is in grid coordinates: voxel (i, j, k) is the cube from (i, j, k) to (i + 1, …).

const kFar = 255;
const kRays = 6;             // per side of a light
const kPilot = [0, 3, 5];    // of these, those that decide where they are alike

const kRayGrid = Array.from({length: kRays * kRays}, (_, ray) => ({i: ray % kRays, j: Math.floor(ray / kRays)}));
const isPilot = ({i, j}) => kPilot.includes(i) && kPilot.includes(j);
const onLight = ({i, j}) => ({a: (i + 0.5) / kRays - 0.5, b: (j + 0.5) / kRays - 0.5});  // in its sides
const kPilotRays = kRayGrid.filter(isPilot).map(onLight);
const kOtherRays = kRayGrid.filter(ray => !isPilot(ray)).map(onLight);
const kFarSides = 10;    // of a light: from here on four Gauss points suffice
const kNearPoints = 8;   // per side of a light that is nearer or at the horizon
const kNudge = 1e-7;
const kNoSlope = 1e-12;  // of a ray that is parallel to a wall of voxels
export const kBlock = 8; // receiver points per side that share a test whether a light is clear

/** Numbers of a source in its list: centre 3, u 3, v 3 (whole sides), emits 3, lobe, power of three colours. */
export const kSourceNumbers = 16;

/** Distances to the nearest voxel that casts: its Chebyshev distance in voxels, 0: itself. */
export function castingDistances([nx, ny, nz], voxels) {
  // With a border of one voxel all round, so that every voxel has 26 neighbours.
  const row = nx + 2;
  const layer = row * (ny + 2);
  const padded = new Uint8Array(layer * (nz + 2)).fill(kFar);
  const eachRow = act => {
    for (let z = 0, i = 0; z < nz; ++z) {
      for (let y = 0; y < ny; ++y, i += nx) {
        act(i, (z + 1) * layer + (y + 1) * row + 1);
      }
    }
  };
  eachRow((i, at) => {
    for (let x = 0; x < nx; ++x, ++i) {
      const state = (voxels[i >> 2] >> (2 * (i & 3))) & 3;
      padded[at + x] = state === 1 || state === 2 ? 0 : kFar;  // matter, assumed full
    }
  });
  // Two sweeps over half of the neighbours each are exact for this distance.
  const before = [-1, -row - 1, -row, -row + 1];
  for (const y of [-row, 0, row]) {
    before.push(y - layer - 1, y - layer, y - layer + 1);
  }
  const offsets = Int32Array.from(before);
  const sweep = (at, x, sign) => {
    const i = at + x;
    let least = padded[i];
    for (let n = 0; n < offsets.length; ++n) {
      const there = padded[i + sign * offsets[n]] + 1;
      least = there < least ? there : least;
    }
    padded[i] = least;
  };
  const rows = [];
  eachRow((_, at) => rows.push(at));
  rows.forEach(at => {
    for (let x = 0; x < nx; ++x) {
      sweep(at, x, 1);
    }
  });
  rows.reverse().forEach(at => {
    for (let x = nx - 1; x >= 0; --x) {
      sweep(at, x, -1);
    }
  });
  const distance = new Uint8Array(nx * ny * nz);
  eachRow((i, at) => distance.set(padded.subarray(at, at + nx), i));
  return distance;
}

export class HullShadow {
  /** @param distance  castingDistances() */
  constructor([nx, ny, nz], distance) {
    Object.assign(this, {nx, ny, nz, distance, nRays: 0});
    // The box around all that casts.
    const low = [nx, ny, nz];
    const high = [0, 0, 0];
    for (let z = 0, i = 0; z < nz; ++z) {
      for (let y = 0; y < ny; ++y) {
        for (let x = 0; x < nx; ++x, ++i) {
          if (distance[i] === 0) {
            low[0] = Math.min(low[0], x);
            low[1] = Math.min(low[1], y);
            low[2] = Math.min(low[2], z);
            high[0] = Math.max(high[0], x + 1);
            high[1] = Math.max(high[1], y + 1);
            high[2] = Math.max(high[2], z + 1);
          }
        }
      }
    }
    Object.assign(this, {low, high});
    [this.lowX, this.lowY, this.lowZ] = low;
    [this.highX, this.highY, this.highZ] = high;
  }

  /** Whether anything casts on the line from p to p + d. */
  isBlocked(px, py, pz, dx, dy, dz) {
    const {nx, ny, distance, lowX, lowY, lowZ, highX, highY, highZ} = this;
    ++this.nRays;
    const ix = 1 / (dx === 0 ? kNoSlope : dx);
    const iy = 1 / (dy === 0 ? kNoSlope : dy);
    const iz = 1 / (dz === 0 ? kNoSlope : dz);
    const ax = (lowX - px) * ix;
    const bx = (highX - px) * ix;
    const ay = (lowY - py) * iy;
    const by = (highY - py) * iy;
    const az = (lowZ - pz) * iz;
    const bz = (highZ - pz) * iz;
    let t = Math.max(0, Math.min(ax, bx), Math.min(ay, by), Math.min(az, bz));
    const end = Math.min(1, Math.max(ax, bx), Math.max(ay, by), Math.max(az, bz));
    if (!(t < end)) {
      return false;
    }
    const nudge = kNudge / Math.max(Math.abs(dx), Math.abs(dy), Math.abs(dz));
    t += nudge;
    while (t < end) {
      let x = (px + t * dx) | 0;  // never negative: within the box
      let y = (py + t * dy) | 0;
      let z = (pz + t * dz) | 0;
      x = x < lowX ? lowX : x >= highX ? highX - 1 : x;
      y = y < lowY ? lowY : y >= highY ? highY - 1 : y;
      z = z < lowZ ? lowZ : z >= highZ ? highZ - 1 : z;
      const reach = distance[(z * ny + y) * nx + x];
      if (reach === 0) {
        return true;
      }
      // Nothing casts fewer than `reach` voxels away, along any axis.
      const tx = (x + (ix > 0 ? reach : 1 - reach) - px) * ix;
      const ty = (y + (iy > 0 ? reach : 1 - reach) - py) * iy;
      const tz = (z + (iz > 0 ? reach : 1 - reach) - pz) * iz;
      let next = tx < ty ? tx : ty;
      next = next < tz ? next : tz;
      t = (next > t ? next : t) + nudge;
    }
    return false;
  }

  /** Whether nothing casts within `begin` of p, `finish` of p + d, and evenly between. */
  isClear(px, py, pz, dx, dy, dz, begin, finish) {
    const {nx, ny, distance, lowX, lowY, lowZ, highX, highY, highZ} = this;
    const margin = Math.max(begin, finish);
    const ix = 1 / (dx === 0 ? kNoSlope : dx);
    const iy = 1 / (dy === 0 ? kNoSlope : dy);
    const iz = 1 / (dz === 0 ? kNoSlope : dz);
    const ax = (lowX - margin - px) * ix;
    const bx = (highX + margin - px) * ix;
    const ay = (lowY - margin - py) * iy;
    const by = (highY + margin - py) * iy;
    const az = (lowZ - margin - pz) * iz;
    const bz = (highZ + margin - pz) * iz;
    let t = Math.max(0, Math.min(ax, bx), Math.min(ay, by), Math.min(az, bz));
    const end = Math.min(1, Math.max(ax, bx), Math.max(ay, by), Math.max(az, bz));
    const perVoxel = 1 / (Math.sqrt(dx * dx + dy * dy + dz * dz) + Math.max(0, finish - begin));
    while (t < end) {
      const x = px + t * dx;
      const y = py + t * dy;
      const z = pz + t * dz;
      const outside = Math.max(0, lowX - x, x - highX, lowY - y, y - highY, lowZ - z, z - highZ);
      const cx = x < lowX ? lowX : x >= highX ? highX - 1 : x | 0;
      const cy = y < lowY ? lowY : y >= highY ? highY - 1 : y | 0;
      const cz = z < lowZ ? lowZ : z >= highZ ? highZ - 1 : z | 0;
      const inside = distance[(cz * ny + cy) * nx + cx] - 1 - outside;
      const step = (inside > outside ? inside : outside) - (begin + (finish - begin) * t);
      if (step < 0.25) {
        return false;
      }
      t += step * perVoxel;
    }
    return true;
  }

  /** The visible fraction of source s, as HullCaster::look() finds it. */
  visibility(px, py, pz, sources, s) {
    const dx = sources[s] - px;
    const dy = sources[s + 1] - py;
    const dz = sources[s + 2] - pz;
    const ux = sources[s + 3];
    const uy = sources[s + 4];
    const uz = sources[s + 5];
    const vx = sources[s + 6];
    const vy = sources[s + 7];
    const vz = sources[s + 8];
    if (this.isClear(px, py, pz, dx, dy, dz, 0, radiusOf(sources, s))) {
      return 1;
    }
    const countOpen = rays => {
      let open = 0;
      for (const {a, b} of rays) {
        open += this.isBlocked(px, py, pz, dx + a * ux + b * vx, dy + a * uy + b * vy, dz + a * uz + b * vz) ? 0 : 1;
      }
      return open;
    };
    const open = countOpen(kPilotRays);
    return open === 0 || open === kPilotRays.length ? open / kPilotRays.length
                                                    : (open + countOpen(kOtherRays)) / (kRays * kRays);
  }
}

/**
 * Irradiance of source s at radiance 1, in units of its radiance: receiver_irradiance(), but for lights that
 * are near or cut by the horizon, which are summed over 8 x 8 points here.
 */
export function irradiance(px, py, pz, nx, ny, nz, sources, s) {
  const x = sources[s] - px;
  const y = sources[s + 1] - py;
  const z = sources[s + 2] - pz;
  const over = nx * x + ny * y + nz * z;
  const before = -(sources[s + 9] * x + sources[s + 10] * y + sources[s + 11] * z);
  if (!(over > 0 && before > 0)) {
    return 0;  // its centre is below the horizon, or the point is behind the light
  }
  const ux = sources[s + 3];
  const uy = sources[s + 4];
  const uz = sources[s + 5];
  const vx = sources[s + 6];
  const vy = sources[s + 7];
  const vz = sources[s + 8];
  const lobe = sources[s + 12];
  const u2 = ux * ux + uy * uy + uz * uz;
  const v2 = vx * vx + vy * vy + vz * vz;
  const reach = 0.5 * (Math.abs(nx * ux + ny * uy + nz * uz) + Math.abs(nx * vx + ny * vy + nz * vz));
  const isFar = x * x + y * y + z * z >= kFarSides * kFarSides * Math.max(u2, v2) && over >= reach;
  const n = isFar ? 2 : kNearPoints;
  const q = isFar ? 0.5 / Math.sqrt(3) : 0;
  let sum = 0;
  for (let j = 0; j < n; ++j) {
    const b = isFar ? (2 * j - 1) * q : (j + 0.5) / n - 0.5;
    for (let i = 0; i < n; ++i) {
      const a = isFar ? (2 * i - 1) * q : (i + 0.5) / n - 0.5;
      const sx = x + a * ux + b * vx;
      const sy = y + a * uy + b * vy;
      const sz = z + a * uz + b * vz;
      const d2 = sx * sx + sy * sy + sz * sz;
      const cosine = nx * sx + ny * sy + nz * sz;
      if (cosine > 0) {
        sum += cosine * before / (d2 * d2) * (lobe === 1 ? 1 : (before / Math.sqrt(d2)) ** (lobe - 1));
      }
    }
  }
  return Math.sqrt(u2 * v2) * sum / (n * n);
}

/** A number in [0, 1) for a receiver point, unlike its neighbours' [interleaved gradient noise]. */
const noiseAt = (i, j) => {
  const v = 52.9829189 * ((0.06711056 * i + 0.00583715 * j) % 1);
  return v - Math.floor(v);
};
const kGolden = 0.6180339887498949;

/**
 * One point in place of a group of sources: where the ray goes to, chosen by `t` in [0, 1) by their power.
 * @param at  filled: the point
 */
function pointOf(group, sources, t, at) {
  let m = group.first;
  let left = t * group.power;
  while (m < group.end - 1 && left >= group.powers[m]) {
    left -= group.powers[m];
    ++m;
  }
  const s = kSourceNumbers * m;
  const a = Math.min(0.999, left / group.powers[m]);  // goes on being random within the source
  const v = (a * 16) % 1;
  for (let axis = 0; axis < 3; ++axis) {
    at[axis] = sources[s + axis] + (a - 0.5) * sources[s + 3 + axis] + (v - 0.5) * sources[s + 6 + axis];
  }
}

const lengthAt = (list, s) => Math.hypot(list[s], list[s + 1], list[s + 2]);
const areaOf = (list, s) => lengthAt(list, s + 3) * lengthAt(list, s + 6);
const radiusOf = (list, s) => 0.5 * (lengthAt(list, s + 3) + lengthAt(list, s + 6));

/** Sources first … end - 1 of a list taken as one: in their weighted middle, with all their power and one's shape. */
function together(list, powers, first, end) {
  const s = kSourceNumbers * first;
  const whole = list.slice(s, s + kSourceNumbers);
  whole.fill(0, 0, 3);
  whole.fill(0, 13);
  const area = areaOf(list, s);
  let power = 0;
  for (let i = first, at = s; i < end; ++i, at += kSourceNumbers) {
    power += powers[i];
    for (let axis = 0; axis < 3; ++axis) {
      whole[axis] += powers[i] * list[at + axis];
      whole[13 + axis] += list[at + 13 + axis] * areaOf(list, at) / area;
    }
  }
  for (let axis = 0; axis < 3; ++axis) {
    whole[axis] /= power;
  }
  let radius = 0;
  for (let i = first, at = s; i < end; ++i, at += kSourceNumbers) {
    const apart = Math.hypot(list[at] - whole[0], list[at + 1] - whole[1], list[at + 2] - whole[2]);
    radius = Math.max(radius, apart + radiusOf(list, at));
  }
  return {first, end, power, powers, whole, radius};
}

/**
 * At most `most` groups of sources that stand together: the strongest is split where it is widest, until there are so many.
 * @return  the sources in the groups' order, and the groups
 */
export function groupSources(sources, most) {
  const n = sources.length / kSourceNumbers;
  const powerOf = i => {
    const s = kSourceNumbers * i;
    return (sources[s + 13] + sources[s + 14] + sources[s + 15]) * areaOf(sources, s);
  };
  const order = Array.from({length: n}, (_, i) => i);
  const parts = [{first: 0, end: n, power: order.reduce((sum, i) => sum + powerOf(i), 0)}];
  while (parts.length < Math.min(most, n)) {
    let at = -1;
    parts.forEach((part, p) => {
      if (part.end - part.first > 1 && (at < 0 || part.power > parts[at].power)) {
        at = p;
      }
    });
    const {first, end, power} = parts[at];
    const members = order.slice(first, end);
    const placeOf = (i, axis) => sources[kSourceNumbers * i + axis];
    const widths = [0, 1, 2].map(axis => {
      const places = members.map(i => placeOf(i, axis));
      return Math.max(...places) - Math.min(...places);
    });
    const axis = widths.indexOf(Math.max(...widths));
    members.sort((a, b) => placeOf(a, axis) - placeOf(b, axis) || a - b);
    let [half, cut] = [0, 0];
    while (cut < members.length - 1 && (cut === 0 || half + 0.5 * powerOf(members[cut]) < 0.5 * power)) {
      half += powerOf(members[cut++]);
    }
    members.forEach((i, place) => (order[first + place] = i));
    parts.splice(at, 1, {first, end: first + cut, power: half}, {first: first + cut, end, power: power - half});
  }
  const sorted = new Float64Array(sources.length);
  order.forEach((i, place) =>
    sorted.set(sources.subarray(kSourceNumbers * i, kSourceNumbers * (i + 1)), kSourceNumbers * place));
  const powers = Float64Array.from(order, powerOf);
  return {sources: sorted, groups: parts.map(({first, end}) => together(sorted, powers, first, end))};
}

/** Of a plan: what its rays go to. */
export const countOf = plan => plan.groups ? plan.groups.length : plan.sources.length / kSourceNumbers;

/**
 * Irradiance of rows [begin, end) of a receiver's face: sums over sources, shadowed and not, three colours each.
 * @param face  {corner, across, down, normal}: of grid coordinates; `across` and `down` from point to point
 * @param plan  {sources, groups, rays}: rays of each group; without groups every source as the command does it
 * @param from, to  of the plan's groups or sources
 * @return  6 numbers per point
 */
export function castRows(shadow, face, cols, begin, end, plan, from, to) {
  const out = new Float32Array(6 * cols * (end - begin));
  const {corner, across, down, normal} = face;
  const at = [0, 0, 0];
  for (let top = begin; top < end; top += kBlock) {
    const bottom = Math.min(end, top + kBlock);
    for (let left = 0; left < cols; left += kBlock) {
      const right = Math.min(cols, left + kBlock);
      const [a, b] = [0.5 * (left + right), 0.5 * (top + bottom)];
      const middle = [0, 1, 2].map(i => corner[i] + a * across[i] + b * down[i]);
      const around = 0.5 * Math.hypot((right - left) * Math.hypot(...across), (bottom - top) * Math.hypot(...down));
      for (let k = from; k < to; ++k) {
        const group = plan.groups?.[k];
        const list = group ? group.whole : plan.sources;
        const s = group ? 0 : kSourceNumbers * k;
        const isLit = shadow.isClear(middle[0], middle[1], middle[2], list[s] - middle[0], list[s + 1] - middle[1],
                                     list[s + 2] - middle[2], around, group ? group.radius : radiusOf(list, s));
        for (let j = top; j < bottom; ++j) {
          for (let i = left; i < right; ++i) {
            const px = corner[0] + (i + 0.5) * across[0] + (j + 0.5) * down[0];
            const py = corner[1] + (i + 0.5) * across[1] + (j + 0.5) * down[1];
            const pz = corner[2] + (i + 0.5) * across[2] + (j + 0.5) * down[2];
            const E = irradiance(px, py, pz, normal[0], normal[1], normal[2], list, s);
            if (E === 0) {
              continue;
            }
            let V = 1;
            if (!isLit && group) {
              const first = noiseAt(i, j) + k * kGolden;
              V = 0;
              for (let ray = 0; ray < plan.rays; ++ray) {
                pointOf(group, plan.sources, (first + ray / plan.rays) % 1, at);
                V += shadow.isBlocked(px, py, pz, at[0] - px, at[1] - py, at[2] - pz) ? 0 : 1;
              }
              V /= plan.rays;
            } else if (!isLit) {
              V = shadow.visibility(px, py, pz, list, s);
            }
            const place = 6 * ((j - begin) * cols + i);
            for (let c = 0; c < 3; ++c) {
              const light = E * list[s + 13 + c];
              out[place + c] += light * V;
              out[place + 3 + c] += light;
            }
          }
        }
      }
    }
  }
  return out;
}
