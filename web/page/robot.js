// SPDX-License-Identifier: Apache-2.0
// The page of one robot (#/robot/<id>): facts, the last 24 hours, commands, messages, and command lines to type.
import { describe } from './decode.js';
import { drawDay } from './charts.js';
import { $, attempt, element, keep, setText, surface, toast } from './dom.js';
import { typed } from './shown.js';
import { age, clock, dbm, hourOf, meshNames, ms, number, outcomeWords, stateWords } from './words.js';

const MESSAGES = 15;
const ASK_MS = 10000; // the program takes a sample as often

const isBle = (robot) => robot.best?.mesh === 'ble';
const known = (value, words) => (Number.isFinite(value) ? words(value) : 'not known');
// Returns [name, words, explanation] for each fact that this mesh has.
function facts(robot, now) {
  const said = robot.state === 'unknown' ? null : robot.best;
  const counted = robot.figures;
  const best = robot.best ?? {};
  return [
    ['State', stateWords(robot, now)],
    ['Since', robot.life?.since ? hourOf(robot.life.since, now) : '–'],
    ['Last sign of life', robot.lastHeard ? `${age(Math.max(0, now - robot.lastHeard))} ago` : '–'],
    ['Gateway', best.gateway ?? 'none'],
    ['Mesh', meshNames[best.mesh] ?? best.mesh ?? '–'],
    ['Address', best.address ?? '–'],
    isBle(robot) && ['Signal', dbm(counted?.rssi_dbm ?? said?.rssi_dbm), 'Of the last hop to the gateway'],
    isBle(robot) && ['Hops', known(counted?.hops ?? said?.hops, String), 'Relays on the way, known where the gateway has configured the robot’s TTL'],
    isBle(robot) && ['TTL on arrival', known(counted?.ttl ?? said?.ttl, String)],
    ['Latency p50, p99', `${ms(counted?.latency_p50_us)}, ${ms(counted?.latency_p99_us)}`, 'From a message’s arrival at the gateway until it is with the broker or on disk, of the last minute'],
    ['Rate', `${number(robot.pulse.rate(now), 1)} /s`],
    ['Messages', number(counted?.up), 'Since the gateway started'],
    ['Commands', number(counted?.down)],
    ['Repeats', number(counted?.repeats), 'Copies of its messages, whose acknowledgement it had not got'],
    ['Gaps', number(counted?.gaps), 'Pauses of more than three usual intervals: messages that were lost, or not sent'],
  ].filter(Boolean);
}

// Returns command lines for actions that the page cannot take; null for a name that cannot be typed safely.
function lines(robot) {
  const id = typed(robot.id);
  return id && [
    ['Why is it silent?', `slam-gatewayctl doctor ${id}`],
    ['How fast does it answer?', `slam-gatewayctl ping ${id} -c 10`],
    ['Its traffic, live', `slam-gatewayctl watch --robot ${id}`],
    ['What should its firmware do otherwise?', `slam-gatewayctl check ${id}`],
    isBle(robot) ? ['How is it configured?', `slam-gatewayctl ble config ${id}`] : ['Its MQTT-SN session', `slam-gatewayctl mqttsn clients ${id}`],
    ['Who commanded it?', `sudo slam-gatewayctl audit --robot ${id}`],
    ['Forget it, until it comes again', `slam-gatewayctl forget ${id}`],
    ['Refuse it from now on', `sudo slam-gatewayctl ban ${id}`],
  ];
}

// Says why this page may not send commands; empty when it may.
export function lacksWords(model) {
  if (model.maySend) return '';
  if (model.holder) return 'Your token may watch, but not send commands.';
  return model.takesToken ? 'To send commands, unlock this page.' : 'This page only watches.';
}
export const rightsWords = (robot, model) => (robot.best ? lacksWords(model) : 'No gateway serves it: commands will not arrive.');

