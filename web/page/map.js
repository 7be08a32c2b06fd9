// SPDX-License-Identifier: Apache-2.0
// The map: grid, points, trails, robots, and the goals of commands. The room's y axis points up. The map is drawn only when
// something changes.
import { Grid } from './grid.js';
import { MAX_POINTS } from './model.js';
import { Points } from './points.js';
import { shown } from './shown.js';
import { outcomeWords } from './words.js';

const FIT_MARGIN_PX = 70;
const MIN_SCALE = 0.01;
const MAX_SCALE = 40;
const MARK_MS = 12000;
// With more points than this, the layer of still parts is painted only once a second. In between, only new points and trails
// are added to it.
const HEAVY_POINTS = 20000;
const LAYER_MS = 1000;
// From this number of robots on, robots that stand close together are drawn as one disc with their number. The cells are
// squares of the room, so that clusters stay the same while the map moves.
const CLUSTERS_FROM = 40;
const CLUSTER_PX = 44;
const CLUSTER_OF = 4;
const MAX_NAMES = 200;
const calm = matchMedia('(prefers-reduced-motion: reduce)');

// Converts room centimetres to pixels, and back.
class View {
  constructor() {
    Object.assign(this, { scale: 2, left: 0, top: 0 });
  }
  px(x) { return this.left + x * this.scale; }
  py(y) { return this.top - y * this.scale; }
  room(px, py) { return { x: (px - this.left) / this.scale, y: (this.top - py) / this.scale }; }
  zoom(factor, px, py) {
    const scale = Math.max(MIN_SCALE, Math.min(MAX_SCALE, this.scale * factor));
    const ratio = scale / this.scale;
    this.left = px - (px - this.left) * ratio;
    this.top = py - (py - this.top) * ratio;
    this.scale = scale;
  }
}

// Returns a place for a name of this width beside a robot: on the canvas and free of all boxes in `taken`. Null without one.
function freePlace(px, py, width, taken, wide, tall) {
  for (const [x, y] of [[px + 12, py - 12], [px + 12, py + 14], [px - 12 - width, py - 12], [px - 12 - width, py + 14]]) {
    const box = { left: x - 2, right: x + width + 2, top: y - 8, bottom: y + 8 };
    if (box.left < 0 || box.right > wide || box.top < 0 || box.bottom > tall || taken.some((other) => overlaps(box, other))) continue;
    taken.push(box);
    return [x, y];
  }
  return null;
}
const overlaps = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;

export class WorldMap {
  constructor(canvas, model, actions) {
    Object.assign(this, { canvas, model, actions });
    this.context = canvas.getContext('2d', { alpha: false });
    this.view = new View();
    this.grid = new Grid();
    this.points = new Points();
    this.layer = new OffscreenCanvas(1, 1);
    this.layerAt = -Infinity;
    this.sprites = new Map();
    this.marks = []; // the goals of commands
    this.show = { points: true, grid: true, trails: true, labels: true };
    this.time = Infinity; // the time that is shown; Infinity: now
    this.wanted = ''; // shows only robots that match
    this.clusters = [];
    this.single = []; // robots that are drawn one by one
    this.chosen = null;
    this.fits = true; // until the user moves the map
    this.isVisible = true;
    this.frames = 0;
    this.recolour();
    this.listen();
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  get robots() {
    return [...this.model.robots.values()].filter((robot) => robot.isShown && robot.matches(this.wanted));
  }

  // ---- size, colours, frames
  resize() {
    this.ratio = Math.min(devicePixelRatio || 1, 2);
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.max(1, Math.round(this.width * this.ratio));
    this.canvas.height = Math.max(1, Math.round(this.height * this.ratio));
    this.change();
  }
  recolour() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    this.colours = Object.fromEntries(['ground', 'line', 'text', 'muted', 'card', 'good', 'bad', 'accent'].map((name) => [name, colour(`--${name}`)]));
    const free = colour('--free').match(/\w\w/g).map((part) => parseInt(part, 16));
    this.grid.recolour({ free, wall: colour('--wall').split(' ').map(Number) });
    this.sprites.clear();
    this.repaint();
  }
  get isPast() {
    return this.time !== Infinity;
  }
  poseOf(robot) {
    return this.isPast ? robot.placeAt(this.time) : robot.pose;
  }
  goTo(time) {
    this.time = time;
    this.repaint();
  }
  // As change(), but also paints the layer again.
  repaint() {
    this.layerAt = -Infinity;
    this.change();
  }
  change() {
    if (this.isAsked || !this.isVisible) return;
    this.isAsked = true;
    requestAnimationFrame(() => {
      this.isAsked = false;
      if (this.isVisible && this.width > 0) this.draw();
    });
  }
  // Draws again when a robot has become fainter, because it was silent for a while.
  fade() {
    const look = this.robots.map((robot) => robot.freshness(this.model.now()) + robot.isGone).join();
    if (look !== this.look) this.change();
    this.look = look;
  }
  setVisible(isVisible) {
    this.isVisible = isVisible;
    if (isVisible) this.resize();
  }

