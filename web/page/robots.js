// SPDX-License-Identifier: Apache-2.0
// Robots and gateways: problems with their remedies first, then both meshes, then a table with sparklines.
import { $, attempt, colour, element, keep, setText, surface } from './dom.js';
import { drawMeshes, signal } from './meshes.js';
import { shown, typed } from './shown.js';
import { age, byText, bytes, dbm, lifeWords, meshNames, ms, number, stateWords } from './words.js';

const order = ['offline', 'unknown', 'asleep', 'online'];

const deceives = (name) => shown(name) !== name;
const rssi = (robot) => signal(robot) ?? robot.neighbour?.rssi_last_dbm;

// "Gateway pi is gone since 14:02"
export const goneWords = (gateway, model) => `Gateway ${gateway.id} is ${lifeWords(gateway.life, model.now())}`;

// Returns {title, remedy, isWarning} for each problem, worst first.
export function problems(model) {
  const found = [];
  const add = (title, remedy, isWarning = false) => found.push({ title, remedy: remedy || '', isWarning });
  if (!model.isOpen) return [{ title: 'This page has lost slam-gateway-web', remedy: 'It tries again by itself. Is the service running? systemctl status slam-gateway-web' }];
  if (model.broker.state !== 'up') add(`slam-gateway-web does not reach the broker at ${model.broker.uri}`, model.broker.why);
  for (const [filter, why] of Object.entries(model.broker.unreadable ?? {}))
    add(`The broker does not let this page read ${filter}`, `${why}. In its access control list, for slam-gateway-web's user: topic read ${filter}`);
  if (model.broker.state === 'up' && model.gateways.size === 0 && !Object.keys(model.broker.unreadable ?? {}).length)
    add('No gateway has been heard on this broker', `Is slam-gateway running, and is its topics.prefix "${model.prefix}"? slam-gatewayctl status. May slam-gateway-web's user read ${model.prefix}/# at the broker?`);
  for (const gateway of model.orderedGateways()) problemsOf(gateway, model, add);
  if (model.gatewaysLeftOut) add(`More gateways are not shown: a page keeps ${model.gateways.size}`, 'Does a client invent gateways? At the broker: topic write <prefix>/gateway/<gateway>/# for each gateway alone', true);
  for (const robot of model.robots.values()) {
    if (robot.state === 'online' && robot.best?.contested === true) add(`${robot.id} is contested: another client uses its name`, 'Two robots, or a foreign client, of that name: /usr/share/doc/slam-gateway/security.md', true);
    const name = typed(robot.id);
    if (robot.state === 'offline') add(`${robot.id} is offline`, `${robot.lastHeard ? `Silent for ${age(Math.max(0, model.now() - robot.lastHeard))}. ` : ''}Is it switched on and in range?${name ? ` slam-gatewayctl doctor ${name}` : ''}`, true);
  }
  const deceptive = [...model.robots.keys(), ...model.gateways.keys()].filter(deceives);
  if (deceptive.length) add(`${deceptive.length} name${deceptive.length === 1 ? ' is' : 's are'} made to look like another: ${deceptive.slice(0, 5).join(', ')}`, 'Characters that hide, or look like others, are shown as \\u and digits. slam-gatewayctl robots shows the addresses; slam-gatewayctl ban refuses one.', true);
  if (model.leftOut.size) add(model.leftOutWords, 'The map, the table and the trace’s filter have the others. All are in /metrics and slam-gatewayctl robots.', true);
  if (model.lost > 0) add(`This page was too slow for ${model.lost} messages`, 'They are missing in the map and the trace; the numbers are right.', true);
  return found.sort((a, b) => a.isWarning - b.isWarning);
}
export const isThere = (gateway) => gateway.life?.state === 'online';

