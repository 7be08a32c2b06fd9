// SPDX-License-Identifier: Apache-2.0
// Histograms of the newest values: arrival intervals and latency, as in the thesis's chapter 8, but live.
import { colour, surface } from './dom.js';

const KEPT = 5000;
const BINS = 40;
const NICE_MS = [20, 40, 100, 200, 400, 1000, 2000, 4000, 10000, 20000, 40000, 100000];

export class Histogram {
  constructor() {
    this.clear();
  }
  clear() {
    this.values = new Float64Array(KEPT);
    this.count = 0;
  }
  add(value) {
    this.values[this.count++ % KEPT] = value;
  }
  sorted() {
    return this.values.slice(0, Math.min(this.count, KEPT)).sort();
  }

  // null while there is nothing.
  summary() {
    const sorted = this.sorted();
    if (!sorted.length) return null;
    const at = (share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
    return { sorted, n: sorted.length, mean: sorted.reduce((a, b) => a + b, 0) / sorted.length, p50: at(0.5), p99: at(0.99) };
  }

  draw(canvas, summary) {
    const on = surface(canvas);
    if (!on) return;
    const { context, width, height } = on;
    const base = height - 18;
    const most = summary ? NICE_MS.find((ms) => ms >= summary.p99 * 1.15) ?? summary.p99 * 1.15 : 1000;
    const bins = new Uint32Array(BINS + 1); // the last: beyond
    for (const value of summary?.sorted ?? []) bins[Math.min(BINS, Math.max(0, Math.floor(value / most * BINS)))]++;
    const highest = Math.max(1, ...bins);
    const step = width / (BINS + 1);
    context.fillStyle = colour('--accent');
    bins.forEach((count, i) => {
      const tall = count && Math.max(1.5, count / highest * (base - 14));
      context.globalAlpha = i === BINS ? 0.45 : 0.85;
      context.fillRect(i * step + 0.5, base - tall, step - 1, tall);
    });
    context.globalAlpha = 1;
    this.axis(context, width - step, base, most, highest);
  }
  axis(context, width, base, most, highest) {
    context.strokeStyle = colour('--line');
    context.beginPath();
    context.moveTo(0, base + 0.5);
    context.lineTo(width, base + 0.5);
    context.stroke();
    context.fillStyle = colour('--muted');
    context.font = '11px system-ui, "DejaVu Sans", sans-serif';
    for (let part = 0; part <= 4; part++) {
      const text = part === 4 ? `${most} ms` : String(most * part / 4);
      const at = width * part / 4 - (part === 0 ? 0 : context.measureText(text).width / 2);
      context.fillText(text, Math.min(at, width - context.measureText(text).width + 6), base + 14);
    }
    context.fillText(highest > 1 ? `${highest}` : '', 0, 10);
  }
}