  // ---- bounds, choice
  bounds() {
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    const reach = (x, y) => {
      left = Math.min(left, x);
      right = Math.max(right, x);
      low = Math.min(low, y);
      high = Math.max(high, y);
    };
    for (const robot of this.robots) {
      const pose = this.poseOf(robot);
      if (pose) reach(pose.x, pose.y);
      for (let i = 0; i < robot.kept; i += 1 + (robot.kept >> 7)) reach(robot.points[i * 3], robot.points[i * 3 + 1]);
    }
    return left <= right ? { left, right, low, high } : null;
  }
  fit(isNow) {
    const bounds = this.bounds();
    if (!bounds || !this.width) return;
    const aside = this.actions.covered();
    const wide = Math.max(60, this.width - aside.left - FIT_MARGIN_PX);
    const tall = Math.max(60, this.height - aside.top - aside.bottom - FIT_MARGIN_PX);
    const scale = Math.max(MIN_SCALE, Math.min(8, wide / Math.max(40, bounds.right - bounds.left), tall / Math.max(40, bounds.high - bounds.low)));
    const goal = {
      scale,
      left: aside.left + (this.width - aside.left) / 2 - scale * (bounds.left + bounds.right) / 2,
      top: aside.top + (this.height - aside.top - aside.bottom) / 2 + scale * (bounds.low + bounds.high) / 2,
    };
    // A resting view stays until it is clearly off, because each new point moves the goal a little.
    const off = Math.max(Math.abs(goal.scale / this.view.scale - 1) * 300, Math.abs(goal.left - this.view.left), Math.abs(goal.top - this.view.top));
    if (!isNow && this.isResting && off < 24) return false;
    const step = isNow || calm.matches || !this.hasFitted ? 1 : 0.12;
    this.hasFitted = true;
    for (const key of ['scale', 'left', 'top']) this.view[key] += (goal[key] - this.view[key]) * step;
    this.isResting = step === 1 || off < 1;
    return !this.isResting;
  }
  fitAll() {
    this.fits = true;
    this.isResting = false;
    this.change();
  }
  clear() {
    this.grid.clear();
    this.marks = [];
    for (const robot of this.model.robots.values()) robot.forgetDrawing();
    this.repaint();
  }
  choose(robot) {
    this.chosen = robot;
    this.canvas.classList.toggle('aim', robot !== null && this.model.maySend);
    this.repaint();
  }
  robotAt(px, py) {
    let best = null;
    let nearest = 16;
    for (const robot of this.single) {
      const pose = this.poseOf(robot);
      const distance = Math.hypot(this.view.px(pose.x) - px, this.view.py(pose.y) - py);
      if (distance < nearest) [best, nearest] = [robot, distance];
    }
    return best;
  }

