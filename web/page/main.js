// SPDX-License-Identifier: Apache-2.0
// Wires link, model and views; keys, theme, dialogs.
import { encodeCmd } from './decode.js';
import { $, attempt, csv, element, keep, save, setText, stamp, toast } from './dom.js';
import { JoinDialog } from './join.js';
import { Link } from './link.js';
import { WorldMap } from './map.js';
import { mcap } from './mcap.js';
import { Model } from './model.js';
import { RobotView, rightsWords } from './robot.js';
import { RobotsView, goneWords, isThere, problems } from './robots.js';
import { shown } from './shown.js';
import { drawSteps } from './steps.js';
import { rosMap } from './rosmap.js';
import { TraceView } from './trace.js';
import { age, byText, lifeWords, meshNames, outcomeWords } from './words.js';

const VIEWS = ['map', 'robots', 'trace'];
const TABLES_MS = 500;

const model = new Model();
const map = new WorldMap($('world'), model, {
  choose,
  drive: (robot, place) => (map.isPast ? toast('The map shows the past: go back to now to send a robot somewhere.') : send(robot, 'cmd', place)),
  hover: (place) => setText($('where'), place ? `${place.x.toFixed(0)}, ${place.y.toFixed(0)} cm` : ''),
  covered: () => {
    const side = $('side').getBoundingClientRect();
    const isBelow = innerWidth <= 700;
    return { left: isBelow ? 0 : side.width + 14, top: 56, bottom: isBelow ? side.height : 0 };
  },
});
const hashOf = (id) => `#/robot/${encodeURIComponent(id)}`;
const robotsView = new RobotsView(model, (id) => { location.hash = hashOf(id); });
const robotView = new RobotView(model, {
  send,
  ask: (robots) => link.say('$web/history', robots),
  point: (robot) => {
    show('map');
    choose(robot);
  },
});
const traceView = new TraceView(model);
const joinDialog = new JoinDialog(model, (gateway, wanted) => mayOrder() && link.say(`${model.prefix}/gateway/${gateway.id}/request/permit_join`, JSON.stringify(wanted)));
$('steps').addEventListener('click', (event) => event.target.closest('button') && joinDialog.open());
model.onRay = (...ray) => map.grid.ray(...ray);
model.mayLeave = (robot) => robot !== map.chosen;
model.onMessage = (row) => traceView.take(row);
model.onOutcome = (robot, command) => {
  if (!robot || (robot !== map.chosen && command.outcome !== 'delivered')) toast(`${robot ? `${robot.id}: ` : ''}${outcomeWords(command)}`);
  if (robot === map.chosen) drawPilot();
  map.change();
};

const link = new Link({
  onOpen: () => { model.isOpen = true; drawLink(); },
  onClose: () => {
    Object.assign(model, { isOpen: false, maySend: false, holder: '', liveFrom: Infinity });
    model.lose();
    drawTables();
    map.change();
  },
  onMessage: (message) => {
    model.take(message);
    if (message.topic.startsWith('$web/')) takeOwn(message);
    map.change();
  },
});

function takeOwn({ topic, payload }) {
  if (/^.web.(robot.|gateway.|history|past)/.test(topic)) return;
  drawLink();
  if (topic === '$web/hello' && model.isLocked && !link.hasToken()) askToken();
  if (topic === '$web/hello' && !model.isLocked) link.say('$web/past', model.newest); // the program answers once a connection
  if (topic !== '$web/token') return;
  if (!payload.accepted && model.isLocked && !$('token-dialog').open) askToken();
  setText($('token-words'), payload.accepted ? '' : payload.why);
  if (payload.accepted) $('token-dialog').close();
  setText($('note'), payload.note || '');
  $('note').hidden = !payload.note;
  map.choose(map.chosen);
  drawPilot();
}

// ---- commands
function mayOrder() {
  if (model.maySend) return true;
  if (model.holder) toast(`The token of ${model.holder} may watch, but not send commands.`);
  else if (model.takesToken) askToken();
  else toast('This page only watches: web.token_file is not set.');
  return false;
}
function send(robot, type, place) {
  if (!mayOrder()) return null;
  const at = typeof place === 'object' ? robot.fromRoom(place.x, place.y) : null;
  if (at && Math.max(Math.abs(at.x), Math.abs(at.y)) > 32767) return toast('A robot cannot be sent that far: 327 m from where it started.'), null;
  const command = at ? { words: `go to ${at.x}, ${at.y}`, payload: encodeCmd(at.x, at.y), encoding: 'hex' } : { words: place, payload: place, encoding: 'text' };
  command.type = type;
  if (!link.say(`${model.prefix}/server/${robot.id}/${type}`, command.payload, command.encoding)) return toast('The page has no connection.'), null;
  model.expect(robot, command);
  drawPilot();
  return command;
}
function choose(robot) {
  map.choose(robot ?? null);
  drawList();
  drawPilot();
}
function step(by) {
  const robots = sorted().filter((robot) => robot.isShown && robot.matches(map.wanted));
  if (robots.length) choose(robots[(robots.indexOf(map.chosen) + by + robots.length) % robots.length]);
}

