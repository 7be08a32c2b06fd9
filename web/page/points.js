// SPDX-License-Identifier: Apache-2.0
// Draws all obstacle points into one picture, pixel by pixel: canvas calls for 200 000 points would take the whole frame.
import { MAX_POINTS } from './model.js';

const little = new Uint8Array(new Uint32Array([1]).buffer)[0] === 1;
const pack = ([r, g, b], a) => (little ? (a << 24 | b << 16 | g << 8 | r) : (r << 24 | g << 16 | b << 8 | a)) >>> 0;
const SHADES = 8;

// Returns the pixels of a disc as [row, first column, length], relative to its middle.
function disc(diameter) {
  const rows = [];
  const middle = (diameter - 1) / 2;
  for (let y = 0; y < diameter; y++) {
    const half = Math.sqrt(Math.max(0, (diameter / 2) ** 2 - (y - middle) ** 2));
    const from = Math.ceil(middle - half);
    rows.push([y - Math.floor(middle), from - Math.floor(middle), Math.floor(middle + half) - from + 1]);
  }
  return rows;
}

export class Points {
  constructor() {
    this.canvas = new OffscreenCanvas(1, 1);
    this.context = this.canvas.getContext('2d');
  }

  resize(width, height) {
    if (this.image && this.image.width === width && this.image.height === height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    this.image = this.context.createImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
  }

  // `view` is in device pixels; points newer than `time` are left out. Returns the picture.
  draw(robots, view, width, height, chosen, time) {
    this.resize(width, height);
    this.pixels.fill(0);
    const size = Math.max(2, Math.min(9, Math.round(view.scale * 1.3 * (robots.length > 20 ? 0.7 : 1))));
    const rows = disc(size);
    for (const robot of robots) {
      if (!robot.points) continue;
      const strength = chosen && chosen !== robot ? 0.35 : 1;
      const shades = Array.from({ length: SHADES + 1 }, (_, i) => pack(robot.colour, Math.round(255 * strength * (0.1 + 0.8 * i / SHADES))));
      this.plot(robot, view, width, height, rows, size, shades, time);
    }
    this.context.putImageData(this.image, 0, 0);
    return this.canvas;
  }

  plot(robot, view, width, height, rows, size, shades, time) {
    const { points, times } = robot;
    const { pixels } = this;
    const end = Math.min(robot.pointCount, MAX_POINTS) * 3;
    const { scale, left, top } = view;
    for (let i = 0; i < end; i += 3) {
      const x = (left + points[i] * scale) | 0;
      const y = (top - points[i + 1] * scale) | 0;
      if (times[i / 3] > time || x < size || y < size || x >= width - size || y >= height - size) continue;
      const colour = shades[(points[i + 2] * SHADES) | 0];
      for (let r = 0; r < rows.length; r++) {
        const row = rows[r];
        let at = (y + row[0]) * width + x + row[1];
        for (let n = row[2]; n > 0; n--) pixels[at++] = colour;
      }
    }
  }
}