  // ---- drawing
  draw() {
    const { context, ratio } = this;
    if (this.fits && this.fit(false)) this.change();
    this.frames++;
    const robots = this.robots.sort((a, b) => (a === this.chosen) - (b === this.chosen)); // the chosen one on top
    this.refreshLayer(robots);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.layer, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.gather(robots.filter((robot) => this.poseOf(robot)));
    for (const cluster of this.clusters) this.drawCluster(cluster);
    for (const robot of this.single) this.drawRobot(robot);
    if (this.show.labels) this.drawNames();
    this.drawMarks();
    this.drawScale();
  }
  refreshLayer(robots) {
    const now = performance.now();
    const { scale, left, top } = this.view;
    const place = [scale, left, top, this.canvas.width, this.canvas.height].join();
    const isHeavy = robots.reduce((sum, robot) => sum + robot.kept, 0) > HEAVY_POINTS;
    if (isHeavy && !this.isPast && place === this.layerPlace && now - this.layerAt < LAYER_MS) return this.extendLayer(robots);
    this.layerAt = now;
    this.layerPlace = place;
    this.paintLayer(robots);
  }
  paintLayer(robots) {
    if (this.layer.width !== this.canvas.width || this.layer.height !== this.canvas.height) {
      this.layer.width = this.canvas.width;
      this.layer.height = this.canvas.height;
    }
    const context = this.layer.getContext('2d', { alpha: false });
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.fillStyle = this.colours.ground;
    context.fillRect(0, 0, this.width, this.height);
    if (this.show.grid && !this.isPast) this.grid.draw(context, this.view, this.width, this.height);
    this.drawLines(context);
    if (this.show.points) this.drawPoints(context, robots);
    for (const robot of robots) {
      if (this.show.trails) this.drawTrail(context, robot, robots.length);
      robot.drawn = { points: robot.pointCount, trail: robot.trail.at(-1) };
    }
  }
  // Adds only new points and trails to the layer. These are few, so plain canvas calls are fast enough.
  extendLayer(robots) {
    const context = this.layer.getContext('2d');
    const { view } = this;
    const size = Math.max(2, Math.min(6, view.scale));
    for (const robot of robots) {
      const drawn = (robot.drawn ??= { points: robot.pointCount, trail: null });
      context.fillStyle = `rgb(${robot.colour})`;
      for (let n = Math.max(drawn.points, robot.pointCount - 50); this.show.points && n < robot.pointCount; n++) {
        const at = (n % MAX_POINTS) * 3;
        context.globalAlpha = 0.1 + 0.8 * robot.points[at + 2];
        context.fillRect(view.px(robot.points[at]) - size / 2, view.py(robot.points[at + 1]) - size / 2, size, size);
      }
      const last = robot.trail.at(-1);
      if (this.show.trails && drawn.trail && last && last !== drawn.trail) {
        context.globalAlpha = 0.7;
        context.strokeStyle = `rgb(${robot.colour})`;
        context.beginPath();
        context.moveTo(view.px(drawn.trail.x), view.py(drawn.trail.y));
        context.lineTo(view.px(last.x), view.py(last.y));
        context.stroke();
      }
      drawn.points = robot.pointCount;
      drawn.trail = last;
    }
    context.globalAlpha = 1;
  }
  drawLines(context) {
    const { view } = this;
    const step = [1, 5, 10, 50, 100, 500, 1000, 5000, 10000].find((cm) => cm * view.scale >= 45) ?? 50000;
    const from = view.room(0, this.height);
    const to = view.room(this.width, 0);
    context.beginPath();
    for (let x = Math.ceil(from.x / step) * step; x <= to.x; x += step) {
      const at = Math.round(view.px(x)) + 0.5;
      context.moveTo(at, 0);
      context.lineTo(at, this.height);
    }
    for (let y = Math.ceil(from.y / step) * step; y <= to.y; y += step) {
      const at = Math.round(view.py(y)) + 0.5;
      context.moveTo(0, at);
      context.lineTo(this.width, at);
    }
    context.strokeStyle = this.colours.line;
    context.globalAlpha = 0.55;
    context.lineWidth = 1;
    context.stroke();
    context.globalAlpha = 1;
  }
  drawPoints(context, robots) {
    const { ratio, view } = this;
    const scaled = { scale: view.scale * ratio, left: view.left * ratio, top: view.top * ratio };
    const picture = this.points.draw(robots, scaled, this.canvas.width, this.canvas.height, this.chosen, this.time);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(picture, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }
  drawTrail(context, robot, count) {
    const { view } = this;
    const trail = this.isPast ? robot.track.filter(({ at }) => at <= this.time) : robot.trail;
    const length = Math.min(trail.length, Math.max(24, Math.floor(4000 / count)));
    if (length < 2) return;
    const parts = count > 30 ? 1 : 4; // older parts are fainter
    context.strokeStyle = `rgb(${robot.colour})`;
    context.lineWidth = robot === this.chosen ? 2.5 : 1.5;
    context.lineJoin = 'round';
    for (let part = 0; part < parts; part++) {
      const from = trail.length - length + Math.floor(length * part / parts);
      const to = trail.length - length + Math.floor(length * (part + 1) / parts);
      context.globalAlpha = 0.7 * (part + 1) / parts;
      context.beginPath();
      for (let i = from; i <= Math.min(to, trail.length - 1); i++) context.lineTo(view.px(trail[i].x), view.py(trail[i].y));
      context.stroke();
    }
    context.globalAlpha = 1;
  }
  // Returns the disc of a robot, which is drawn once for each colour, size and state.
  sprite(robot, size, isGone) {
    const key = `${robot.number},${size},${isGone},${this.ratio}`;
    let sprite = this.sprites.get(key);
    if (sprite) return sprite;
    const half = size + 2;
    sprite = new OffscreenCanvas(Math.ceil(2 * half * this.ratio), Math.ceil(2 * half * this.ratio));
    const context = sprite.getContext('2d');
    context.scale(this.ratio, this.ratio);
    context.beginPath();
    context.arc(half, half, size, 0, 7);
    context.fillStyle = isGone ? this.colours.card : `rgb(${robot.colour})`;
    context.strokeStyle = isGone ? `rgb(${robot.colour})` : this.colours.card;
    context.lineWidth = 2;
    context.fill();
    context.stroke();
    this.sprites.set(key, sprite);
    return sprite;
  }
  drawRobot(robot) {
    const { context, view } = this;
    const pose = this.poseOf(robot);
    const [x, y] = [view.px(pose.x), view.py(pose.y)];
    const size = robot === this.chosen ? 8 : 6;
    const isGone = robot.isGone && !this.isPast;
    if (!this.isPast) context.globalAlpha = robot.freshness(this.model.now());
    if (robot === this.chosen) {
      context.beginPath();
      context.arc(x, y, 15, 0, 7);
      context.fillStyle = `rgba(${robot.colour}, .18)`;
      context.fill();
    }
    if (robot.heading !== null && !isGone && !this.isPast) {
      const [dx, dy] = [Math.cos(robot.heading), -Math.sin(robot.heading)];
      context.beginPath();
      context.moveTo(x + dx * size * 2.5, y + dy * size * 2.5);
      context.lineTo(x - dy * size * 0.95, y + dx * size * 0.95);
      context.lineTo(x + dy * size * 0.95, y - dx * size * 0.95);
      context.fillStyle = `rgb(${robot.colour})`;
      context.fill();
    }
    context.drawImage(this.sprite(robot, size, isGone), x - size - 2, y - size - 2, 2 * size + 4, 2 * size + 4);
    context.globalAlpha = 1;
  }
  // Sorts robots into clusters and single ones. Zooming in turns clusters of many robots into single discs, then adds names.
  gather(robots) {
    const cell = 2 ** Math.ceil(Math.log2(CLUSTER_PX / this.view.scale));
    const cells = robots.length < CLUSTERS_FROM ? new Map() : Map.groupBy(robots.filter((robot) => robot !== this.chosen), (robot) => {
      const { x, y } = this.poseOf(robot);
      return `${Math.floor(x / cell)},${Math.floor(y / cell)}`;
    });
    this.clusters = [...cells].filter(([, all]) => all.length >= CLUSTER_OF).map(([key, all]) => {
      const [column, row] = key.split(',').map(Number);
      return { all, x: (column + 0.5) * cell, y: (row + 0.5) * cell };
    });
    const gathered = new Set(this.clusters.flatMap(({ all }) => all));
    this.single = robots.filter((robot) => !gathered.has(robot));
  }
  drawCluster({ all, x, y }) {
    const { context, view } = this;
    const [px, py] = [view.px(x), view.py(y)];
    const size = Math.min(20, 11 + Math.log2(all.length) * 1.2);
    const gone = all.filter((robot) => robot.isGone).length / all.length;
    context.beginPath();
    context.arc(px, py, size, 0, 7);
    context.fillStyle = this.colours.card;
    context.fill();
    context.lineWidth = 2.5;
    for (const [from, to, colour] of [[gone, 1, this.colours.accent], [0, gone, this.colours.bad]]) {
      if (to === from) continue;
      context.beginPath();
      context.arc(px, py, size, (from * 2 - 0.5) * Math.PI, (to * 2 - 0.5) * Math.PI);
      context.strokeStyle = colour;
      context.stroke();
    }
    context.font = '600 12px system-ui, "DejaVu Sans", sans-serif';
    context.textBaseline = 'middle';
    context.fillStyle = this.colours.text;
    context.fillText(String(all.length), px - context.measureText(String(all.length)).width / 2, py + 1);
  }
  drawNames() {
    const { context, view } = this;
    context.font = '500 12px system-ui, "DejaVu Sans", sans-serif';
    context.textBaseline = 'middle';
    context.lineWidth = 3;
    context.lineJoin = 'round';
    context.strokeStyle = this.colours.card;
    context.fillStyle = this.colours.text;
    const taken = this.clusters.map(({ x, y }) => ({ left: view.px(x) - 21, right: view.px(x) + 21, top: view.py(y) - 21, bottom: view.py(y) + 21 }));
    taken.push({ left: this.width - 280, right: this.width, top: this.height - 46, bottom: this.height }); // the scale
    const most = taken.length + MAX_NAMES;
    for (const robot of this.single.toReversed()) { // the chosen one first
      if (taken.length >= most) return;
      const id = shown(robot.id);
      const name = id.length > 24 ? id.slice(0, 23) + '…' : id;
      robot.nameWidth ??= context.measureText(name).width;
      const place = freePlace(view.px(this.poseOf(robot).x), view.py(this.poseOf(robot).y), robot.nameWidth, taken, this.width, this.height);
      if (!place) continue; // overlapping names can't be read
      context.strokeText(name, ...place);
      context.fillText(name, ...place);
    }
  }
  drawMarks() {
    const { context, view } = this;
    const now = performance.now();
    this.marks = this.marks.filter((mark) => !mark.command.ended || now - mark.command.ended < MARK_MS);
    for (const { command, x, y, robot } of this.marks) {
      const [px, py] = [view.px(x), view.py(y)];
      const isGood = command.outcome === 'delivered' || command.outcome === 'sent';
      const colour = !command.outcome ? `rgb(${robot.colour})` : isGood ? this.colours.good : this.colours.bad;
      const pulse = command.outcome || calm.matches ? 0 : ((now / 900) % 1);
      context.strokeStyle = colour;
      context.lineWidth = 2;
      context.beginPath();
      context.arc(px, py, 7 + pulse * 8, 0, 7);
      context.moveTo(px - 3, py);
      context.lineTo(px + 3, py);
      context.moveTo(px, py - 3);
      context.lineTo(px, py + 3);
      context.stroke();
      this.tag(outcomeWords(command), px + 14, py + 1, colour);
    }
    if (!this.marks.length || this.markTimer) return;
    this.markTimer = setTimeout(() => {
      this.markTimer = 0;
      this.change();
    }, calm.matches ? 500 : 60);
  }
  tag(text, x, y, colour) {
    const { context } = this;
    context.font = '500 12px system-ui, "DejaVu Sans", sans-serif';
    context.textBaseline = 'middle';
    const width = context.measureText(text).width;
    context.fillStyle = this.colours.card;
    context.globalAlpha = 0.92;
    context.beginPath();
    context.roundRect(x - 5, y - 10, width + 10, 20, 6);
    context.fill();
    context.globalAlpha = 1;
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }
  drawScale() {
    const { context, view } = this;
    const cm = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000].find((size) => size * view.scale >= 60) ?? 50000;
    const length = cm * view.scale;
    const [right, y] = [this.width - 74, this.height - 22];
    context.strokeStyle = this.colours.muted;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(right - length, y - 4);
    context.lineTo(right - length, y);
    context.lineTo(right, y);
    context.lineTo(right, y - 4);
    context.stroke();
    context.font = '12px system-ui, "DejaVu Sans", sans-serif';
    context.textBaseline = 'alphabetic';
    context.fillStyle = this.colours.muted;
    const text = cm >= 100 ? `${cm / 100} m` : `${cm} cm`;
    context.fillText(text, right - length / 2 - context.measureText(text).width / 2, y - 8);
  }