// ---- the list beside the map
const sorted = () => [...model.robots.values()].sort((a, b) => byText(a.id, b.id));
function drawList() {
  const robots = sorted().filter((robot) => robot.matches(map.wanted));
  $('find').hidden = model.robots.size < 12 && !map.wanted;
  $('empty').hidden = [...model.robots.values()].some((robot) => robot.pose);
  if (!$('empty').hidden) drawSteps(model);
  $('left-out').hidden = model.leftOut.size === 0;
  setText($('left-out'), model.leftOutWords);
  keep($('list'), robots.length, () => {
    const swatch = element('input', { type: 'checkbox' });
    return element('li', {}, swatch, element('button', { type: 'button' }, element('span', { class: 'name' }), element('span', { class: 'muted' })));
  });
  const now = model.now();
  robots.forEach((robot, i) => {
    const line = $('list').children[i];
    const [box, button] = line.children;
    line.robot = robot;
    line.toggleAttribute('data-chosen', robot === map.chosen);
    line.className = robot.isGone ? 'gone' : '';
    box.checked = robot.isShown;
    box.style.accentColor = `rgb(${robot.colour})`;
    const label = `Show ${shown(robot.id)}`;
    if (box.ariaLabel !== label) box.ariaLabel = label;
    button.ariaPressed = robot === map.chosen;
    setText(button.firstChild, robot.id);
    setText(button.lastChild, robot.state === 'online' || !robot.life ? `${robot.pulse.rate(now).toFixed(1)}/s` : robot.state);
    button.title = robot.life ? lifeWords(robot.life, now) : '';
  });
}
$('list').addEventListener('change', (event) => {
  event.target.closest('li').robot.isShown = event.target.checked;
  map.repaint();
});
$('list').addEventListener('click', (event) => {
  const robot = event.target.closest('button') && event.target.closest('li').robot;
  if (robot) choose(robot === map.chosen ? null : robot);
});

function drawPilot() {
  const robot = map.chosen &&= model.robots.get(map.chosen.id) ?? null; // it may have been forgotten
  $('pilot').hidden = !robot;
  if (!robot) return;
  setText($('pilot-name'), robot.id);
  $('pilot-name').href = hashOf(robot.id);
  setText($('pilot-pose'), robot.pose ? `${robot.pose.x.toFixed(0)}, ${robot.pose.y.toFixed(0)} cm` : '');
  setText($('pilot-hint'), rightsWords(robot, model) || 'Click on the map to send it there.');
  keep($('outcomes'), robot.outcomes.length, () => element('li'));
  robot.outcomes.forEach((command, i) => {
    const line = $('outcomes').children[i];
    line.className = !command.outcome ? '' : command.outcome === 'delivered' || command.outcome === 'sent' ? 'good' : 'bad';
    setText(line, `${command.words}: ${outcomeWords(command)}`);
  });
}

// ---- going back in time
const PLAY_MS = 60000; // for the whole time
const MIN_SPEED = 4; // at a speed of 1, playing would never reach now, which moves on
const MIN_TRACK_MS = 10000;
const SLIDER = 1000;
let playing = 0;
const began = () => Math.min(...map.robots.map((robot) => robot.track[0]?.at ?? Infinity));
function drawTime() {
  const [from, now] = [began(), model.now()];
  $('timebar').hidden = !(now - from > MIN_TRACK_MS);
  if (!map.isPast) $('time').value = SLIDER;
  setText($('live'), map.isPast ? `${age(now - map.time)} ago` : 'now');
  $('play').ariaPressed = playing !== 0;
  setText($('play'), playing ? '❚❚' : '▶');
}
function goTo(time) {
  map.goTo(time < model.now() - 500 ? time : Infinity);
  if (!map.isPast) pause();
  drawTime();
}
function pause() {
  clearInterval(playing);
  playing = 0;
}
$('time').addEventListener('input', () => {
  const from = began();
  const share = $('time').valueAsNumber / SLIDER;
  goTo(share === 1 ? Infinity : from + (model.now() - from) * share);
});
$('live').addEventListener('click', () => goTo(Infinity));
$('play').addEventListener('click', () => {
  if (playing) pause();
  else {
    const from = began();
    if (!map.isPast) map.goTo(from);
    const step = Math.max(MIN_SPEED, (model.now() - from) / PLAY_MS) * 50;
    playing = setInterval(() => {
      goTo(map.time + step);
      if (map.isPast) $('time').value = SLIDER * (map.time - from) / (model.now() - from);
    }, 50);
  }
  drawTime();
});

