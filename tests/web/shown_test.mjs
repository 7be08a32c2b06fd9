// SPDX-License-Identifier: Apache-2.0
// Names on the page and in its CSV: the same cases as of the daemon's escape_unprintable, and formulas.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { test } from 'node:test';
import { csv } from '../../web/page/dom.js';
import { Model } from '../../web/page/model.js';
import { problems } from '../../web/page/robots.js';
import { shown } from '../../web/page/shown.js';

test('escapes hidden and deceptive characters', () => {
  const cases = JSON.parse(readFileSync(new URL('../vectors/shown.json', import.meta.url)));
  for (const [text, wanted] of cases) assert.equal(shown(text), wanted);
  assert.equal(shown('a\u001b[2J\u009b'), 'a\\u001b[2J\\u009b');
  assert.equal(shown('shown twice: ' + shown('r\u043ebot')), 'shown twice: r\\u043ebot');
});

test('guards the cells of CSV', () => {
  for (const formula of ['=1+1', '+1', '-1', '@SUM(A1)', '\t=1', '\r=1']) assert.match(csv(formula), /^"?'/);
  assert.equal(csv(-1.5), '-1.5');
  assert.equal(csv('a,"b"'), '"a,""b"""');
  assert.equal(csv('r\u043ebot'), 'r\\u043ebot');
});

test('quotes a name in a command that a problem shows, or shows no command', () => {
  const remedy = (id) => {
    const model = new Model();
    Object.assign(model, { isOpen: true, broker: { state: 'up' } });
    model.takeOwn(`robot/${id}`, { state: 'offline', since: 1, heard: 0, gateway: 'g' });
    return problems(model).find(({ title }) => title === `${id} is offline`).remedy;
  };
  assert.match(remedy('robot1'), / slam-gatewayctl doctor robot1$/);
  assert.match(remedy('x;touch pwn'), / slam-gatewayctl doctor 'x;touch pwn'$/);
  assert.match(remedy("$(a)'b"), / slam-gatewayctl doctor '\$\(a\)'\\''b'$/);
  for (const name of ['--socket=x', 'r\u043ebot', 'a\nb']) assert.doesNotMatch(remedy(name), /slam-gatewayctl/);
});
