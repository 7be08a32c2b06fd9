// SPDX-License-Identifier: Apache-2.0
// Draws both meshes as far as they are known: from the broker over each gateway and mesh to its robots. BLE reports signal,
// relays and TTL; MQTT-SN reports address, latency, repeats and gaps; a Thread border router reports its neighbours and their
// link quality. No source reports which node relays for which, so that is not drawn.
import { colour, element, keep, setText, surface, svg } from './dom.js';
import { dbm, lifeWords, meshNames, ms, number, stateWords } from './words.js';

const MOST = 40; // robots shown of one mesh; robots that need attention come first

export const signal = (robot) => robot.figures?.rssi_dbm ?? (robot.state === 'unknown' ? undefined : robot.best?.rssi_dbm);
const relays = (robot) => robot.figures?.hops ?? (robot.state === 'unknown' ? undefined : robot.best?.hops);
const need = (robot) => [robot.state === 'online' || robot.state === 'asleep' ? 1 : 0, robot.best?.mesh === 'ble' ? signal(robot) ?? 0 : -(robot.figures?.latency_p50_us ?? 0)];
const byNeed = (a, b) => need(a)[0] - need(b)[0] || need(a)[1] - need(b)[1] || (a.id < b.id ? -1 : 1);
const count = (robots, key) => Object.entries(Object.groupBy(robots, key)).map(([name, all]) => `${all.length} ${name}`).join(', ');

function quality(robot, now) {
  if (robot.state !== 'online' && robot.state !== 'asleep') return stateWords(robot, now);
  const { figures } = robot;
  const counted = [['repeats', figures?.repeats], ['gaps', figures?.gaps]].filter(([, value]) => value > 0).map(([name, value]) => `${value} ${name}`);
  if (robot.best?.mesh !== 'ble') return [ms(figures?.latency_p50_us), ...counted, ...(robot.neighbour ? [neighbourWords(robot.neighbour)] : []), robot.best?.address ?? ''].join(' · ');
  const ttl = figures?.ttl ?? robot.best?.ttl;
  return [dbm(signal(robot)), wayWords(robot), ...(Number.isFinite(ttl) ? [`TTL ${ttl}`] : []), ...counted].join(' · ');
}
function wayWords(robot) {
  const hops = relays(robot);
  return !Number.isFinite(hops) ? 'way not known' : hops === 0 ? 'direct' : `${hops} relay${hops === 1 ? '' : 's'}`;
}
// Describes a node that the border router hears itself.
function neighbourWords(node) {
  const lost = node.frame_error_rate > 0 ? [`${(100 * node.frame_error_rate).toFixed(1)} % of frames lost`] : [];
  return [`${node.child ? (node.sleepy ? 'sleepy child' : 'child') : node.isLeader ? 'leader' : 'router'} ${node.rloc16 ?? ''}`, `link quality ${number(node.link_quality)} of 3`, dbm(node.rssi_last_dbm), ...lost].join(' · ');
}
// Describes the border router's own place in its mesh; `hidden`: the number of neighbours that are not shown.
function nodeWords(thread, hidden) {
  if (!thread) return [];
  const { role, network_name: name, channel, rloc16, extended_address: address } = thread;
  const leftOut = hidden + (thread.left_out ?? 0);
  return [`this node: ${role ?? 'role not known'}`, ...(name ? [name] : []), ...(Number.isFinite(channel) ? [`channel ${channel}`] : []), ...[rloc16, address].filter(Boolean), ...(leftOut > 0 ? [`${leftOut} more neighbours are not shown`] : [])];
}
// Draws the way from the gateway: a circle for each relay, a dotted line for an unknown way, a thicker one for a strong signal.
function drawWay(way, robot) {
  const hops = robot.best?.mesh === 'ble' ? relays(robot) : 0;
  const isThere = robot.state === 'online' || robot.state === 'asleep';
  drawLine(way, hops, isThere, robot.neighbour ? linkWidth(robot.neighbour) : robot.best?.mesh !== 'ble' ? 1.5 : signal(robot) >= -60 ? 3 : signal(robot) >= -75 ? 2 : 1.2);
}
const linkWidth = (node) => (node.link_quality >= 3 ? 3 : node.link_quality === 2 ? 2 : 1.2);
function drawLine(way, hops, isThere, wide) {
  const sketch = [hops, isThere, wide].join();
  if (way.sketch === sketch) return;
  way.sketch = sketch;
  const parts = [svg('line', { x1: 2, y1: 8, x2: 70, y2: 8, 'stroke-width': wide, 'stroke-dasharray': !isThere ? '5 5' : Number.isFinite(hops) ? 'none' : '1 4', class: isThere ? '' : 'cut' })];
  for (let i = 1; i <= Math.min(hops ?? 0, 6); i++) parts.push(svg('circle', { cx: 2 + 68 * i / (Math.min(hops, 6) + 1), cy: 8, r: 3.5 }));
  way.replaceChildren(...parts);
}
const sparkOf = (robot) => robot.neighbour?.quality ?? robot.quality.map(([rssi, latency]) => (robot.best?.mesh === 'ble' ? rssi : -latency));
function drawSpark(canvas, all) {
  const on = surface(canvas);
  const values = all.filter(Number.isFinite);
  if (!on || values.length < 2) return;
  const [low, high] = [Math.min(...values), Math.max(...values)];
  on.context.beginPath();
  values.forEach((value, i) => on.context.lineTo(2 + i * (on.width - 4) / (values.length - 1), on.height - 3 - (high > low ? (value - low) / (high - low) : 0.5) * (on.height - 6)));
  on.context.strokeStyle = colour('--accent');
  on.context.lineWidth = 1.4;
  on.context.stroke();
}

