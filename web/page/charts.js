// SPDX-License-Identifier: Apache-2.0
// Live histograms of the newest values: arrival intervals and latency, as in the thesis's chapter 8.
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

  // Returns null while there are no values.
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
    const bins = new Uint32Array(BINS + 1); // the last bin: all larger values
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

// Draws one robot's last 24 hours: its share of time online, repeats and gaps as bars, its signal and latency as lines. Hours
// before the program started stay empty.
const DAY_MS = 24 * 3600000;
export function drawDay({ context, width, height }, day, now, hasSignal) {
  const rows = [['online', 'Online'], ...(hasSignal ? [['rssi_dbm', 'Signal']] : []), ['latency_us', 'Latency p50'], ['repeats', 'Repeats'], ['gaps', 'Gaps']];
  const tall = (height - 18) / rows.length;
  const x = (slot) => width * (1 - (now - day.from - slot * day.slot_ms) / DAY_MS);
  context.font = '11px system-ui, "DejaVu Sans", sans-serif';
  rows.forEach(([key, label], row) => {
    const values = day[key] ?? [];
    const top = row * tall + 15;
    const base = (row + 1) * tall;
    const seen = values.filter(Number.isFinite);
    const [low, high] = key === 'online' ? [0, 100] : key === 'rssi_dbm' ? [-100, -30] : [0, Math.max(1, ...seen)];
    const y = (value) => base - (Math.max(low, Math.min(high, value)) - low) / (high - low) * (base - top);
    const step = Math.max(1.5, width * day.slot_ms / DAY_MS - 1);
    context.fillStyle = context.strokeStyle = colour(key === 'online' ? '--good' : key === 'repeats' || key === 'gaps' ? '--warn' : '--accent');
    if (key === 'rssi_dbm' || key === 'latency_us') line(context, values, (i) => Math.min(width - 1, x(i + 0.5)), y);
    else values.forEach((value, i) => value > 0 && context.fillRect(x(i), y(value), Math.min(step, width - x(i)), base - y(value)));
    if (key === 'online') { // a thin mark for time offline, so that it differs from time without data
      context.fillStyle = colour('--bad');
      values.forEach((value, i) => value !== null && value < 100 && context.fillRect(x(i), base - 2, Math.min(step, width - x(i)), 2));
    }
    context.fillStyle = colour('--line');
    context.fillRect(0, base, width, 1);
    context.fillStyle = colour('--muted');
    context.fillText(`${label}${seen.length && key !== 'online' ? `  ${newest(key, seen)}` : ''}`, 0, top - 4);
  });
  for (let hours = 24; hours >= 0; hours -= 6) {
    const text = hours ? `−${hours} h` : 'now';
    const at = width * (1 - hours / 24) - (hours === 24 ? 0 : hours ? context.measureText(text).width / 2 : context.measureText(text).width);
    context.fillText(text, at, height - 4);
  }
}
const newest = (key, seen) => (key === 'rssi_dbm' ? `${seen.at(-1)} dBm` : key === 'latency_us' ? `${(seen.at(-1) / 1000).toFixed(1)} ms` : String(seen.reduce((a, b) => a + b, 0)));
// Joins neighbouring points; a single point is a dot.
function line(context, values, x, y) {
  context.lineWidth = 1.5;
  context.beginPath();
  values.forEach((value, i) => {
    if (!Number.isFinite(value)) return;
    if (Number.isFinite(values[i - 1])) context.lineTo(x(i), y(value));
    else context.moveTo(x(i) - 1, y(value)), context.lineTo(x(i), y(value));
  });
  context.stroke();
}
