// SPDX-License-Identifier: Apache-2.0
// Contrast as WCAG 2.2 computes it: 4.5 for text, 3 for graphics, in both themes; robots' colours on all that the map has below them.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { test } from 'node:test';
import { colourOf } from '../../web/page/model.js';

const css = readFileSync(new URL('../../web/page/style.css', import.meta.url), 'utf8');
const themes = Object.fromEntries([['light', ':root {'], ['dark', ':root[data-theme="dark"] {']].map(([name, start]) => {
  const block = css.slice(css.indexOf(start)).split('}')[0];
  return [name, Object.fromEntries([...block.matchAll(/--(\w[\w-]*): (#\w+)/g)].map(([, key, value]) => [key, rgb(value)]))];
}));
function rgb(hex) {
  const digits = hex.length === 4 ? [...hex.slice(1)].map((c) => c + c).join('') : hex.slice(1, 7);
  return digits.match(/../g).map((part) => parseInt(part, 16));
}
const luminance = (colour) => {
  const [r, g, b] = colour.map((value) => (value / 255 <= 0.04045 ? value / 255 / 12.92 : ((value / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const contrast = (a, b) => {
  const [high, low] = [luminance(a), luminance(b)].sort((x, y) => y - x);
  return (high + 0.05) / (low + 0.05);
};

for (const [name, theme] of Object.entries(themes)) {
  test(`texts differ from what is below them by 4.5, ${name}`, () => {
    for (const text of ['text', 'muted', 'accent', 'good', 'warn', 'bad']) {
      for (const ground of ['card', 'ground', 'soft']) {
        const value = contrast(theme[text], theme[ground]);
        assert.ok(value >= 4.5, `--${text} on --${ground}: ${value.toFixed(2)}`);
      }
    }
    for (const [text, ground] of [['on-accent', 'accent'], ['card', 'bad'], ['card', 'warn'], ['ground', 'text']]) {
      const value = contrast(theme[text], theme[ground]);
      assert.ok(value >= 4.5, `--${text} on --${ground}: ${value.toFixed(2)}`);
    }
  });

  test(`the colours of 1000 robots differ from the map by 3, ${name}`, () => {
    for (let number = 0; number < 1000; number++) {
      for (const ground of ['ground', 'free', 'card']) {
        const value = contrast(colourOf(number), theme[ground]);
        assert.ok(value >= 3, `robot ${number} rgb(${colourOf(number)}) on --${ground}: ${value.toFixed(2)}`);
      }
    }
  });
}
