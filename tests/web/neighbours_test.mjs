// SPDX-License-Identifier: Apache-2.0
// Neighbours of a Thread border router, and which of them are robots.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { test } from 'node:test';
import { extendedAddressOf, Model } from '../../web/page/model.js';

const said = JSON.parse(readFileSync(new URL('../vectors/thread_border_router.json', import.meta.url)));

test('derives an extended address from a link-local address only', () => {
  assert.equal(extendedAddressOf('[fe80::1322:3344:5566:7788%4]:47193'), '1122334455667788');
  assert.equal(extendedAddressOf('[fe80::f:0:0:1]:1'), '020f000000000001');
  assert.equal(extendedAddressOf('FE80:0:0:0:d0e1:5a0c:b0a:908'), 'd2e15a0c0b0a0908');
  for (const other of ['[fd00::1322:3344:5566:7788]:1', '[fe80:1::1322:3344:5566:7788]:1', '127.0.0.1:1', '0x0100', '[fe80:]', '', undefined])
    assert.equal(extendedAddressOf(other), null, other);
});

test('matches a robot with its neighbour entry and keeps the signal over time', () => {
  const model = new Model();
  model.prefix = 'p';
  const take = (rest, payload) => model.take({ topic: `p/gateway/pi/${rest}`, payload, encoding: payload === '' ? 'text' : 'json', at: 1 });
  take('robots/near', { state: 'online', mesh: 'thread', address: '[fe80::1322:3344:5566:7788%4]:47193' });
  take('robots/far', { state: 'online', mesh: 'thread', address: '[fd00::1]:47193' });
  for (const name of ['near', 'far']) model.take({ topic: `$web/robot/${name}`, payload: { state: 'online', gateway: 'pi', heard: 1 }, encoding: 'json', at: 1 });
  const signals = () => model.neighbourOf(model.robots.get('near'))?.quality;
  for (let i = 0; i < 100; i++) {
    said.neighbours[0].rssi_last_dbm = -i;
    take('thread', said);
  }
  assert.deepEqual(signals(), Array.from({ length: 60 }, (_, i) => -40 - i));
  assert.equal(model.neighbourOf(model.robots.get('far')), null);
  assert.deepEqual([...model.gateways.get('pi').thread.neighbours.values()].map((node) => node.isLeader), [false, true]);
  take('thread', { ...said, neighbours: null });
  assert.equal(signals(), undefined);
  take('thread', '');
  assert.equal(model.gateways.get('pi').thread, null);
  take('thread', { neighbours: [null, 5, {}, { extended_address: 'x' }] });
  assert.equal(model.gateways.get('pi').thread.neighbours.size, 1);
});
