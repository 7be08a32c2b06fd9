// SPDX-License-Identifier: Apache-2.0
// An outcome names robot and type only. The page assigns it to its command, from any sender.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Model } from '../../web/page/model.js';

const BEGIN = 1800000000000;

// A page with one robot, `r`. Times are milliseconds after the beginning.
class Page {
  constructor() {
    this.model = new Model();
    this.model.now = () => this.at + BEGIN;
    this.at = 0;
    this.ended = []; // the outcomes of this page's own commands
    this.model.onOutcome = (robot, command) => this.ended.push([command.words, command.outcome]);
    this.model.takeOwn('hello', { prefix: 'p', origins: {}, gateway: 'g' });
    this.take('gateway/g/state', { state: 'online' }, 'json');
    this.take('robot/r/update', '0a00ecff', 'hex');
  }
  take(topic, payload, encoding) {
    this.model.take({ topic: `p/${topic}`, payload, encoding, at: BEGIN + this.at });
  }
  // A command as it comes from the broker, from any sender.
  hear(payload, at = this.at) {
    this.at = at;
    this.take('server/r/cmd', payload, 'hex');
  }
  click(payload, at = this.at) {
    this.at = at;
    const command = { type: 'cmd', payload, encoding: 'hex', words: payload };
    this.model.expect(this.model.robots.get('r'), command);
    return command;
  }
  end(outcome, at = this.at) {
    this.at = at;
    this.take('gateway/g/commands/r', { type: 'cmd', outcome, after_ms: 4, why: '' }, 'json');
  }
  get outcomes() {
    return this.model.robots.get('r').commands.map(({ outcome }) => outcome);
  }
}

test('a command that was lost does not take the outcome of a later one', () => {
  const page = new Page();
  page.hear('01000100', 0);
  page.hear('02000200', 40000);
  page.end('delivered', 40004);
  page.hear('03000300', 41000);
  page.end('timeout', 70000);
  page.model.expire();
  assert.deepEqual(page.outcomes, ['no outcome', 'delivered', 'timeout']);
  assert.deepEqual(page.ended, []);
});

test("an outcome of another sender's command does not end this page's", () => {
  const page = new Page();
  page.hear('0a000a00');
  const mine = page.click('63006300');
  page.end('superseded'); // before the broker has passed the page's own command on
  assert.equal(mine.outcome, undefined);
  page.hear('63006300', 10);
  page.end('delivered', 20);
  assert.deepEqual(page.ended, [['63006300', 'delivered']]);
  assert.deepEqual(page.outcomes, ['superseded', 'delivered']);
});

test('outcomes follow the order in which the broker passes commands on', () => {
  const page = new Page();
  page.click('63006300', 0);
  page.hear('0a000a00', 5);
  page.hear('63006300', 6);
  page.end('superseded', 8);
  page.end('delivered', 9);
  assert.deepEqual(page.ended, [['63006300', 'delivered']]);
});

test("a command of this page whose outcome is lost ends without one", () => {
  const page = new Page();
  const lost = page.click('01000100', 0);
  page.hear('01000100', 10);
  page.click('02000200', 36000);
  page.hear('02000200', 36010);
  page.end('delivered', 36020);
  assert.deepEqual(page.ended, [['02000200', 'delivered']]);
  page.model.expire();
  assert.equal(lost.outcome, 'no outcome');
  assert.equal(page.ended.length, 2);
});

test('a page with read access to outcomes alone matches them with its own commands', () => {
  const page = new Page();
  page.click('01000100', 0);
  page.end('delivered', 9);
  assert.deepEqual(page.ended, [['01000100', 'delivered']]);
});

test('a refusal ends a command that the broker has not passed on', () => {
  const page = new Page();
  page.click('01000100', 0);
  page.hear('01000100', 5);
  page.click('02000200', 6);
  page.model.takeOwn('refused', { topic: 'p/server/r/cmd', why: 'no' });
  page.end('delivered', 9);
  assert.deepEqual(page.ended, [['02000200', 'refused'], ['01000100', 'delivered']]);
});

test('each of many commands at once has its own outcome, and the list stays bounded', () => {
  const page = new Page();
  const all = Array.from({ length: 40 }, (_, i) => page.click(`0000${String(i).padStart(4, '0')}`));
  for (const { payload } of all) page.hear(payload);
  all.forEach((_, i) => page.end(i % 2 ? 'delivered' : 'superseded'));
  assert.deepEqual(all.map(({ outcome }) => outcome), all.map((_, i) => (i % 2 ? 'delivered' : 'superseded')));
  for (let i = 0; i < 1000; i++) page.hear('00000000');
  assert.ok(page.outcomes.length < 300, String(page.outcomes.length));
  page.at += 36000;
  page.model.expire();
  page.hear('00000000');
  assert.equal(page.outcomes.length, 20);
});

test('past commands stand before live commands', () => {
  const page = new Page();
  page.model.liveFrom = Infinity; // as on a page that reconnects
  page.hear('02000200', 60000);
  const event = (topic, payload, encoding, at) => ({ topic: `p/${topic}`, payload, encoding, at: BEGIN + at });
  page.model.takeOwn('past', { events: [event('server/r/cmd', '01000100', 'hex', 50000), event('gateway/g/commands/r', { type: 'cmd', outcome: 'timeout' }, 'json', 59000)] });
  page.end('delivered', 60004);
  assert.deepEqual(page.outcomes, ['timeout', 'delivered']);
});