// ---- the head
// Names the first missing part of the way from this page to the robots.
function linkWords() {
  if (!model.isOpen) return 'No connection';
  if (model.isLocked) return 'Locked';
  if (model.broker.state !== 'up') return 'Broker away';
  if (Object.keys(model.broker.unreadable ?? {}).length > 0) return 'Rights missing';
  const gateways = model.orderedGateways();
  const gone = gateways.filter((gateway) => gateway.life && !isThere(gateway));
  if (gone.length) return gone.length === 1 ? goneWords(gone[0], model) : `${gone.length} gateways are gone`;
  for (const { id, stats } of gateways)
    for (const [mesh, link] of Object.entries(stats?.meshes ?? {})) if (link?.state === 'down') return `${meshNames[mesh] ?? mesh} of ${id} is down`;
  return 'Live';
}
function drawLink() {
  const state = linkWords();
  $('link').className = `chip ${state === 'Live' ? 'good' : 'bad'}`;
  setText($('link'), state);
  $('link').title = model.isLocked ? 'This page shows nothing before it has a token' : model.isOpen ? `${model.broker.uri ?? ''} ${model.broker.why ?? ''}` : 'slam-gateway-web does not answer; the page tries again';
  setText($('unlock'), model.maySend ? 'Commands on' : model.holder ? `Watching as ${model.holder}` : model.takesToken ? 'Unlock' : 'Only watching');
  $('unlock').disabled = !model.takesToken;
  $('world').classList.toggle('aim', map.chosen !== null && model.maySend);
}
function drawTrouble() {
  const found = problems(model);
  $('trouble').hidden = found.length === 0;
  $('trouble').classList.toggle('warn', found.every((problem) => problem.isWarning));
  setText($('trouble'), String(found.length));
}
function askToken() {
  setText($('token-words'), '');
  $('token').value = '';
  $('token-dialog').showModal();
}
$('unlock').addEventListener('click', () => (model.holder ? link.lock() : askToken()));
$('token-cancel').addEventListener('click', () => $('token-dialog').close());
$('token-form').addEventListener('submit', (event) => {
  event.preventDefault();
  if (!link.unlock($('token').value.trim())) setText($('token-words'), 'The page has no connection.');
});

// ---- views, theme, keys
let view = 'map';
// `name`: one of VIEWS, or `robot`, which belongs to the tab of all robots.
function show(name) {
  view = name;
  const tab = name === 'robot' ? 'robots' : name;
  for (const each of VIEWS) {
    $(each).hidden = each !== name;
    $(`tab-${each}`).setAttribute('aria-selected', each === tab);
    $(`tab-${each}`).tabIndex = each === tab ? 0 : -1;
  }
  $('robot').hidden = name !== 'robot';
  map.setVisible(name === 'map');
  if (name !== 'robot' && location.hash !== `#${name}`) history[location.hash ? 'pushState' : 'replaceState'](null, '', `#${name}`);
  drawTables();
}
function follow() {
  const [, id] = location.hash.match(/^#\/robot\/(.+)$/) ?? [];
  if (id) {
    robotView.show(decoded(id));
    show('robot');
  } else show(VIEWS.includes(location.hash.slice(1)) ? location.hash.slice(1) : 'map');
}
// Returns the text unchanged if it is not valid: a user may have typed it.
function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}
function drawTables() {
  attempt(() => model.expire(), drawTrouble, drawLink, () => joinDialog.draw());
  if (view === 'map') attempt(drawList, drawPilot, drawTime, () => map.fade());
  if (view === 'robots') robotsView.draw();
  if (view === 'robot') attempt(() => robotView.draw());
  if (view === 'trace' && !traceView.isPaused) attempt(() => traceView.draw());
}
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  map.recolour();
  drawTables();
}
const systemTheme = matchMedia('(prefers-color-scheme: dark)');
const storedTheme = () => localStorage.getItem('slamgw-theme') ?? (systemTheme.matches ? 'dark' : 'light');
systemTheme.addEventListener('change', () => setTheme(storedTheme()));
$('theme').addEventListener('click', () => {
  localStorage.setItem('slamgw-theme', storedTheme() === 'dark' ? 'light' : 'dark');
  setTheme(storedTheme());
});
for (const name of VIEWS) $(`tab-${name}`).addEventListener('click', () => show(name));
document.querySelector('nav').addEventListener('keydown', (event) => {
  const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (!by) return;
  const at = VIEWS.indexOf(view === 'robot' ? 'robots' : view);
  show(VIEWS[(at + by + VIEWS.length) % VIEWS.length]);
  $(`tab-${view}`).focus();
});

