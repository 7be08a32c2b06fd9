// SPDX-License-Identifier: Apache-2.0
// The page's state: robots, gateways, the newest messages. Bounded; no drawing here. Robots' names are keys of Maps, never
// of objects, and are shown as text only.
import { decodeUpdate, describe } from './decode.js';

export const MAX_ROBOTS = 1000;
const MAX_LEFT_OUT = 20000; // robots without a place, of which only name, presence and life are kept
const MAX_ID = 64; // docs/topics.md
const QUIET_MS = 10000; // a new robot replaces only one that was silent this long: else 1001 robots would replace each other
const CLOCK_STEP_MS = 5000; // messages are seldom as late
const LOOK_MS = 1000; // between two searches for quiet robots
export const MAX_POINTS = 4000; // of one robot
export const MAX_TRAIL = 400;
const MAX_TRACK = 1000; // places of one robot with their times; beyond it, each second place of the older half is removed
const MAX_MESSAGES = 3000;
const MAX_QUALITY = 60; // of one robot; gateways report it each 10 s
const MAX_NEIGHBOURS = 256; // of a gateway on a Thread border router; it reports no more
const MAX_COMMANDS = 20; // of one robot; those without an outcome stay
const MAX_OPEN = 256; // of one robot; a gateway takes no more at once
const OUTCOME_MS = 35000; // gateways promise an outcome within 30 s (docs/topics.md, promise 6)
const NO_OUTCOME = { outcome: 'no outcome', why: 'none came within 35 s' };
const MAX_NOTED = 4096; // octets of one message; robots' messages are never longer
const MAX_GATEWAYS = 100;
const STATES = ['state', 'stats', 'numbers', 'thread', 'robots', 'response']; // of a gateway; other topics are events
const SECONDS = 60;
const FADES_FROM_MS = 10000; // silence after which a robot begins to fade
const FADED_AT_MS = 60000;
const SENSOR_LIMIT_CM = 80;
const FADES_FROM_CM = 60;

// Returns the worth of a reading at this distance, 0.12 to 1: scatter grows towards the sensor's limit.
export function worth(distance) {
  if (distance <= FADES_FROM_CM) return 1;
  return Math.max(0.12, 1 - 0.88 * (distance - FADES_FROM_CM) / (SENSOR_LIMIT_CM - FADES_FROM_CM));
}

// Ten calm colours, then the golden angle; [r, g, b]. All are of one luminance, which differs enough from light grounds and
// from dark ones (tests/web/contrast_test.mjs).
const COLOURS = [[53, 111, 201], [214, 112, 44], [44, 145, 95], [150, 88, 190], [196, 62, 88], [38, 144, 158], [168, 132, 28], [120, 120, 132], [206, 92, 152], [110, 146, 46]];
const LUMINANCE = 0.212;
const luminance = (colour) => colour.reduce((sum, value, i) => sum + [0.2126, 0.7152, 0.0722][i] * ((value / 255 + 0.055) / 1.055) ** 2.4, 0);
function balanced(colour) {
  let [low, high] = [-1, 1]; // towards black, towards white
  const mixed = (by) => colour.map((value) => Math.round(by < 0 ? value * (1 + by) : value + (255 - value) * by));
  for (let i = 0; i < 12; i++) {
    const middle = (low + high) / 2;
    if (luminance(mixed(middle)) < LUMINANCE) low = middle;
    else high = middle;
  }
  return mixed(high);
}
export function colourOf(number) {
  if (number < COLOURS.length) return balanced(COLOURS[number]);
  const hue = (number * 137.508) % 360;
  const channel = (n) => {
    const k = (n + hue / 30) % 12;
    return Math.round(255 * (0.5 - 0.24 * Math.max(-1, Math.min(k - 3, 9 - k, 1))));
  };
  return balanced([channel(0), channel(8), channel(4)]);
}

// Counts events in each of the last 60 seconds.
class Pulse {
  constructor() {
    this.counts = new Uint16Array(SECONDS);
    this.second = 0;
  }
  turn(now) {
    const second = Math.floor(now / 1000);
    if (second - this.second >= SECONDS) this.counts.fill(0);
    else for (let s = this.second + 1; s <= second; s++) this.counts[s % SECONDS] = 0;
    if (second > this.second) this.second = second;
  }
  add(now) {
    this.turn(now);
    this.counts[this.second % SECONDS]++;
  }
  // Returns the counts, oldest first, without the current second.
  list(now) {
    this.turn(now);
    return Array.from({ length: SECONDS - 1 }, (_, i) => this.counts[(this.second + 1 + i) % SECONDS]);
  }
  rate(now) {
    const five = this.list(now).slice(-5);
    return five.reduce((sum, n) => sum + n, 0) / five.length;
  }
}

