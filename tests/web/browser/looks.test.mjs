// SPDX-License-Identifier: Apache-2.0
// How the page looks on each screen, in light and dark: no text is cut, none lies on another, nothing sticks out at the side.
// Measured in the DOM; the pictures are for people. With 6, 50 and 300 robots no two names of the map overlap.
import assert from 'node:assert/strict';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { World, eventually, keepDirectory } from './world.mjs';

const isShort = Boolean(process.env.SLAMGW_SHORT);
const SIZES = [[320, 568], [360, 640], [390, 844], [820, 1180], [1280, 800], [1920, 1080]];
const VIEWS = ['map', 'robots', 'trace', '/robot/robot5'];
const LONG = 'a-robot-with-a-rather-long-name-of-the-second-floor';
let world;
before(async () => {
  world = await World.start();
  await world.publish(`ntnu-slam/gateway/the-gateway-of-the-second-floor/robots/${LONG}`, '{"state":"online","mesh":"thread","address":"[fd12:3456:789a:1:c0de:5a1a:1234:5678]:47193"}', '-r');
  await world.publish(`ntnu-slam/gateway/the-gateway-of-the-second-floor/state`, '{"state":"offline"}', '-r'); // the longest words at the top
  await world.publish(`ntnu-slam/gateway/${'gateway'.repeat(43)}/state`, '{"state":"offline"}', '-r');
});
after(() => world?.stop());

// Runs in the page: what is wrong with its texts.
function measure() {
  const wrong = [];
  const boxes = [];
  const scrolls = (node) => ['auto', 'scroll'].includes(getComputedStyle(node).overflowX);
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text = walker.nextNode(); text; text = walker.nextNode()) {
    const parent = text.parentElement;
    if (!text.data.trim() || parent.closest('script, noscript, option, title, dialog:not([open])') || !parent.checkVisibility({ opacityProperty: true, visibilityProperty: true })) continue;
    const range = document.createRange();
    range.selectNodeContents(text);
    for (const rect of range.getClientRects()) {
      if (rect.width < 1 || rect.height < 1) continue;
      let box = { left: rect.left, right: rect.right, top: rect.top, bottom: rect.bottom };
      for (let node = parent; node && box; node = node.parentElement) {
        const style = getComputedStyle(node);
        if (style.overflowX === 'visible') continue;
        const edge = node.getBoundingClientRect();
        if (!scrolls(node) && box.right > edge.right + 1) wrong.push(`cut: ${text.data} in ${node.id || node.tagName}`);
        if (node.id !== 'list' && scrolls(node) && box.right > edge.right + 1) wrong.push(`out of sight: ${text.data} in ${node.id || node.className || node.tagName}`);
        box = { left: Math.max(box.left, edge.left), right: Math.min(box.right, edge.right), top: Math.max(box.top, edge.top), bottom: Math.min(box.bottom, edge.bottom) };
        if (box.right - box.left < 1 || box.bottom - box.top < 1) box = null;
      }
      if (!box) continue;
      if (box.right > innerWidth + 1) wrong.push(`beyond the screen: ${text.data}`);
      boxes.push({ ...box, words: text.data.trim(), parent });
    }
  }
  const isUnder = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 2 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 3;
  boxes.sort((a, b) => a.top - b.top);
  boxes.forEach((a, i) => {
    for (let j = i + 1; j < boxes.length && boxes[j].top < a.bottom; j++)
      if (a.parent !== boxes[j].parent && isUnder(a, boxes[j])) wrong.push(`overlap: ${a.words} and ${boxes[j].words}`);
  });
  const panels = ['side', 'tools', 'zoom', 'timebar'].map((id) => [id, document.getElementById(id).getBoundingClientRect()]).filter(([, rect]) => rect.width);
  panels.forEach(([name, a], i) => panels.slice(i + 1).forEach(([other, b]) => isUnder(a, b) && wrong.push(`panels overlap: ${name} and ${other}`)));
  if (document.documentElement.scrollWidth > innerWidth) wrong.push('the page is wider than the screen');
  return [...new Set(wrong)];
}

// ---- many robots

