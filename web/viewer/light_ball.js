// SPDX-License-Identifier: Apache-2.0
// Where a light stands over the picture, as a hemisphere seen from the eye: the middle is straight
// above, the rim the horizon.

const kRim = 0.94;  // of the canvas's half: room for the light's mark on the rim
const kStep = 3 * Math.PI / 180;  // of an arrow key

export class LightBall {
  /** @param moved  (light, at): a unit vector x right, y up, z to the eye; when the user moved */
  constructor(canvas, moved) {
    Object.assign(this, {canvas, moved});
    this.light = [0, 0, 1];
    const point = event => {
      const box = canvas.getBoundingClientRect();
      const radius = box.width / 2 * kRim;
      this.put((event.clientX - box.left - box.width / 2) / radius, -(event.clientY - box.top - box.height / 2) / radius,
               event.timeStamp);
    };
    canvas.addEventListener('pointerdown', event => {
      canvas.setPointerCapture(event.pointerId);
      point(event);
    });
    canvas.addEventListener('pointermove', event => {
      if (event.buttons & 1) {
        point(event);
      }
    });
    canvas.addEventListener('keydown', event => {
      const [x, y] = this.light;
      const steps = {ArrowLeft: [-kStep, 0], ArrowRight: [kStep, 0], ArrowUp: [0, kStep], ArrowDown: [0, -kStep]};
      if (event.key === 'Home') {
        this.put(0, 0, event.timeStamp);
      } else if (steps[event.key]) {
        const factor = event.shiftKey ? 4 : 1;
        this.put(x + factor * steps[event.key][0], y + factor * steps[event.key][1], event.timeStamp);
      } else {
        return;
      }
      event.preventDefault();
    });
    this.draw();
  }

  /** A light over (x, y) of the disc; from beyond the rim it stands on the rim. */
  put(x, y, at) {
    const size = Math.hypot(x, y);
    const [u, v] = size > 1 ? [x / size, y / size] : [x, y];
    this.light = [u, v, Math.sqrt(Math.max(0, 1 - u * u - v * v))];
    this.draw();
    this.moved(this.light, at);
  }

  draw() {
    const {canvas} = this;
    const context = canvas.getContext('2d');
    const style = getComputedStyle(canvas);
    const [middle, radius] = [canvas.width / 2, canvas.width / 2 * kRim];
    const [x, y] = [middle + radius * this.light[0], middle - radius * this.light[1]];
    context.clearRect(0, 0, canvas.width, canvas.height);
    const shade = context.createRadialGradient(x, y, 0, x, y, 1.6 * radius);
    shade.addColorStop(0, '#f4f4f0');
    shade.addColorStop(1, '#23272e');
    context.fillStyle = shade;
    context.beginPath();
    context.arc(middle, middle, radius, 0, 2 * Math.PI);
    context.fill();
    context.strokeStyle = style.getPropertyValue('--light-ring');
    context.lineWidth = 3;
    context.stroke();
    context.beginPath();
    context.arc(x, y, 12, 0, 2 * Math.PI);
    context.fillStyle = '#fff';
    context.fill();
    context.strokeStyle = '#000';
    context.stroke();
  }
}