export class Robot {
  constructor(id, number, origin) {
    this.id = id;
    this.number = number;
    this.colour = colourOf(number);
    this.presence = new Map(); // gateway: its report
    this.life = null; // the program's decision: {state, since, heard, gateway}
    this.numbers = null;
    this.neighbour = null; // on Thread: the border router's entry of this robot, if its address is known; set for each drawing
    this.quality = []; // [signal, latency] of the last ten minutes
    this.pulse = new Pulse();
    this.heard = 0; // ms, by the clock of slam-gateway-web
    this.messages = 0;
    this.isShown = true;
    this.pose = null; // {x, y} in the room, cm
    this.heading = null; // radians, of the last step of the trail
    this.points = null; // a ring: x, y in the room, worth
    this.times = null;
    this.pointCount = 0; // all points so far; the ring holds the newest
    this.trail = [];
    this.track = []; // {at, x, y}, for going back in time
    this.outcomes = []; // of this page's newest commands
    this.commands = []; // from any sender, newest last: {at, type, text, outcome, after, why}
    this.day = null; // the robot's last 24 hours, as the program has seen them
    this.setOrigin(origin);
  }

  setOrigin(origin) {
    this.origin = { x: origin?.x_cm ?? 0, y: origin?.y_cm ?? 0, turn: (origin?.heading_deg ?? 0) * Math.PI / 180 };
    this.cos = Math.cos(this.origin.turn);
    this.sin = Math.sin(this.origin.turn);
  }
  toRoom(x, y) {
    return { x: this.origin.x + this.cos * x - this.sin * y, y: this.origin.y + this.sin * x + this.cos * y };
  }
  fromRoom(x, y) {
    const dx = x - this.origin.x;
    const dy = y - this.origin.y;
    return { x: Math.round(this.cos * dx + this.sin * dy), y: Math.round(this.cos * dy - this.sin * dx) };
  }

  get kept() {
    return Math.min(this.pointCount, MAX_POINTS);
  }
  addPoint(x, y, value, at) {
    this.points ??= new Float32Array(MAX_POINTS * 3);
    this.times ??= new Float64Array(MAX_POINTS);
    const slot = this.pointCount++ % MAX_POINTS;
    this.points[slot * 3] = x;
    this.points[slot * 3 + 1] = y;
    this.points[slot * 3 + 2] = value;
    this.times[slot] = at;
  }

  // Calls `see` with each ray: (from x, y, to x, y, worth).
  apply(update, at, see) {
    const pose = this.toRoom(update.x, update.y);
    const last = this.trail.at(-1); // a slow robot needs several updates for one step
    const isStep = !last || Math.hypot(pose.x - last.x, pose.y - last.y) > 1;
    if (last && isStep) this.heading = Math.atan2(pose.y - last.y, pose.x - last.x);
    if (isStep) this.trail.push(pose);
    if (this.trail.length > MAX_TRAIL) this.trail.splice(0, MAX_TRAIL / 4);
    this.pose = pose;
    this.track.push({ at, ...pose });
    if (this.track.length > MAX_TRACK) this.track = this.track.filter((_, i) => i >= MAX_TRACK / 2 || i % 2 === 0);
    for (let i = 0; i + 1 < update.obstacles.length; i += 2) {
      const point = this.toRoom(update.obstacles[i], update.obstacles[i + 1]);
      const value = worth(Math.hypot(point.x - pose.x, point.y - pose.y));
      this.addPoint(point.x, point.y, value, at);
      see(pose.x, pose.y, point.x, point.y, value);
    }
  }
  // Returns the robot's place at this time; null before its first place.
  placeAt(time) {
    let [low, high] = [0, this.track.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.track[middle].at <= time) low = middle + 1;
      else high = middle;
    }
    return this.track[low - 1] ?? null;
  }
  forgetDrawing() {
    this.pointCount = 0;
    this.trail = [];
  }

  // The report of the gateway that the program has chosen for this robot.
  get best() {
    const said = this.presence.get(this.life?.gateway);
    return said ? { gateway: this.life.gateway, ...said } : null;
  }
  get state() {
    return this.life?.state ?? 'unknown';
  }
  // A robot that no gateway has ever reported is not gone while it sends messages.
  get isGone() {
    return this.life !== null && (this.state === 'offline' || this.state === 'unknown');
  }
  // The robot's numbers, but null when its gateway is gone and they are out of date.
  get figures() {
    return this.state === 'unknown' ? null : this.numbers;
  }
  // The last sign of life, here or at the robot's gateway; 0: none.
  get lastHeard() {
    return Math.max(this.heard, this.life?.heard ?? 0);
  }
  matches(text) {
    const wanted = text.toLowerCase();
    return !wanted || `${this.id} ${this.state} ${this.best?.mesh ?? ''} ${this.best?.gateway ?? ''}`.toLowerCase().includes(wanted);
  }
  // Returns 1, and less after a longer silence.
  freshness(now) {
    const silent = (now - this.lastHeard - FADES_FROM_MS) / (FADED_AT_MS - FADES_FROM_MS);
    return Math.round(20 * (1 - 0.6 * Math.max(0, Math.min(1, silent)))) / 20;
  }
}

