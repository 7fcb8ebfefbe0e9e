// SPDX-License-Identifier: Apache-2.0
// A camera that is turned about what it looks at: by dragging, the wheel, two fingers or keys.

const kTurn = 0.5 * Math.PI / 180;  // of a CSS pixel
const kKeyTurn = 5 * Math.PI / 180;
const kZoom = 1.1;
const kSteepest = 0.999;  // how much of `up` it may look along

const plus = (a, b, f = 1) => a.map((v, i) => v + f * b[i]);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => a.map(v => v / Math.hypot(...a));

/** Rodrigues' formula. @param axis  unit */
const rotated = (v, axis, angle) => {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return plus(plus(v.map(x => c * x), cross(axis, v), s), axis, (1 - c) * dot(axis, v));
};

/** @return  the camera, with its eye turned to the right and upwards by these angles */
export function turned(camera, right, upwards) {
  const up = unit(camera.up);
  let arm = rotated(plus(camera.eye, camera.target, -1), up, -right);
  const raised = rotated(arm, unit(cross(arm, up)), upwards);
  const steep = Math.abs(dot(unit(raised), up));
  if (steep < kSteepest || steep < Math.abs(dot(unit(arm), up))) {
    arm = raised;
  }
  return {...camera, eye: plus(camera.target, arm)};
}

/** @return  the camera, so many times nearer */
export function nearer(camera, factor) {
  return camera.width_mm ? {...camera, width_mm: camera.width_mm / factor}
    : {...camera, eye: plus(camera.target, plus(camera.eye, camera.target, -1), 1 / factor)};
}

/** @param moved  (camera, at) when the user has turned it; get() gives the camera now, home() that of the file */
export function connectOrbit(canvas, {get, home, moved}) {
  const fingers = new Map();
  const gap = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener('pointerdown', event => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
  });
  canvas.addEventListener('pointermove', event => {
    const before = fingers.get(event.pointerId);
    if (!before || fingers.size > 2) {
      return;
    }
    const wasApart = fingers.size === 2 ? gap() : 0;
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    moved(fingers.size === 2 ? nearer(get(), gap() / Math.max(1, wasApart))
      : turned(get(), kTurn * (event.clientX - before.x), kTurn * (event.clientY - before.y)), event.timeStamp);
  });
  for (const name of ['pointerup', 'pointercancel']) {
    canvas.addEventListener(name, event => fingers.delete(event.pointerId));
  }
  canvas.addEventListener('wheel', event => {
    event.preventDefault();
    moved(nearer(get(), event.deltaY < 0 ? kZoom : 1 / kZoom), event.timeStamp);
  }, {passive: false});
  canvas.addEventListener('keydown', event => {
    const angle = kKeyTurn * (event.shiftKey ? 4 : 1);
    const actions = {
      ArrowLeft: () => turned(get(), -angle, 0), ArrowRight: () => turned(get(), angle, 0),
      ArrowUp: () => turned(get(), 0, -angle), ArrowDown: () => turned(get(), 0, angle),
      '+': () => nearer(get(), kZoom), '=': () => nearer(get(), kZoom), '-': () => nearer(get(), 1 / kZoom), Home: home,
    };
    if (actions[event.key] && !event.ctrlKey && !event.metaKey) {
      moved(actions[event.key](), event.timeStamp);
      event.preventDefault();
    }
  });
}