// Names and numbers as the canvas gets them, of one frame.
const drawnTexts = (page) => page.evaluate(() => {
  const texts = [];
  const { fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillText = function note(text, x, y) {
    if (this.canvas.id === 'world') texts.push({ text, left: x, right: x + this.measureText(text).width, top: y - 6, bottom: y + 6 });
  };
  window.slamgw.map.draw();
  CanvasRenderingContext2D.prototype.fillText = fillText;
  const wrong = [];
  texts.forEach((a, i) => texts.slice(i + 1).forEach((b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom && wrong.push(`${a.text} and ${b.text}`)));
  return { texts: texts.map(({ text }) => text), wrong };
});

for (const robots of [6, 50, 300]) {
  test(`no two names overlap on the map of ${robots} robots, near or far`, { skip: isShort && robots < 300 }, async () => {
    const crowd = `crowd${robots}-`;
    const page = await world.open();
    const places = Array.from({ length: robots }, (_, i) => [`${crowd}${i}`, Math.round(300 * Math.sin(i * 2.4) * Math.sqrt(i / robots)), Math.round(300 * Math.cos(i * 2.4) * Math.sqrt(i / robots))]);
    await world.publishMany(places.map(([name, x, y]) => [`ntnu-slam/robot/${name}/update`, World.positions(x, y, x + 20, y + 30)]));
    await page.waitForFunction(([name, count]) => [...window.slamgw.model.robots.values()].filter((robot) => robot.id.startsWith(name) && robot.pose).length === count, [crowd, robots]);
    if (await page.isVisible('#find')) await page.fill('#find', crowd);
    else await page.evaluate((name) => { window.slamgw.map.wanted = name; }, crowd);
    const seen = async () => {
      const { texts, wrong } = await drawnTexts(page);
      assert.deepEqual(wrong, []);
      const { clusters, single } = await page.evaluate(() => ({ clusters: window.slamgw.map.clusters.map(({ all }) => all.length), single: window.slamgw.map.single.length }));
      assert.equal(clusters.reduce((a, b) => a + b, 0) + single, robots, 'each robot is in a cluster or a dot');
      return { names: texts.filter((text) => text.startsWith(crowd)).length, clusters };
    };
    await page.evaluate(() => { window.slamgw.map.fitAll(); window.slamgw.map.fit(true); });
    const far = await seen();
    await page.screenshot({ path: join(keepDirectory, `many-${robots}.png`) });
    await page.evaluate(() => window.slamgw.map.zoom(3));
    const near = await seen();
    await page.screenshot({ path: join(keepDirectory, `many-${robots}-near.png`) });
    if (robots === 6) assert.deepEqual([far.names, far.clusters.length], [6, 0]);
    if (robots === 300) assert.ok(far.clusters.length > 5 && near.clusters.length < far.clusters.length && near.names > 10, JSON.stringify([far, near]));
    if (robots > 6) {
      await page.fill('#find', `${crowd}7`);
      await eventually('the list and the map show those alone', async () => {
        const listed = await page.$$eval('#list .name', (all) => all.map((one) => one.textContent));
        const drawn = await page.evaluate(() => window.slamgw.map.robots.map((robot) => robot.id));
        return listed.length > 0 && listed.every((name) => name.startsWith(`${crowd}7`)) && drawn.length === listed.length;
      });
    }
    await page.click('#tab-robots');
    await page.waitForTimeout(700);
    assert.deepEqual(page.errors, []);
    await page.context().close();
  });
}

test('of 300 robots of one mesh, those with a problem come first; a field finds each', { skip: isShort }, async () => {
  const presence = (i) => [`ntnu-slam/gateway/crowded/robots/m${i}`, JSON.stringify({ state: i === 77 ? 'offline' : 'online', mesh: 'ble', address: `0x${(0x200 + i).toString(16)}`, rssi_dbm: -50 - i % 40, ttl: 3, ...(i % 3 ? { hops: i % 3 - 1 } : {}) })];
  await world.publishMany([['ntnu-slam/gateway/crowded/state', '{"state":"online"}'], ['ntnu-slam/gateway/crowded/stats', '{"meshes":{"ble":{"state":"up"}}}'], ...Array.from({ length: 300 }, (_, i) => presence(i))]);
  const page = await world.open({ view: 'robots' });
  await page.waitForFunction(() => /299 online, 1 offline|1 offline, 299 online/.test(document.querySelector('#picture').textContent));
  const words = await page.textContent('#picture');
  assert.match(words, /100 way not known/);
  assert.match(words, /100 1 relay|100 direct/);
  assert.match(words, /260 more, which do better/);
  assert.equal(await page.locator('#picture > .card', { hasText: 'crowded' }).locator('.name').first().textContent(), 'm77');
  await page.screenshot({ path: join(keepDirectory, 'many-meshes.png') });
  await page.fill('#find-robots', 'm123');
  await page.waitForFunction(() => document.querySelectorAll('#picture li').length === 1);
  assert.match(await page.textContent('#picture li'), /m123-53 dBm · way not known · TTL 3/);
  await world.publishMany([...Array.from({ length: 300 }, (_, i) => [presence(i)[0], '']), ['ntnu-slam/gateway/crowded/stats', ''], ['ntnu-slam/gateway/crowded/state', '']]);
  await page.context().close();
});

// ---- every screen

for (const [width, height] of SIZES) {
  for (const colorScheme of ['light', 'dark']) {
    test(`texts are whole and apart at ${width} pixels, ${colorScheme}`, { skip: isShort }, async () => {
      const page = await world.open({ width, height, colorScheme, hasTouch: width < 1000, unlocked: true });
      await page.waitForFunction(() => [...window.slamgw.model.robots.values()].filter((robot) => robot.pose && robot.state === 'online').length >= 6);
      await page.waitForFunction((name) => window.slamgw.model.robots.has(name), LONG);
      await world.update(LONG, 60, 60, 70, 70);
      const found = [];
      for (const view of VIEWS) {
        await page.evaluate((name) => { location.hash = `#${name}`; }, view);
        if (view === 'map') await page.evaluate(() => document.querySelector('#list button').click());
        await page.waitForTimeout(1200); // two rounds of the tables
        await page.screenshot({ path: join(keepDirectory, `${width}-${colorScheme}-${view.replace('/robot/', 'one-')}.png`) });
        for (const each of await page.evaluate(measure)) found.push(`${view}: ${each}`);
      }
      assert.deepEqual(found, []);
      assert.deepEqual(page.errors, []);
      await page.context().close();
    });
  }
}
