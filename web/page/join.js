// SPDX-License-Identifier: Apache-2.0
// A dialog that opens a gateway's BLE mesh to new robots for a while, and shows which robots join. If the gateway takes no
// requests over the broker, the dialog shows a command to type instead.
import { $, element, keep, setText } from './dom.js';
import { lacksWords } from './robot.js';
import { isThere } from './robots.js';
import { typed } from './shown.js';

const PATIENCE_MS = 10000; // for an answer

const ble = (gateway) => (isThere(gateway) ? gateway.stats?.meshes?.ble : null);
const hasBle = (gateway) => ble(gateway)?.enabled === true;
// Returns whether the gateway takes requests: only then it counts them (docs/topics.md).
export const takesRequests = (gateway) => hasBle(gateway) && ble(gateway).counters?.join_requests !== undefined;

const left = (join, now) => (join?.seconds_left > 0 ? Math.max(0, join.at + join.seconds_left * 1000 - now) : 0);
const minutes = (time) => `${Math.floor(time / 60000)}:${String(Math.floor(time / 1000) % 60).padStart(2, '0')}`;

// Returns [class, words] for each device, the newest last.
export function story(join) {
  const devices = new Map();
  for (const { event, uuid, robot, why } of Array.isArray(join?.events) ? join.events.filter(Boolean) : []) {
    const name = robot || `The device ${uuid}`;
    if (event === 'joining') devices.set(uuid, ['', `${name} is joining …`]);
    if (event === 'joined') devices.set(uuid, ['', `${name} is in the mesh, and is configured …`]);
    if (event === 'configured') devices.set(uuid, ['good', `${name} is ready`]);
    if (event === 'failed') devices.set(uuid, ['bad', `${name} did not join: ${why}`]);
  }
  return [...devices.values()];
}

export class JoinDialog {
  // `order(gateway, wanted)` returns whether the request was sent.
  constructor(model, order) {
    Object.assign(this, { model, order, asked: null });
    $('join-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const name = $('join-name').value.trim();
      this.ask({ seconds: 60 * $('join-minutes').valueAsNumber, ...(name && { name }) });
    });
    $('join-end').addEventListener('click', () => this.ask({ seconds: 0 }));
    $('join-close').addEventListener('click', () => $('join-dialog').close());
    $('join').addEventListener('click', () => this.open());
  }
  open() {
    this.asked = null;
    for (const { join } of this.gateways) if (join) join.error = null; // errors of earlier requests
    this.draw();
    $('join-dialog').showModal();
  }
  ask(wanted) {
    const { gateway } = this;
    if (!gateway || !this.order(gateway, wanted)) return;
    this.asked = { join: gateway.join, at: performance.now() };
    this.draw();
  }

  get gateways() {
    return this.model.orderedGateways().filter(hasBle);
  }
  get gateway() {
    const all = this.gateways;
    return all.find(({ id }) => id === $('join-gateway').value) ?? all[0];
  }
  draw() {
    const { gateway, gateways } = this;
    $('join').hidden = gateways.length === 0;
    keep($('join-gateway'), gateways.length, () => element('option'));
    gateways.forEach(({ id }, i) => {
      const option = $('join-gateway').children[i];
      setText(option, id);
      option.value = id;
    });
    $('join-at').hidden = gateways.length < 2;
    const takes = gateway !== undefined && takesRequests(gateway);
    for (const id of ['join-begin', 'join-events']) $(id).hidden = !takes;
    $('join-command').hidden = takes || !gateway;
    const time = left(gateway?.join, this.model.now());
    $('join-end').hidden = !takes || time === 0;
    setText($('join-words'), this.words(gateway, takes, time));
    $('join-words').className = takes && gateway.join?.error ? 'bad' : '';
    const name = typed($('join-name').value.trim());
    setText($('join-command'), `sudo slam-gatewayctl ble permit-join --minutes ${$('join-minutes').valueAsNumber || 5}${name ? ` --id ${name}` : ''}`);
    const told = takes ? story(gateway.join) : [];
    keep($('join-events'), told.length, () => element('li'));
    told.forEach(([look, words], i) => {
      $('join-events').children[i].className = look;
      setText($('join-events').children[i], words);
    });
  }
  words(gateway, takes, time) {
    if (!gateway) return 'No gateway here has a BLE mesh.';
    if (!takes) return `Gateway ${gateway.id} takes no requests: ble_mesh.provisioning.over_mqtt is not set. On its host:`;
    const { join } = gateway;
    if (this.asked && this.asked.join === join) {
      const isLate = performance.now() - this.asked.at > PATIENCE_MS;
      return isLate ? `Gateway ${gateway.id} does not answer. May slam-gateway-web’s user write ${this.model.prefix}/gateway/+/request/permit_join at the broker?` : 'Asking …';
    }
    if (join?.error) return String(join.error);
    if (time > 0) return `Robots may join for another ${minutes(time)}: switch them on.`;
    if (join?.under_way > 0) return 'No more robots may join; those that have begun may finish.';
    return lacksWords(this.model);
  }
}
