// SPDX-License-Identifier: Apache-2.0
// Functions that make and change elements. Text is never parsed as HTML, and characters that deceive are escaped.
import { shown } from './shown.js';

export const $ = (id) => document.getElementById(id);

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) if (value !== null) made.setAttribute(key, value);
  made.append(...children.map(shown));
  return made;
}
export function svg(name, attributes = {}, ...children) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children.map(shown));
  return made;
}
export function setText(node, text) {
  const safe = shown(text);
  if (node.textContent !== safe) node.textContent = safe;
}
// Gives `parent` exactly `count` children; keeps those that exist.
export function keep(parent, count, make) {
  while (parent.children.length < count) parent.append(make());
  while (parent.children.length > count) parent.lastElementChild.remove();
}

// Runs all parts, even when one of them fails.
export function attempt(...parts) {
  for (const part of parts) {
    try {
      part();
    } catch (error) {
      console.error(error);
    }
  }
}

export function save(name, blob) {
  const url = URL.createObjectURL(blob);
  element('a', { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}
// Returns a field of CSV; text that a spreadsheet would take for a formula gets an apostrophe in front.
export function csv(value) {
  const text = String(value);
  const safe = shown(typeof value === 'string' && /^'*[=+\-@\t\r]/.test(text) ? `'${text}` : text);
  return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}
export const stamp = () => new Date().toISOString().slice(0, 19).replace(/[:T]/g, '-');

let timer = 0;
export function toast(text) {
  setText($('toast'), text);
  $('toast').classList.add('on');
  clearTimeout(timer);
  timer = setTimeout(() => $('toast').classList.remove('on'), 4000);
}

// Returns the canvas, cleared and ready to draw on in CSS pixels, or null when it has no size.
export function surface(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width || !height) return null;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext('2d');
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
