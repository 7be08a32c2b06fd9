// SPDX-License-Identifier: Apache-2.0
// The steps of a first visitor until a robot is on the map, each with its command. Their state comes from the gateways' topics.
import { $, element, keep, setText } from './dom.js';
import { takesRequests } from './join.js';
import { lifeWords } from './words.js';

const MARKS = { done: '✓', todo: '○', off: '–' };

// Returns {state, title, words, command, hasButton} for each step. The state `off` is an optional step; the button opens the
// join dialog.
export function steps(model) {
  const all = [];
  const add = (isDone, title, words, command, isOptional) => all.push({ state: isDone ? 'done' : isOptional ? 'off' : 'todo', title, words: words || '', command: isDone ? '' : command });
  const isReached = model.isOpen && model.broker.state === 'up';
  add(isReached, 'Broker', isReached ? model.broker.uri : model.broker.why, 'systemctl status mosquitto');
  const gateways = model.orderedGateways();
  const gateway = gateways.find(({ life }) => life?.state === 'online') ?? gateways[0];
  const isThere = gateway?.life?.state === 'online';
  add(isThere, 'Gateway', gateway ? `${gateway.id} is ${lifeWords(gateway.life, model.now())}` : 'none has been heard on this broker', 'systemctl status slam-gateway');
  const links = isThere ? gateway.stats?.meshes ?? {} : {};
  const link = (mesh) => (Object.hasOwn(links, mesh) ? links[mesh] : null);
  const said = (mesh) => (!isThere ? '' : !link(mesh) ? 'the gateway reports within 10 s' : link(mesh).state === 'disabled' ? 'not enabled' : link(mesh).detail || link(mesh).state);
  const isOff = (mesh) => link(mesh)?.state === 'disabled';
  add(link('ble')?.state === 'up', 'Board of the BLE mesh', said('ble'), isOff('ble') ? `echo '{"ble_mesh": {"enabled": true}}' | sudo tee /etc/slam-gateway/gateway.d/ble.json` : 'slam-gatewayctl doctor', isOff('ble'));
  add(link('thread')?.state === 'up', 'Thread', said('thread'), 'slam-gatewayctl doctor', isOff('thread'));
  const robots = [...model.robots.values()].filter((robot) => robot.state === 'online');
  const isBoardUp = link('ble')?.state === 'up';
  const first = isBoardUp ? 'sudo slam-gatewayctl ble permit-join' : 'slam-gateway-sim thread --gateway localhost:47193';
  add(robots.length > 0, 'First robot', robots.length ? robots[0].id : isBoardUp ? 'switch it on: it may join while this runs' : 'switch it on, or simulate some', first);
  const step = all.at(-1);
  if (step.command && isBoardUp && takesRequests(gateway)) Object.assign(step, { words: 'switch it on, and let it in', command: '', hasButton: true });
  add(model.takesToken, 'Commands from this page', model.takesToken ? 'with a token: Unlock' : 'it only watches: web.token_file is not set', 'man slam-gateway-web', true);
  return all;
}

export function drawSteps(model) {
  const all = steps(model);
  keep($('steps'), all.length, () => element('li', {}, element('span', { class: 'mark' }), element('strong'), element('span', { class: 'muted' }), element('code'), element('button', { type: 'button' }, 'Let robots in')));
  all.forEach(({ state, title, words, command, hasButton }, i) => {
    const item = $('steps').children[i];
    item.className = state;
    [MARKS[state], title, words, command].forEach((text, part) => setText(item.children[part], text));
    item.children[3].hidden = !command;
    item.children[4].hidden = !hasButton;
  });
}