export class RobotView {
  // `actions`: send(robot, type, place), point(robot), ask(ids).
  constructor(model, actions) {
    Object.assign(this, { model, actions, id: null, askedAt: 0 });
    $('send-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const [x, y] = [$('send-x').valueAsNumber, $('send-y').valueAsNumber];
      if (this.robot && Number.isFinite(x) && Number.isFinite(y)) actions.send(this.robot, 'cmd', { x, y });
      this.draw();
    });
    for (const word of ['start', 'stop']) {
      $(`robot-${word}`).addEventListener('click', () => {
        if (this.robot) actions.send(this.robot, 'run', word);
        this.draw();
      });
    }
    $('robot-point').addEventListener('click', () => this.robot && actions.point(this.robot));
    $('lines').addEventListener('click', (event) => {
      const line = event.target.closest('button')?.parentElement.querySelector('code');
      if (line) copy(line);
    });
  }
  get robot() {
    return this.model.robots.get(this.id);
  }
  show(id) {
    Object.assign(this, { id, askedAt: 0 });
    this.draw();
  }

  draw() {
    const { robot } = this;
    setText($('robot-name'), this.id);
    $('robot-body').hidden = !robot;
    const now = this.model.now();
    setText($('robot-state'), robot ? stateWords(robot, now) : 'No robot of this name has been heard.');
    $('robot-dot').className = `dot ${robot?.state ?? 'unknown'}`;
    if (!robot) return;
    if (performance.now() - this.askedAt > ASK_MS && this.actions.ask([this.id])) this.askedAt = performance.now();
    attempt(() => this.drawFacts(robot, now), () => this.drawDay(robot, now), () => this.drawCommands(robot), () => this.drawMessages(robot), () => this.drawLines(robot));
  }
  drawFacts(robot, now) {
    const all = facts(robot, now);
    keep($('facts'), all.length, () => element('div', {}, element('dt'), element('dd')));
    all.forEach(([name, words, why], i) => {
      const item = $('facts').children[i];
      item.title = why ?? '';
      setText(item.firstChild, name);
      setText(item.lastChild, words);
    });
  }
  drawDay(robot, now) {
    const { day } = robot;
    const known = (day?.online ?? []).filter((percent) => percent !== null);
    const share = known.length ? Math.round(known.reduce((a, b) => a + b, 0) / known.length) : 0;
    setText($('day-words'), known.length ? `online ${share} % of the ${age(known.length * day.slot_ms)} that were seen` : 'nothing yet: slam-gateway-web keeps them from its start on');
    $('day').setAttribute('aria-label', $('day-words').textContent);
    const on = surface($('day'));
    if (on && day) drawDay(on, day, now, isBle(robot));
  }
  drawCommands(robot) {
    const words = rightsWords(robot, this.model);
    setText($('robot-hint'), words);
    const rows = robot.commands.toReversed();
    keep($('commands').tBodies[0], rows.length, () => element('tr', {}, ...Array.from({ length: 3 }, () => element('td'))));
    rows.forEach((command, i) => {
      const row = $('commands').tBodies[0].rows[i];
      row.className = !command.outcome ? '' : command.outcome === 'delivered' || command.outcome === 'sent' ? 'good' : 'wrong';
      [clock(command.at), command.text, outcomeWords(command)].forEach((text, cell) => setText(row.cells[cell], text));
    });
  }
  drawMessages(robot) {
    const rows = [];
    const { messages } = this.model;
    for (let i = messages.length - 1; i >= 0 && rows.length < MESSAGES; i--) if (messages[i].robot === robot.id && messages[i].from === 'robot') rows.push(messages[i]);
    keep($('said').tBodies[0], rows.length, () => element('tr', {}, ...Array.from({ length: 3 }, () => element('td'))));
    rows.forEach(({ message, type }, i) => [clock(message.at), type, describe(message, type)].forEach((text, cell) => setText($('said').tBodies[0].rows[i].cells[cell], text)));
  }
  drawLines(robot) {
    const all = lines(robot);
    $('no-lines').hidden = all !== null;
    keep($('lines'), all?.length ?? 0, () => element('li', {}, element('span'), element('code'), element('button', { type: 'button', class: 'small' }, 'Copy')));
    (all ?? []).forEach(([why, line], i) => {
      const item = $('lines').children[i];
      setText(item.children[0], why);
      setText(item.children[1], line);
    });
  }
}

// Copies the line, or selects it: over plain HTTP from another host, browsers do not allow copying.
async function copy(line) {
  try {
    await navigator.clipboard.writeText(line.textContent);
    toast('Copied.');
  } catch {
    getSelection().selectAllChildren(line);
    toast('Selected: press Ctrl-C.');
  }
}
