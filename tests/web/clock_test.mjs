// SPDX-License-Identifier: Apache-2.0
// The page shows how long ago a robot was heard, even if the browser's clock differs from the program's.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Model } from '../../web/page/model.js';

const HOUR_MS = 3600e3;

function hear(model, ahead) {
  for (let i = 0; i < 10; i++) model.take({ topic: 'p/robot/r/update', payload: '00010002', encoding: 'hex', at: Date.now() + ahead });
  const robot = model.robots.get('r');
  return { ago: model.now() - robot.lastHeard, freshness: robot.freshness(model.now()) };
}
function modelWithPrefix() {
  const model = new Model();
  model.takeOwn('hello', { prefix: 'p', origins: {}, gateway: 'g' });
  return model;
}

for (const [name, aheads] of Object.entries({
  'behind the browser': [-HOUR_MS],
  'ahead of the browser': [HOUR_MS],
  'ahead, and set right while the page is open': [HOUR_MS, 0],
  'right, and set back while the page is open': [0, -HOUR_MS],
}))
  test(`ages are right when the program's clock is ${name}`, () => {
    const model = modelWithPrefix();
    for (const ahead of aheads) {
      const { ago, freshness } = hear(model, ahead);
      assert.ok(ago > -1000 && ago < 1000, `heard ${ago} ms ago`);
      assert.equal(freshness, 1);
    }
  });

test('a state that a gateway sent hours ago does not move the clock', () => {
  const model = modelWithPrefix();
  model.take({ topic: 'p/gateway/g/state', payload: { state: 'offline' }, at: Date.now() - 5 * HOUR_MS });
  assert.ok(Math.abs(model.now() - Date.now()) < 1000);
});

test('the greeting carries the time of the program', () => {
  const model = new Model();
  model.takeOwn('hello', { prefix: 'p', origins: {}, gateway: 'g', now: Date.now() + HOUR_MS });
  assert.ok(Math.abs(model.now() - HOUR_MS - Date.now()) < 1000);
});

test('a late message does not move the clock', () => {
  const model = modelWithPrefix();
  hear(model, 0);
  const { ago } = hear(model, -2000);
  assert.ok(ago > 1900 && ago < 3000, `heard ${ago} ms ago`);
});