function problemsOf(gateway, model, add) {
  const name = `Gateway ${gateway.id}`;
  const ahead = gateway.life?.clock_ahead_ms ?? 0;
  if (ahead) add(`The clock of gateway ${gateway.id} is ${age(Math.abs(ahead))} ${ahead > 0 ? 'ahead' : 'behind'}`, 'Times of its robots are corrected by that here. On its host: timedatectl', true);
  if (gateway.life?.state === 'gone') return add(goneWords(gateway, model), 'The broker has lost it, so nothing is known of its robots. On its host: systemctl status slam-gateway');
  if (gateway.life?.state === 'silent') return add(goneWords(gateway, model), 'The broker has its connection, and nothing comes over it: it may hang. On its host: slam-gatewayctl status');
  const { stats } = gateway;
  if (!stats || !isThere(gateway)) return;
  if (stats.broker?.state && stats.broker.state !== 'up') add(`${name}: broker ${stats.broker.state}`, stats.broker.why);
  const rights = stats.broker?.missing_rights;
  for (const right of Array.isArray(rights) ? rights.slice(0, 10) : []) add(`${name} lacks a right at the broker: ${right?.what}`, `In the access control list: ${right?.grant}`);
  for (const [mesh, link] of Object.entries(stats.meshes ?? {})) {
    if (link?.state === 'down') add(`${name}: the link to ${meshNames[mesh] ?? mesh} is down`, link.detail);
    if (link?.role === 'detached' || link?.role === 'disabled') add(`${name}: its host has no Thread network (${link.role})`, 'No robot of Thread is heard. On its host: slam-gatewayctl doctor');
  }
  const store = stats.store ?? {};
  if (store.full) add(`${name}: its store is full`, 'Robots are not acknowledged until the broker has taken some messages. Is the broker up?');
  if (store.state && store.state !== 'working' && store.state !== 'opening') add(`${name}: its store is ${store.state}`, store.why);
  if (store.dead_letters > 0) add(`${name} keeps ${store.dead_letters} dead letter${store.dead_letters === 1 ? '' : 's'}`, 'Messages that the broker has refused: slam-gatewayctl store list', true);
}

// ---- the table
const COLUMNS = [
  ['Robot', (r) => r.id, (r) => r.id],
  ['State', stateWords, (r) => order.indexOf(r.state)],
  ['Mesh', (r) => meshNames[r.best?.mesh] ?? r.best?.mesh ?? '–'],
  ['Gateway', (r) => r.best?.gateway ?? r.numbers?.gateway ?? '–'],
  ['Last minute', null, (r, now) => -r.pulse.rate(now)],
  ['Rate', (r, now) => `${number(r.pulse.rate(now), 1)} /s`, (r, now) => -r.pulse.rate(now), true],
  ['Latency p50', (r) => ms(r.figures?.latency_p50_us), (r) => -(r.figures?.latency_p50_us ?? -1), true],
  ['p99', (r) => ms(r.figures?.latency_p99_us), (r) => -(r.figures?.latency_p99_us ?? -1), true],
  ['RSSI', (r) => dbm(rssi(r)), (r) => rssi(r) ?? 1, true],
  ['Silent', (r, now) => (r.lastHeard ? age(Math.max(0, now - r.lastHeard)) : '–'), (r) => r.lastHeard, true],
  ['Messages', (r) => String(r.figures?.up ?? r.messages), (r) => -(r.figures?.up ?? r.messages), true],
  ['Repeats', (r) => number(r.figures?.repeats), (r) => -(r.figures?.repeats ?? 0), true],
];

// Shows a dash for a gateway that is gone: its last values are not shown as if they were current.
const now = (show) => (gateway) => (gateway.stats && isThere(gateway) ? show(gateway) : '–');
const GATEWAY_COLUMNS = [
  ['Gateway', (g) => g.id],
  ['State', (g, now) => lifeWords(g.life, now)],
  ['Version', (g) => String(g.stats?.version ?? g.state?.version ?? '–')],
  ['Broker', now((g) => String(g.stats.broker?.state ?? '–'))],
  ['Up for', now((g) => age((g.stats.uptime_s ?? NaN) * 1000)), true],
  ['From robots', now((g) => number(g.stats.messages?.up)), true],
  ['To robots', now((g) => number(g.stats.messages?.down)), true],
  ['On disk', now((g) => number(g.stats.store?.depth)), true],
  ['Memory', now((g) => bytes(g.stats.memory_rss_bytes)), true],
];

export class RobotsView {
  constructor(model, choose) {
    Object.assign(this, { model, choose, sort: 0, isUp: true });
    // Only visible rows get a sparkline: there may be a thousand.
    this.eyes = new IntersectionObserver((entries) => entries.forEach(({ target, isIntersecting }) => { target.isSeen = isIntersecting; }));
    const head = $('table').tHead.rows[0];
    COLUMNS.forEach(([name, , , isNumber], i) => {
      const button = element('button', { type: 'button' }, name);
      button.addEventListener('click', () => {
        [this.sort, this.isUp] = [i, this.sort === i ? !this.isUp : true];
        this.draw();
      });
      head.append(element('th', { class: isNumber ? 'number' : null, scope: 'col', 'data-name': name }, button));
    });
    for (const [name, , isNumber] of GATEWAY_COLUMNS) $('gateways').tHead.rows[0].append(element('th', { class: isNumber ? 'number' : null, scope: 'col', 'data-name': name }, name));
    $('table').tBodies[0].addEventListener('click', (event) => {
      const id = event.target.closest('tr')?.robot;
      if (id) this.choose(id);
    });
    $('find-robots').addEventListener('input', () => this.draw());
    $('table').tBodies[0].addEventListener('keydown', (event) => {
      if (event.key === 'Enter' && event.target.robot) this.choose(event.target.robot);
    });
  }

