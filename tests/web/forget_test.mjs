// SPDX-License-Identifier: Apache-2.0
// A robot that an operator forgets leaves open pages: its gateway withdraws its presence.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { MAX_ROBOTS, Model } from '../../web/page/model.js';

function modelWith(...ids) {
  const model = new Model();
  model.takeOwn('hello', { prefix: 'p', origins: {}, gateway: 'g' });
  for (const id of ids) meet(model, id);
  return model;
}
function meet(model, id, gateway = 'g') {
  model.take({ topic: `p/gateway/${gateway}/robots/${id}`, payload: { state: 'offline', mesh: 'thread' }, encoding: 'json', at: 1, retain: true });
  model.takeOwn(`robot/${id}`, { state: 'offline', since: 1, heard: 1, gateway });
}
const withdraw = (model, id, gateway = 'g') => model.take({ topic: `p/gateway/${gateway}/robots/${id}`, payload: '', encoding: 'text', at: Date.now() });
const talk = (model, id) => model.take({ topic: `p/robot/${id}/update`, payload: '0a00ecff', encoding: 'hex', at: Date.now() });

test('leaves the page when its last gateway has withdrawn it', () => {
  const model = modelWith('a', 'b', 'c');
  meet(model, 'b', 'h');
  const { roster } = model;
  withdraw(model, 'b');
  assert.ok(model.robots.has('b'), 'another gateway knows it');
  withdraw(model, 'b', 'h');
  assert.deepEqual([...model.robots.keys()], ['a', 'c']);
  assert.notEqual(model.roster, roster);
});

test('comes back with its next message, and no two robots have one colour', () => {
  const model = modelWith('a', 'b', 'c');
  for (const id of ['a', 'b']) withdraw(model, id);
  for (const id of ['d', 'b', 'e']) talk(model, id);
  assert.equal(model.robots.get('b').state, 'unknown');
  assert.deepEqual([...model.robots.values()].map(({ number }) => number).sort(), [0, 1, 2, 3]);
});

test('ends the commands that this page has sent it', () => {
  const model = modelWith('a');
  const ends = [];
  model.onOutcome = (robot, command) => ends.push([robot.id, command.outcome, command.why]);
  model.expect(model.robots.get('a'), { type: 'run', payload: 'stop', encoding: 'text', words: 'stop' });
  withdraw(model, 'a');
  assert.deepEqual(ends, [['a', 'no outcome', 'it was forgotten']]);
});

test('leaves room on a full page, and is not confused with a later robot of its name', () => {
  const model = modelWith(...Array.from({ length: MAX_ROBOTS }, (_, i) => `r${i}`));
  talk(model, 'x'); // replaces the robot that was silent longest
  const [replaced] = model.leftOut.keys();
  const next = model.quiet.at(-1)[0].id;
  withdraw(model, next);
  talk(model, next);
  const again = model.robots.get(next);
  talk(model, 'y');
  assert.equal(model.robots.get(next), again);
  assert.ok(model.robots.size <= MAX_ROBOTS);
  assert.deepEqual([...model.leftOut.keys()], [replaced, 'y']);
  withdraw(model, replaced);
  assert.deepEqual([...model.leftOut.keys()], ['y']);
});