function toggle(what) {
  map.show[what] = !map.show[what];
  $(`show-${what}`).setAttribute('aria-pressed', map.show[what]);
  map.repaint();
}
for (const what of ['points', 'grid', 'trails', 'labels']) $(`show-${what}`).addEventListener('click', () => toggle(what));
function showAll(isShown) {
  for (const robot of model.robots.values()) if (robot.matches(map.wanted)) robot.isShown = isShown;
  drawList();
  map.repaint();
}
$('all').addEventListener('click', () => showAll(true));
$('none').addEventListener('click', () => showAll(false));
$('find').addEventListener('input', () => {
  map.wanted = $('find').value;
  drawList();
  map.repaint();
});
$('fold').addEventListener('click', () => {
  $('side-body').hidden = !$('side-body').hidden;
  $('fold').setAttribute('aria-expanded', !$('side-body').hidden);
  map.change();
});
$('zoom-in').addEventListener('click', () => map.zoom(1.4));
$('zoom-out').addEventListener('click', () => map.zoom(1 / 1.4));
$('fit').addEventListener('click', () => map.fitAll());
$('clear').addEventListener('click', () => map.clear());
$('start').addEventListener('click', () => send(map.chosen, 'run', 'start'));
$('stop').addEventListener('click', () => send(map.chosen, 'run', 'stop'));
$('leave').addEventListener('click', () => choose(null));
$('save-png').addEventListener('click', () => $('world').toBlob((blob) => save(`map-${stamp()}.png`, blob)));
$('save-csv').addEventListener('click', () => {
  const lines = ['robot,kind,x_cm,y_cm,worth,at'];
  for (const robot of model.robots.values()) {
    if (!robot.isShown) continue;
    for (const { x, y } of robot.trail) lines.push([csv(robot.id), 'pose', x.toFixed(1), y.toFixed(1), '', ''].join(','));
    for (let i = 0; i < robot.kept; i++) {
      const [x, y, value] = robot.points.subarray(i * 3, i * 3 + 3);
      lines.push([csv(robot.id), 'obstacle', x.toFixed(1), y.toFixed(1), value.toFixed(2), new Date(robot.times[i]).toISOString()].join(','));
    }
  }
  save(`map-${stamp()}.csv`, new Blob([lines.join('\n'), '\n'], { type: 'text/csv' }));
});

$('save-ros').addEventListener('click', () => {
  const name = `map-${stamp()}`;
  const files = rosMap(map.grid, name);
  if (!files) return toast('The grid is empty, or its parts lie too far apart for one picture.');
  save(`${name}.pgm`, new Blob(files.pgm));
  save(`${name}.yaml`, new Blob([files.yaml]));
});

$('save-mcap').addEventListener('click', () => {
  const parts = mcap([...model.robots.values()].filter((robot) => robot.isShown));
  if (!parts) return toast('No robot has been anywhere yet.');
  save(`robots-${stamp()}.mcap`, new Blob(parts));
});

const KEYS = [
  ['1 2 3', 'map, robots, trace'],
  ['← ↑ → ↓', 'move the map'],
  ['+ −', 'closer, farther'],
  ['F', 'fit all robots'],
  ['N B', 'next robot, robot before'],
  ['Esc', 'choose no robot'],
  ['P G T L', 'points, grid, trails, names'],
  ['C', 'clear the map'],
  ['Space', 'pause the trace'],
  ['?', 'these keys'],
];
for (const [key, text] of KEYS) $('keys').append(element('dt', {}, key), element('dd', {}, text));
$('help').addEventListener('click', () => $('keys-dialog').showModal());
const MOVES = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] };
const ON_MAP = {
  '+': () => map.zoom(1.25), '=': () => map.zoom(1.25), '-': () => map.zoom(0.8),
  f: () => map.fitAll(), c: () => map.clear(), n: () => step(1), b: () => step(-1), Escape: () => choose(null),
  p: () => toggle('points'), g: () => toggle('grid'), t: () => toggle('trails'), l: () => toggle('labels'),
};
document.addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector('dialog[open]')) return;
  if (event.target.matches('input:not([type="checkbox"]), select')) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (key === '?') return $('keys-dialog').showModal();
  if (VIEWS[key - 1]) return show(VIEWS[key - 1]);
  if (view === 'trace' && key === ' ' && !event.target.matches('button')) {
    event.preventDefault();
    return traceView.pause();
  }
  if (view !== 'map') return;
  const onTabs = event.target.closest('nav');
  if (MOVES[key] && !onTabs) map.pan(...MOVES[key]);
  else if (ON_MAP[key]) ON_MAP[key]();
});

setTheme(storedTheme());
addEventListener('hashchange', follow);
addEventListener('popstate', follow);
follow();
drawLink();
setInterval(drawTables, TABLES_MS);
document.addEventListener('visibilitychange', () => map.setVisible(!document.hidden && view === 'map'));
window.slamgw = { model, map, traceView, robotsView, robotView }; // for the console, and for tests