// Drops the payload of a long document, because the page keeps 3000 messages.
const shortened = (message) => {
  const { payload } = message;
  const bytes = typeof payload === 'string' ? payload.length : JSON.stringify(payload).length;
  return bytes > MAX_NOTED ? { ...message, payload: '', encoding: 'text', bytes } : message;
};
const isObject = (value) => value !== null && typeof value === 'object' && !Array.isArray(value);

// Returns a Thread node's extended address, which its link-local address holds with one bit turned (RFC 4291, appendix A).
// Returns null for other addresses, which do not hold it.
export function extendedAddressOf(address) {
  const text = /^\[?(fe80:[0-9a-f:]*)/i.exec(address ?? '')?.[1].toLowerCase();
  const [head, tail] = text?.split('::').map((part) => part.split(':').filter(Boolean)) ?? [[]];
  const groups = tail ? [...head, ...Array(Math.max(0, 8 - head.length - tail.length)).fill('0'), ...tail] : head;
  if (groups.length !== 8 || groups.slice(1, 4).some((group) => parseInt(group, 16) !== 0)) return null;
  const id = groups.slice(4).map((group) => group.padStart(4, '0')).join('');
  return (parseInt(id.slice(0, 2), 16) ^ 2).toString(16).padStart(2, '0') + id.slice(2);
}
// Keeps the report of a gateway's border router: its neighbours by extended address, each with its signal of the last ten
// minutes. A router's RLOC16 is its id, six bits, and ten zeroes.
function takeThread(gateway, said) {
  const before = gateway.thread?.neighbours;
  const neighbours = new Map();
  for (const each of (said?.neighbours ?? []).slice(0, MAX_NEIGHBOURS))
    if (isObject(each) && each.extended_address)
      neighbours.set(each.extended_address, { ...each, isLeader: parseInt(each.rloc16, 16) === said.leader_router_id << 10, quality: [...(before?.get(each.extended_address)?.quality ?? []), each.rssi_last_dbm].slice(-MAX_QUALITY) });
  gateway.thread = said && { ...said, neighbours };
}

export class Model {
  constructor() {
    this.prefix = '';
    this.origins = {};
    this.takesToken = false;
    this.isLocked = false; // the page must send a token before it gets anything
    this.holder = ''; // the name of the token that the page has sent
    this.maySend = false;
    this.isOpen = false;
    this.broker = { state: 'down', why: 'connecting' };
    this.robots = new Map();
    this.spare = []; // numbers of forgotten robots
    this.roster = 0; // changes with the set of robots
    this.leftOut = new Map(); // presence and life of robots that there is no room for
    this.quiet = []; // robots that may be replaced, the quietest last
    this.lookedAt = -Infinity;
    this.gateways = new Map();
    this.own = ''; // the gateway whose configuration slam-gateway-web reads
    this.gatewaysLeftOut = false;
    this.messages = []; // newest last
    this.newest = 0; // when the newest message came to the program
    this.liveFrom = Infinity; // from this time on, this connection has got every message
    this.lost = 0; // events that the page did not get, because it was too slow
    this.skew = null; // the program's clock minus the browser's, ms; null before the first message
    this.onRay = () => {};
    this.onMessage = () => {};
    this.onOutcome = () => {};
    this.mayLeave = () => true; // whether the user does not look at this robot
  }

  now() {
    return Date.now() + (this.skew ?? 0);
  }

  // `ahead`: a message's time minus the browser's, ms. Of late messages, the least late one shows the difference. A larger
  // step is a clock that was set.
  compareClocks(ahead) {
    const isSet = this.skew === null || ahead < this.skew - CLOCK_STEP_MS;
    this.skew = isSet ? ahead : Math.max(ahead, this.skew - 0.05);
  }

  // `heard`: when the robot was heard, ms. Returns null for a robot that there is no room for.
  robot(id, heard) {
    const known = this.robots.get(id);
    if (known) return known;
    const number = this.spare.pop() ?? (this.robots.size < MAX_ROBOTS ? this.robots.size : this.makeRoom(heard));
    if (number === null) {
      this.leaveOut(id, { presence: new Map(), life: null });
      return null;
    }
    const robot = new Robot(id, number, this.originOf(id));
    const { presence = robot.presence, life = null } = this.leftOut.get(id) ?? {};
    Object.assign(robot, { presence, life });
    this.robots.set(id, robot);
    this.leftOut.delete(id);
    this.roster++;
    return robot;
  }
  originOf(id) {
    return Object.hasOwn(this.origins, id) ? this.origins[id] : null;
  }
  leaveOut(id, { presence, life }) {
    if (!this.leftOut.has(id) && this.leftOut.size < MAX_LEFT_OUT && id.length <= MAX_ID) this.leftOut.set(id, { presence, life });
  }
  // Removes the robot that was silent longest, and returns its number, and with it its colour. Returns null when no robot
  // was silent for long enough before `heard`.
  makeRoom(heard) {
    if (performance.now() - this.lookedAt > LOOK_MS) {
      this.lookedAt = performance.now();
      this.quiet = [...this.robots.values()].map((robot) => [robot, robot.lastHeard]).sort(([, a], [, b]) => b - a);
    }
    while (this.quiet.length) {
      const [robot, was] = this.quiet.at(-1);
      const isQuiet = robot.lastHeard === was && !robot.commands.some((each) => each.isOwn && !each.outcome) && this.mayLeave(robot);
      if (isQuiet && !(was + QUIET_MS < heard)) return null;
      this.quiet.pop();
      if (!isQuiet) continue;
      this.robots.delete(robot.id);
      this.leaveOut(robot.id, robot);
      return robot.number;
    }
    return null;
  }
  get leftOutWords() {
    const count = this.leftOut.size;
    return count ? `${count < MAX_LEFT_OUT ? count : `At least ${count}`} more robots are not shown: a page keeps the ${MAX_ROBOTS} that were heard last` : '';
  }
  gateway(id) {
    let gateway = this.gateways.get(id);
    if (!gateway && id !== this.own && this.gateways.size >= MAX_GATEWAYS) this.gatewaysLeftOut = true;
    else if (!gateway) {
      gateway = { id, state: null, stats: null, thread: null, life: null, join: null };
      this.gateways.set(id, gateway);
    }
    return gateway;
  }

  neighbourOf(robot) {
    const gateway = robot.best?.mesh === 'thread' && robot.state !== 'unknown' ? this.gateways.get(robot.best.gateway) : null;
    return gateway?.thread?.neighbours.get(extendedAddressOf(robot.best.address)) ?? null;
  }

  // Returns the gateways; the one of this page's configuration comes first.
  orderedGateways() {
    return [...this.gateways.values()].sort((a, b) => (b.id === this.own) - (a.id === this.own));
  }

  take(message) {
    if (message.topic.startsWith('$web/')) return this.takeOwn(message.topic.slice(5), message.payload);
    if (message.at && !message.retain) this.newest = Math.max(this.newest, message.at);
    const rest = message.topic.slice(this.prefix.length + 1).split('/');
    const branch = rest.shift();
    // A gateway's states keep the time at which they came to the program, which a page that comes later may get hours after.
    const isLive = message.at && !message.retain && (branch !== 'gateway' || rest[1] === 'commands');
    if (isLive) this.liveFrom = Math.min(this.liveFrom, message.at);
    if (isLive) this.compareClocks(message.at - Date.now());
    if (branch === 'robot') this.takeRobot(message, rest[0], rest.slice(1).join('/'));
    else if (branch === 'server') {
      this.note(message, 'to robot', rest[0], rest.slice(1).join('/'));
      if (!message.retain) this.noteCommand(rest[0], { at: message.at, type: rest[1], text: `${rest[1]}: ${describe(message, rest[1])}` });
    }
    else if (branch === 'gateway') this.takeGateway(message, rest[0], rest[1], rest.slice(2).join('/'));
  }

  takeOwn(name, said) {
    if (name === 'hello') {
      this.isLocked = Boolean(said.needs_token);
      if (this.isLocked) {
        this.takesToken = true;
        return;
      }
      this.prefix = said.prefix;
      this.origins = said.origins;
      this.takesToken = said.takes_token;
      if (said.now) this.compareClocks(said.now - Date.now());
      // All states come again after this message, except those that were withdrawn.
      this.gateways.clear();
      this.gatewaysLeftOut = false;
      this.own = said.gateway;
      for (const robot of this.robots.values()) {
        robot.presence.clear();
        Object.assign(robot, { life: null, numbers: null });
        robot.setOrigin(this.originOf(robot.id));
      }
      this.leftOut.clear();
    } else if (name.startsWith('robot/')) this.takeLife(name.slice(6), said);
    else if (name.startsWith('gateway/')) {
      const gateway = this.gateway(name.slice(8));
      if (gateway) gateway.life = said;
    } else if (name === 'past') this.takePast(said);
    else if (name === 'history') {
      const robot = this.robots.get(said.robot);
      if (robot) robot.day = said;
    } else if (name === 'broker') this.broker = said;
    else if (name === 'token') {
      this.holder = said.accepted ? said.name : '';
      this.maySend = said.accepted && said.role === 'operator';
    }
    else if (name === 'dropped') this.lost += said.messages;
    else if (name === 'refused') this.refuse(said);
  }

  // Takes messages that the page has missed before it came, or while it was away. Messages that came live are newer.
  takePast({ robot: id, updates = [], events = [] }) {
    const { liveFrom, skew } = this;
    for (const message of events) if (message.at < liveFrom) this.take(message);
    Object.assign(this, { liveFrom, skew });
    const robot = updates.length ? this.robot(id, updates.at(-1)[0]) : null;
    if (!robot) return;
    const { pose, heading, trail, track } = robot;
    Object.assign(robot, { trail: [], track: [] });
    for (const [at, payload] of updates) if (at < this.liveFrom) robot.apply(decodeUpdate({ payload, encoding: 'hex' }), at, this.onRay);
    robot.heard = Math.max(robot.heard, updates.at(-1)[0]);
    robot.track.push(...track);
    if (pose) Object.assign(robot, { pose, heading, trail: [...robot.trail, ...trail].slice(-MAX_TRAIL) });
  }
  takeLife(id, said) {
    const known = this.robot(id, said.heard) ?? this.leftOut.get(id);
    if (known) known.life = said;
  }
  // Makes all states unknown, because the connection to the program is lost.
  lose() {
    const lost = { state: 'unknown', since: this.now() };
    for (const each of [...this.robots.values(), ...this.leftOut.values(), ...this.gateways.values()]) if (each.life) Object.assign(each.life, lost);
  }

  takeRobot(message, id, type) {
    const robot = this.robot(id, message.retain ? 0 : message.at);
    this.note(message, 'robot', id, type);
    if (!robot) return;
    if (!message.retain) {
      robot.heard = message.at;
      robot.pulse.add(message.at);
    }
    robot.messages++;
    const update = type === 'update' ? decodeUpdate(message) : null;
    if (update) robot.apply(update, message.at, this.onRay);
  }

  takeGateway(message, id, what, rest) {
    const isState = STATES.includes(what);
    const gateway = isState ? this.gateway(id) : this.gateways.get(id); // an old outcome may be of a gateway that is gone
    if (!gateway && isState) return;
    const said = message.encoding === 'json' && isObject(message.payload) ? message.payload : null;
    if (what === 'state' && message.payload === '' && message.bytes === undefined) this.gateways.delete(id); // withdrawn
    else if (what === 'state') gateway.state = said;
    else if (what === 'stats') gateway.stats = said;
    else if (what === 'thread') takeThread(gateway, said);
    else if (what === 'numbers') this.takeNumbers(id, said);
    else if (what === 'robots') this.takePresence(id, rest, said);
    else if (what === 'response' && said) gateway.join = said.error ? { ...gateway.join, error: said.error } : { ...said, at: message.at };
    else if (what === 'commands' && said) this.takeOutcome(rest, said, message.at);
    const robot = what === 'request' || what === 'response' ? '' : rest.split('/')[0];
    if (what !== 'stats' && what !== 'numbers' && what !== 'thread') this.note(shortened(message), `gateway ${id}`, robot, what);
  }
  takeNumbers(gateway, said) {
    for (const [id, numbers] of Object.entries(isObject(said?.robots) ? said.robots : {})) {
      const robot = isObject(numbers) ? this.robot(id, 0) : null;
      if (!robot) continue;
      robot.numbers = { ...numbers, gateway };
      robot.quality.push([numbers.rssi_dbm, numbers.latency_p50_us]);
      if (robot.quality.length > MAX_QUALITY) robot.quality.shift();
    }
  }
  takePresence(gateway, id, said) {
    const robot = (said ? this.robot(id, 0) : this.robots.get(id)) ?? this.leftOut.get(id);
    if (said) robot?.presence.set(gateway, said);
    else if (robot?.presence.delete(gateway) && robot.presence.size === 0 && !this.leftOut.delete(id)) this.forget(robot);
  }
  // A robot that still talks comes back with its next message.
  forget(robot) {
    for (const command of robot.commands) if (!command.outcome) this.end(robot, command, { ...NO_OUTCOME, why: 'it was forgotten' });
    this.robots.delete(robot.id);
    this.spare.push(robot.number);
    this.quiet = [];
    this.roster++;
  }

  // ---- commands: an outcome names robot and type only, so it belongs to the oldest open command of this type
  // Adds a command of this page, which is `isUnheard` until the broker passes it on, in the order of outcomes.
  expect(robot, command) {
    this.noteCommand(robot.id, Object.assign(command, { at: this.now(), text: `${command.type}: ${describe(command, command.type)}`, isOwn: true, isUnheard: true }));
    robot.outcomes.unshift(command);
    robot.outcomes.length = Math.min(robot.outcomes.length, 5);
  }
  noteCommand(id, command) {
    const robot = this.robots.get(id);
    if (!robot) return;
    const own = !command.isOwn && robot.commands.find((each) => each.isUnheard && !each.outcome && each.text === command.text && each.at - command.at <= OUTCOME_MS);
    if (own) Object.assign(own, { at: command.at, isUnheard: false });
    else robot.commands.push(command);
    robot.commands.sort((a, b) => a.at - b.at);
    let over = robot.commands.length - MAX_COMMANDS;
    robot.commands = robot.commands.filter((each) => !each.outcome || over-- <= 0);
    if (robot.commands.length > MAX_OPEN) this.end(robot, robot.commands[0], NO_OUTCOME);
  }
  takeOutcome(id, said, time) {
    const robot = this.robots.get(id);
    const open = robot?.commands.filter((each) => each.type === said.type && !each.outcome && time - each.at <= OUTCOME_MS) ?? [];
    const command = open.find((each) => !each.isUnheard) ?? open[0];
    const ended = { outcome: said.outcome, after: said.after_ms, why: said.why };
    if (command) this.end(robot, command, ended);
    else this.noteCommand(id, { at: time, type: said.type, text: said.type, ...ended });
  }
  refuse({ topic, why }) {
    const [, asked] = String(topic).slice(this.prefix.length).match(/^\/gateway\/([^/]+)\/request\//) ?? [];
    const gateway = this.gateways.get(asked);
    if (gateway) return void (gateway.join = { ...gateway.join, error: why });
    const [id, type] = String(topic).slice(this.prefix.length + 8).split('/');
    const robot = this.robots.get(id);
    const command = robot?.commands.findLast((each) => each.isUnheard && !each.outcome && each.type === type);
    if (command) this.end(robot, command, { outcome: 'refused', why });
    else this.onOutcome(null, { outcome: 'refused', why });
  }
  end(robot, command, ended) {
    Object.assign(command, ended, { ended: performance.now() });
    if (command.isOwn) this.onOutcome(robot, command);
  }
  expire() {
    const now = this.now();
    for (const robot of this.robots.values())
      for (const command of robot.commands) if (!command.outcome && now - command.at > OUTCOME_MS) this.end(robot, command, NO_OUTCOME);
  }

  note(message, from, robot, type) {
    const row = { message, from, robot: robot ?? '', type: type ?? '' };
    this.messages.push(row);
    if (this.messages.length > MAX_MESSAGES * 1.2) this.messages = this.messages.slice(-MAX_MESSAGES);
    this.onMessage(row);
  }
}
