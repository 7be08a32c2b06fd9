// SPDX-License-Identifier: Apache-2.0
// Texts about robots that join, and when the page offers the button for it. The documents are those of docs/topics.md.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { story, takesRequests } from '../../web/page/join.js';
import { Model } from '../../web/page/model.js';
import { steps } from '../../web/page/steps.js';

const event = (event, uuid, robot = '', why = '') => ({ event, uuid, robot, why });

test('each device has one line with its newest event', () => {
  const events = [event('joining', 'aa'), event('joined', 'aa', 'lego-1'), event('joining', 'bb'), event('failed', 'bb', '', 'it asks for an OOB value'), event('configured', 'aa', 'lego-1')];
  assert.deepEqual(story({ events }), [['good', 'lego-1 is ready'], ['bad', 'The device bb did not join: it asks for an OOB value']]);
  for (const nothing of [null, {}, { error: 'x' }, { events: 'x' }, { events: [null, 1] }]) assert.deepEqual(story(nothing), []);
});

const board = (counters) => ({ meshes: { ble: { enabled: true, state: 'up', counters }, thread: { enabled: true, state: 'up' } } });
function modelWith(stats) {
  const model = new Model();
  Object.assign(model, { prefix: 'p', isOpen: true });
  model.take({ topic: 'p/gateway/g/stats', payload: stats, encoding: 'json', at: 1 });
  model.takeOwn('gateway/g', { state: 'online' });
  return model;
}

test('the first step has a button if the gateway accepts requests, else a command', () => {
  const first = (counters) => steps(modelWith(board(counters))).find(({ title }) => title === 'First robot');
  assert.equal(first({ sent: 1 }).command, 'sudo slam-gatewayctl ble permit-join');
  assert.deepEqual([first({ join_requests: 0 }).command, first({ join_requests: 0 }).hasButton], ['', true]);
});

test('shows the newest response, and a refusal by the broker as an error', () => {
  const model = modelWith(board({ join_requests: 0 }));
  model.take({ topic: 'p/gateway/g/response/permit_join', payload: { seconds_left: 60, under_way: 0, events: [] }, encoding: 'json', at: 5000 });
  const gateway = model.gateways.get('g');
  assert.ok(takesRequests(gateway));
  assert.equal(gateway.join.at + 1000 * gateway.join.seconds_left, 65000);
  model.takeOwn('refused', { topic: 'p/gateway/g/request/permit_join', why: 'not authorised' });
  assert.deepEqual([gateway.join.error, gateway.join.seconds_left], ['not authorised', 60]); // robots may still join
});