const newRobot = () => element('li', {}, element('a', { class: 'name' }, element('span', { class: 'dot' }), element('span')),
  svg('svg', { class: 'way', viewBox: '0 0 72 16', 'aria-hidden': 'true' }), element('canvas', { class: 'spark', title: 'Signal or latency of the last 10 minutes; higher is better' }), element('span', { class: 'muted' }));
const newMesh = () => element('div', { class: 'mesh' }, element('h3', {}, element('span', { class: 'dot' }), element('span')), element('p', { class: 'muted' }), element('ul'), element('p', { class: 'muted' }));
const newGateway = () => element('div', { class: 'card pad' }, element('div', { class: 'row wrap chain' }, ...['Broker', ''].map((text) => element('span', { class: 'state' }, element('span', { class: 'dot' }), element('strong', {}, text)))), element('div', { class: 'meshes' }));

// `robots`: the robots to show. Each is drawn at the gateway that reports its state.
export function drawMeshes(parent, model, robots, isThere) {
  const gateways = model.orderedGateways();
  const here = Map.groupBy(robots, (robot) => robot.life?.gateway);
  const named = new Set([...model.robots.values()].map((robot) => robot.neighbour));
  keep(parent, gateways.length, newGateway);
  gateways.forEach((gateway, i) => {
    const [chain, place] = parent.children[i].children;
    chain.children[0].firstChild.className = `dot ${!model.isOpen ? 'unknown' : model.broker.state === 'up' ? 'online' : 'offline'}`;
    chain.children[1].firstChild.className = `dot ${isThere(gateway) ? 'online' : gateway.life?.state === 'gone' ? 'offline' : 'unknown'}`;
    setText(chain.children[1].lastChild, isThere(gateway) ? gateway.id : `${gateway.id}: ${lifeWords(gateway.life, model.now())}`);
    chain.classList.toggle('cut', !isThere(gateway));
    const byMesh = Map.groupBy(here.get(gateway.id) ?? [], (robot) => robot.best?.mesh ?? '');
    const links = Object.entries(gateway.stats?.meshes ?? {}).filter(([mesh, link]) => link?.state !== 'disabled' || byMesh.has(mesh));
    const meshes = [...new Set([...links.map(([mesh]) => mesh), ...byMesh.keys()])];
    keep(place, meshes.length, newMesh);
    const thread = isThere(gateway) ? gateway.thread : null;
    const others = [...(thread?.neighbours.values() ?? [])].filter((node) => !named.has(node));
    meshes.forEach((mesh, n) => drawMesh(place.children[n], mesh, isThere(gateway) ? gateway.stats?.meshes?.[mesh] : null, byMesh.get(mesh) ?? [], mesh === 'thread' ? thread : null, mesh === 'thread' ? others : [], model.now()));
  });
}
// `thread`: the border router's report, else null; `others`: its neighbours that are not robots by their addresses.
function drawMesh(card, mesh, link, robots, thread, others, now) {
  const [head, summary, list, rest] = card.children;
  head.firstChild.className = `dot ${!link ? 'unknown' : link.state === 'up' ? 'online' : 'offline'}`;
  setText(head.lastChild, meshNames[mesh] ?? String(mesh));
  const isMany = robots.length > MOST;
  const words = [...nodeWords(thread, Math.max(0, others.length - MOST)), robots.length ? count(robots, (robot) => robot.state) : 'no robot yet', ...(mesh === 'ble' && isMany ? [count(robots, wayWords)] : []), ...(link?.counters?.relayed > 0 ? [`got ${link.counters.relayed} updates of robots elsewhere`] : []), ...(link?.state === 'down' ? [`link down: ${link.detail ?? ''}`] : [])];
  setText(summary, words.join(' · '));
  const shown = robots.sort(byNeed).slice(0, MOST);
  if (!isMany) shown.sort((a, b) => (mesh === 'ble' ? (relays(a) ?? 99) - (relays(b) ?? 99) : 0) || a.id.localeCompare(b.id, undefined, { numeric: true }));
  const nodes = others.slice(0, MOST);
  keep(list, shown.length + nodes.length, newRobot);
  shown.forEach((robot, i) => {
    const [link, way, spark, said] = list.children[i].children;
    link.href = `#/robot/${encodeURIComponent(robot.id)}`;
    link.firstChild.className = `dot ${robot.state}`;
    setText(link.lastChild, robot.id);
    drawWay(way, robot);
    setText(said, quality(robot, now));
    if (spark.checkVisibility()) drawSpark(spark, sparkOf(robot));
  });
  nodes.forEach((node, i) => {
    const [name, way, spark, said] = list.children[shown.length + i].children;
    name.removeAttribute('href');
    name.firstChild.className = 'dot unknown';
    setText(name.lastChild, node.extended_address);
    drawLine(way, 0, true, linkWidth(node));
    setText(said, neighbourWords(node));
    if (spark.checkVisibility()) drawSpark(spark, node.quality);
  });
  rest.hidden = !isMany;
  setText(rest, `${robots.length - shown.length} more, which do better. The field above finds each.`);
}