  // The robots that match the field above.
  get robots() {
    return [...this.model.robots.values()].filter((robot) => robot.matches($('find-robots').value));
  }
  draw() {
    const now = this.model.now();
    for (const robot of this.model.robots.values()) robot.neighbour = this.model.neighbourOf(robot);
    attempt(() => this.drawProblems(), () => drawMeshes($('picture'), this.model, this.robots, isThere), () => this.drawTable(now), () => this.drawGateways());
  }
  drawProblems() {
    const list = problems(this.model).slice(0, 30);
    const isFine = list.length === 0;
    if (isFine) list.push({ title: '', remedy: `All is well: ${this.model.robots.size} robots, ${this.model.gateways.size} gateway${this.model.gateways.size === 1 ? '' : 's'}.` });
    keep($('problems'), list.length, () => element('li', {}, element('strong'), element('span')));
    list.forEach((problem, i) => {
      const row = $('problems').children[i];
      row.className = isFine ? 'fine' : problem.isWarning ? 'warn' : '';
      setText(row.firstChild, problem.title);
      setText(row.lastChild, problem.remedy);
    });
  }

  drawTable(now) {
    const [, show, key] = COLUMNS[this.sort];
    const value = key ?? show;
    const robots = this.robots.map((robot) => [robot, value(robot, now)]);
    robots.sort(([a, x], [b, y]) => (typeof x === 'string' ? byText(x, y) : x - y) * (this.isUp ? 1 : -1) || byText(a.id, b.id));
    [...$('table').tHead.rows[0].cells].forEach((cell, i) => {
      if (i === this.sort) cell.setAttribute('aria-sort', this.isUp ? 'ascending' : 'descending');
      else cell.removeAttribute('aria-sort');
    });
    const body = $('table').tBodies[0];
    keep(body, robots.length, () => this.newRow());
    const rows = [...body.rows];
    robots.forEach(([robot], i) => fillRow(rows[i], robot, now));
    // Drawn after all texts: reading a canvas's size after a change would lay out the whole table again.
    robots.forEach(([robot], i) => rows[i].isSeen && sparkline(rows[i].querySelector('canvas'), robot, now));
  }
  newRow() {
    const row = newRow();
    this.eyes.observe(row);
    return row;
  }
  drawGateways() {
    const body = $('gateways').tBodies[0];
    const gateways = this.model.orderedGateways();
    keep(body, gateways.length, () => element('tr', {}, ...GATEWAY_COLUMNS.map(([name, , isNumber]) => element('td', { 'data-name': name, class: isNumber ? 'number' : null }))));
    gateways.forEach((gateway, row) => GATEWAY_COLUMNS.forEach(([, show], i) => setText(body.rows[row].cells[i], show(gateway, this.model.now()))));
  }
}

function newRow() {
  const cells = COLUMNS.map(([name, , , isNumber]) => element('td', { 'data-name': name, class: isNumber ? 'number' : null }));
  cells[1].append(element('span', { class: 'state' }, element('span', { class: 'dot' }), element('span')));
  cells[4].append(element('canvas'));
  return element('tr', { tabindex: 0, title: 'All about it' }, ...cells);
}
function fillRow(row, robot, now) {
  row.robot = robot.id;
  COLUMNS.forEach(([name, show], i) => {
    const cell = row.cells[i];
    if (name === 'Robot') cell.className = deceives(robot.id) ? 'deceptive' : '';
    if (name === 'State') {
      cell.firstChild.firstChild.className = `dot ${order.includes(robot.state) ? robot.state : 'unknown'}`;
      setText(cell.firstChild.lastChild, show(robot, now));
    } else if (show) setText(cell, show(robot, now));
  });
}
function sparkline(canvas, robot, now) {
  const on = surface(canvas);
  if (!on) return;
  const counts = robot.pulse.list(now);
  const most = Math.max(5, ...counts);
  on.context.beginPath();
  const first = robot.heard && now - robot.heard > 60000 ? 0 : counts.findIndex((count) => count > 0); // where a new robot's line begins
  counts.forEach((count, i) => first >= 0 && i >= first && on.context.lineTo(i * on.width / (counts.length - 1), on.height - 2 - count / most * (on.height - 4)));
  on.context.strokeStyle = colour('--accent');
  on.context.lineWidth = 1.4;
  on.context.stroke();
}