  // ---- pointer and wheel
  listen() {
    const { canvas } = this;
    const fingers = new Map();
    let moved = 0;
    const at = (event) => ({ x: event.offsetX, y: event.offsetY });
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, at(event));
      if (fingers.size === 1) moved = 0;
    });
    canvas.addEventListener('pointermove', (event) => {
      const now = at(event);
      this.actions.hover(this.view.room(now.x, now.y));
      const before = fingers.get(event.pointerId);
      if (!before) return;
      moved += Math.abs(now.x - before.x) + Math.abs(now.y - before.y);
      const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
      if (other) this.pinch(before, now, other);
      else if (moved > 4) this.pan(now.x - before.x, now.y - before.y);
      canvas.classList.toggle('moves', moved > 4);
      fingers.set(event.pointerId, now);
    });
    const end = (event) => {
      const wasLast = fingers.delete(event.pointerId) && fingers.size === 0;
      canvas.classList.remove('moves');
      if (event.type === 'pointerup' && event.button === 0 && wasLast && moved <= 4) this.click(event.offsetX, event.offsetY);
    };
    canvas.addEventListener('pointerup', end);
    canvas.addEventListener('pointercancel', end);
    canvas.addEventListener('pointerleave', () => this.actions.hover(null));
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), event.offsetX, event.offsetY);
    }, { passive: false });
  }
  pinch(before, now, other) {
    const length = (a) => Math.hypot(a.x - other.x, a.y - other.y) || 1;
    this.zoom(length(now) / length(before), (now.x + other.x) / 2, (now.y + other.y) / 2);
  }
  pan(dx, dy) {
    this.fits = false;
    this.view.left += dx;
    this.view.top += dy;
    this.change();
  }
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    this.fits = false;
    this.view.zoom(factor, px, py);
    this.change();
  }
  click(px, py) {
    const robot = this.robotAt(px, py);
    if (robot && robot !== this.chosen) return this.actions.choose(robot);
    if (!this.chosen) {
      const cluster = this.clusters.find(({ x, y }) => Math.hypot(this.view.px(x) - px, this.view.py(y) - py) < 21);
      if (cluster) this.zoom(2.5, px, py);
      return;
    }
    const place = this.view.room(px, py);
    const command = this.actions.drive(this.chosen, place);
    if (command) this.marks.push({ command, robot: this.chosen, ...place });
    this.change();
  }
}
