// SPDX-License-Identifier: Apache-2.0
// slam-gateway-web and its page, as people meet them. Each test opens a page of its own; those that break the world come
// last and mend it. SLAMGW_SHORT: only those whose name begins with "*".
import assert from 'node:assert/strict';
import { execFile } from 'node:child_process';
import http from 'node:http';
import net from 'node:net';
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test as each } from 'node:test';
import { PATIENCE_MS, World, eventually, keepDirectory, token } from './world.mjs';

let world;
const isShort = Boolean(process.env.SLAMGW_SHORT);
function test(name, body) {
  each(name, { skip: isShort && !name.startsWith('*'), timeout: 10 * PATIENCE_MS }, body);
}
// Opens a page for the test, looks at its errors at the end, and closes it.
function pageTest(name, options, body) {
  test(name, async () => {
    const page = await world.open(typeof options === 'function' ? options() : options);
    try {
      await body(page);
      assert.deepEqual(page.errors, []);
    } finally {
      await page.context().close();
    }
  });
}
const until = (page, what, ...more) => page.waitForFunction(what, ...more);
const shot = (page, name) => page.screenshot({ path: join(keepDirectory, name) });
const hostile = '<img src=x onerror=alert(1)>';

before(async () => {
  world = await World.start({ origins: { placed: { x_cm: 400, y_cm: 100, heading_deg: 90 } } });
});
after(() => world?.stop());

// Least squares (Kasa): the circle through points.
function fitCircle(points) {
  let [n, sx, sy, sxx, syy, sxy, sxz, syz, sz] = [points.length, 0, 0, 0, 0, 0, 0, 0, 0];
  for (const [x, y] of points) {
    const z = x * x + y * y;
    sx += x; sy += y; sxx += x * x; syy += y * y; sxy += x * y; sxz += x * z; syz += y * z; sz += z;
  }
  const a = n * sxx - sx * sx, b = n * sxy - sx * sy, c = n * syy - sy * sy;
  const d = (n * sxz - sx * sz) / 2, e = (n * syz - sy * sz) / 2;
  const x = (d * c - b * e) / (a * c - b * b), y = (a * e - b * d) / (a * c - b * b);
  return { x, y, radius: Math.sqrt(x * x + y * y + (sz - 2 * x * sx - 2 * y * sy) / n) };
}
function assertRing(points) {
  const circle = fitCircle(points);
  assert.ok(Math.abs(circle.radius - 80) <= 2, JSON.stringify(circle));
  assert.ok(Math.hypot(circle.x, circle.y) <= 2, JSON.stringify(circle));
}
const ringPoints = (page) => page.evaluate(() => {
  const points = [];
  for (const robot of window.slamgw.model.robots.values()) {
    if (!/^robot\d$/.test(robot.id)) continue;
    for (let i = 0; i < robot.kept; i++) points.push([robot.points[i * 3], robot.points[i * 3 + 1]]);
  }
  return points;
});
async function manyPoints(page) {
  return eventually('400 points', async () => {
    const points = await ringPoints(page);
    return points.length >= 400 && points;
  });
}

// ---- the map

pageTest('* documents of wrong types and invented gateways hide nothing', {}, async (page) => {
  await until(page, () => document.querySelectorAll('#list li').length >= 6);
  const bad = ['{"broker":{"state":{"toString":1}}}', '{"state":{"toString":1}}', '{"state":"online","mesh":{"toString":1}}', '{"meshes":{"ble":{"state":{}}}}', '7', '[]', '{"store":{"dead_letters":{"valueOf":1}}}'];
  const made = [];
  for (const [i, document] of bad.entries()) for (const what of ['state', 'stats', 'numbers', `robots/bad${i}`]) made.push([`ntnu-slam/gateway/bad${i}/${what}`, document]);
  for (let i = 0; i < 120; i++) made.push([`ntnu-slam/gateway/invented${i}/state`, '{"state":"online"}']);
  await world.publishMany(made);
  await page.click('#tab-robots');
  await until(page, () => window.slamgw.model.gatewaysLeftOut);
  await until(page, () => document.querySelector('#gateways tbody tr').cells[0].textContent === window.slamgw.model.own);
  assert.equal(await page.$eval('#gateways tbody tr', (row) => row.cells[1].textContent), 'online');
  assert.match(await page.textContent('#problems'), /More gateways are not shown/);
  await page.reload();
  await until(page, () => window.slamgw.model.gateways.has(window.slamgw.model.own));
  await world.publishMany(made.map(([topic]) => [topic, ""]));
});

pageTest('* the page is live without an error and shows the robots of both meshes', {}, async (page) => {
  await until(page, () => document.querySelector('#link').textContent === 'Live');
  await until(page, () => document.querySelectorAll('#list li').length >= 6);
  const names = await page.$$eval('#list .name', (all) => all.map((one) => one.textContent));
  for (let i = 1; i <= 6; i++) assert.ok(names.includes(`robot${i}`), names.join());
  await until(page, () => document.querySelector('#empty').hidden); // as soon as a robot has said where it is
});

pageTest('* points lie where the ring is: 80 cm within 2 cm', {}, async (page) => {
  assertRing(await manyPoints(page));
  await eventually('most of the ring is seen', async () => {
    const points = await ringPoints(page);
    return new Set(points.map(([x, y]) => Math.floor(Math.atan2(y, x) * 6))).size >= 34;
  });
  await shot(page, 'map.png');
});

pageTest('the occupied cells of the grid are the ring, those inside are free', {}, async (page) => {
  await manyPoints(page);
  const cells = await page.evaluate(() => {
    const found = { walls: [], freeInside: 0, freeOutside: 0 };
    for (const tile of window.slamgw.map.grid.tiles.values()) {
      tile.cells.forEach((value, i) => {
        const x = (tile.column * 64 + i % 64) * 2 + 1;
        const y = (tile.row * 64 + Math.floor(i / 64)) * 2 + 1;
        if (Math.hypot(x, y) > 120) return;
        if (value > 20) found.walls.push([x, y]);
        if (value < 0) found[Math.hypot(x, y) < 84 ? 'freeInside' : 'freeOutside']++;
      });
    }
    return found;
  });
  assert.ok(cells.walls.length >= 40, String(cells.walls.length));
  assertRing(cells.walls);
  assert.ok(cells.freeInside > 500 && cells.freeOutside === 0, JSON.stringify([cells.freeInside, cells.freeOutside]));
});

pageTest('* a page that reloads or opens later shows the same as the first', { unlocked: true }, async (page) => {
  await manyPoints(page);
  await choose(page, 'robot1');
  await page.click('#stop');
  await outcome(page, 'stop: delivered');
  await page.click('#start');
  await outcome(page, 'start: delivered');
  const seen = (of) => of.evaluate(() => {
    const { model, map } = window.slamgw;
    const robots = [...model.robots.values()].filter(({ id }) => /^robot\d$/.test(id));
    const walls = [...map.grid.tiles.values()].reduce((sum, tile) => sum + tile.cells.filter((value) => value > 0).length, 0);
    return { points: robots.reduce((sum, robot) => sum + robot.kept, 0), trail: robots.reduce((sum, robot) => sum + robot.trail.length, 0), walls, commands: model.robots.get('robot1').commands.map(({ text, outcome: end }) => `${text}: ${end}`) };
  });
  const before = await seen(page);
  const later = await world.open();
  await page.reload();
  for (const each of [page, later]) {
    await until(each, (points) => [...window.slamgw.model.robots.values()].reduce((sum, robot) => sum + robot.kept, 0) >= points, before.points);
    const after = await seen(each);
    assert.ok(after.trail >= before.trail && after.walls >= before.walls * 0.95, JSON.stringify([before, after]));
    assert.deepEqual(after.commands.slice(-2), ['run: stop: delivered', 'run: start: delivered']);
    // An update has four obstacles; two or three may come at once where the page had to wait.
    const doubled = await each.evaluate(() => [...window.slamgw.model.robots.values()].some((robot) => {
      const counts = new Map();
      for (const at of robot.times?.slice(0, robot.kept) ?? []) counts.set(at, (counts.get(at) ?? 0) + 1);
      return counts.size > 4 && [...counts.values()].filter((count) => count >= 8).length > counts.size / 2;
    }));
    assert.equal(doubled, false);
  }
  await later.context().close();
});

pageTest('the slider shows where robots were, and plays up to now', {}, async (page) => {
  await manyPoints(page);
  await until(page, () => document.querySelector('#timebar').checkVisibility());
  await page.focus('#time');
  await page.keyboard.press('Home');
  await until(page, () => window.slamgw.map.isPast && /ago$/.test(document.querySelector('#live').textContent));
  const then = await page.evaluate(() => {
    const { map, model } = window.slamgw;
    const robot = model.robots.get('robot1');
    return { shown: map.poseOf(robot), first: robot.track[0], late: robot.placeAt(Date.now() + 1e6), now: robot.pose, early: robot.placeAt(0) };
  });
  assert.equal(then.early, null);
  assert.deepEqual([then.late.x, then.late.y], [then.now.x, then.now.y]);
  assert.ok(then.shown === null || then.shown.at - then.first.at < 2000, JSON.stringify(then));
  await shot(page, 'past.png');
  await page.evaluate(() => window.slamgw.map.goTo(Date.now() - 3000)); // nearly now, so that it soon ends
  await page.click('#play');
  await until(page, () => !window.slamgw.map.isPast && document.querySelector('#live').textContent === 'now' && document.querySelector('#play').textContent === '▶');
});

pageTest('pixels in the robots’ colours are where the points are', {}, async (page) => {
  await manyPoints(page);
  await page.click('#show-grid');
  await page.click('#show-trails');
  await page.click('#show-labels');
  const drawn = await page.evaluate(async () => {
    const { map, model } = window.slamgw;
    for (const robot of model.robots.values()) robot.isShown = robot.id === 'robot1';
    map.fitAll();
    await new Promise((resolve) => setTimeout(resolve, 1200)); // the view comes to rest
    const robot = model.robots.get('robot1');
    const before = robot.kept;
    map.draw();
    let hits = 0;
    const context = map.canvas.getContext('2d');
    for (let i = 0; i < before; i++) {
      const at = context.getImageData(map.view.px(robot.points[i * 3]) * map.ratio, map.view.py(robot.points[i * 3 + 1]) * map.ratio, 1, 1).data;
      if (at[2] > at[0] + 10) hits++; // blue on grey, strong or faint
    }
    return { hits, before };
  });
  assert.ok(drawn.before > 20 && drawn.hits > 0.9 * drawn.before, JSON.stringify(drawn));
});

pageTest('an origin places a robot’s frame in the room, turned', {}, async (page) => {
  await world.update('placed', 10, 0, 10, 50);
  await until(page, () => window.slamgw.model.robots.get('placed')?.pose);
  const placed = await page.evaluate(() => {
    const robot = window.slamgw.model.robots.get('placed');
    return [robot.pose.x, robot.pose.y, robot.points[0], robot.points[1], robot.fromRoom(350, 110)];
  });
  assert.deepEqual(placed.slice(0, 4).map(Math.round), [400, 110, 350, 110]);
  assert.deepEqual(placed[4], { x: 10, y: 50 });
});

pageTest('a ray is free up to its end, and readings near 80 cm count less', {}, async (page) => {
  await world.update('lonely', 1000, 1000, 1050, 1000, 1000, 1079);
  await until(page, () => window.slamgw.model.robots.get('lonely')?.kept === 2);
  const seen = await page.evaluate(() => {
    const { grid } = window.slamgw.map;
    const cell = (x, y) => grid.tile(x >> 7, y >> 7).cells[((y >> 1) & 63) * 64 + ((x >> 1) & 63)];
    const { points } = window.slamgw.model.robots.get('lonely');
    return { free: [1002, 1020, 1048].map((x) => cell(x, 1000)), near: cell(1050, 1000), far: cell(1000, 1079), worth: [points[2], points[5]] };
  });
  assert.ok(seen.free.every((value) => value < 0), JSON.stringify(seen));
  assert.ok(seen.near > seen.far && seen.far > 0, JSON.stringify(seen));
  assert.ok(seen.worth[0] === 1 && seen.worth[1] < 0.3, JSON.stringify(seen));
});

pageTest('wheel and drag move the map, F brings it back', {}, async (page) => {
  await manyPoints(page);
  const under = () => page.evaluate(() => ({ ...window.slamgw.map.view.room(700, 400), scale: window.slamgw.map.view.scale, fits: window.slamgw.map.fits }));
  const box = await page.locator('#world').boundingBox();
  const start = await under();
  await page.mouse.move(box.x + 700, box.y + 400);
  await page.mouse.wheel(0, -400);
  await eventually('closer', async () => (await under()).scale > start.scale * 1.3);
  const closer = await under();
  assert.equal(closer.fits, false);
  await page.mouse.down();
  await page.mouse.move(box.x + 800, box.y + 400, { steps: 4 });
  await page.mouse.up();
  const dragged = await under();
  assert.ok(Math.abs((closer.x - dragged.x) * closer.scale - 100) < 2, JSON.stringify([closer, dragged]));
  await page.keyboard.press('f');
  await eventually('fitted', async () => (await under()).fits);
});

pageTest('robots can be left out, found, and cleared', {}, async (page) => {
  await manyPoints(page);
  await page.click('#none');
  assert.equal(await page.evaluate(() => window.slamgw.map.robots.length), 0);
  await page.locator('#list li', { hasText: 'robot2' }).locator('input').check();
  assert.deepEqual(await page.evaluate(() => window.slamgw.map.robots.map((robot) => robot.id)), ['robot2']);
  const [before, left] = await page.evaluate(() => {
    const robots = [...window.slamgw.model.robots.values()];
    const count = () => robots.reduce((sum, robot) => sum + robot.kept + robot.trail.length, 0);
    const was = count();
    document.querySelector('#clear').click();
    return [was, count() + window.slamgw.map.grid.tiles.size];
  });
  assert.ok(before > 400 && left === 0, `${before} ${left}`);
});

async function downloaded(page, button) {
  const [download] = await Promise.all([page.waitForEvent('download'), page.click(button)]);
  return { name: download.suggestedFilename(), octets: readFileSync(await download.path()) };
}

pageTest('PNG and CSV save what is drawn; a name is no formula', {}, async (page) => {
  await world.update('=1-1', 5, 6, 40, 30);
  await until(page, () => window.slamgw.model.robots.get('=1-1')?.kept);
  await manyPoints(page);
  const png = await downloaded(page, '#save-png');
  assert.match(png.name, /^map-.*\.png$/);
  assert.equal(png.octets.subarray(1, 4).toString(), 'PNG');
  const lines = (await downloaded(page, '#save-csv')).octets.toString().split('\n');
  assert.equal(lines[0], 'robot,kind,x_cm,y_cm,worth,at');
  assert.ok(lines.length > 400);
  assert.ok(lines.some((line) => line.startsWith("'=1-1,obstacle,40.0,30.0,1.00,20")), lines.find((line) => line.includes('=1-')));
});

pageTest('ROS saves the grid as a picture and where it lies', {}, async (page) => {
  await world.update('ros-1', 5, 6, 40, 30);
  await until(page, () => window.slamgw.model.robots.get('ros-1')?.kept);
  const files = [];
  page.on('download', (download) => files.push(download));
  await page.click('#save-ros');
  for (let i = 0; i < 100 && files.length < 2; i++) await page.waitForTimeout(100);
  const [pgm, yaml] = await Promise.all(files.map(async (file) => readFileSync(await file.path())));
  assert.equal(pgm.subarray(0, 3).toString(), 'P5\n');
  assert.match(yaml.toString(), /^image: map-.*\.pgm\nresolution: 0\.02\norigin: /);
});

pageTest('* MCAP saves where the robots were and what they saw', {}, async (page) => {
  await until(page, () => window.slamgw.model.robots.get('robot1')?.kept);
  const { name, octets } = await downloaded(page, '#save-mcap'); // tests/web/mcap_test.mjs reads one
  assert.match(name, /^robots-.*\.mcap$/);
  assert.equal(octets.subarray(0, 8).toString('hex'), '894d434150300d0a');
  for (const topic of ['/robot1/pose', '/robot1/obstacles']) assert.ok(octets.includes(topic), topic);
});

// ---- commands

async function clickRoom(page, x, y) {
  const at = await page.evaluate(([a, b]) => {
    const { map } = window.slamgw;
    map.fits = false; // and near, so that no other robot is under the click
    Object.assign(map.view, { scale: 8, left: map.width / 2 - 8 * a, top: map.height / 2 + 8 * b });
    return [map.view.px(a), map.view.py(b)];
  }, [x, y]);
  const box = await page.locator('#world').boundingBox();
  await page.mouse.click(box.x + at[0], box.y + at[1]);
}
const choose = (page, name) => page.locator('#list li', { hasText: name }).locator('button').click();
const outcome = (page, words) => until(page, (text) => document.querySelector('#outcomes li')?.textContent.includes(text), words);

for (const [robot, mesh] of [['robot1', 'Thread'], ['robot5', 'BLE Mesh']]) {
  pageTest(`* a click on the map sends a robot on ${mesh} there, and its outcome is shown`, { unlocked: true }, async (page) => {
    await manyPoints(page);
    const sent = await world.subscribe(`ntnu-slam/server/${robot}/cmd`);
    await choose(page, robot);
    await clickRoom(page, -30, 25);
    await outcome(page, 'delivered');
    await eventually('the command', () => sent.lines.length > 0);
    sent.stop();
    const [, hex] = sent.lines[0].split(' ');
    const octets = Buffer.from(hex, 'hex');
    assert.ok(Math.abs(octets.readInt16LE(0) + 30) <= 1 && Math.abs(octets.readInt16LE(2) - 25) <= 1, hex);
    assert.equal(await page.evaluate(() => window.slamgw.map.marks[0].command.outcome), 'delivered');
    await shot(page, `command-${robot}.png`);
  });
}

pageTest('Stop and Start reach the robot as `run`', { unlocked: true }, async (page) => {
  const sent = await world.subscribe('ntnu-slam/server/robot4/run');
  await choose(page, 'robot4');
  await page.click('#stop');
  await outcome(page, 'stop: delivered');
  await page.click('#start');
  await outcome(page, 'start: delivered');
  await eventually('both commands', () => sent.lines.length >= 2);
  sent.stop();
  assert.deepEqual(sent.lines.map((line) => Buffer.from(line.split(' ')[1], 'hex').toString()), ['stop', 'start']);
});

pageTest('the page says that no gateway serves the chosen robot', { unlocked: true }, async (page) => {
  await world.update('ghost', 0, 0);
  await page.locator('#list li', { hasText: 'ghost' }).locator('button').click();
  await until(page, () => document.querySelector('#pilot-hint').textContent.startsWith('No gateway serves it'));
});

pageTest('without a token set the program publishes no command of a page', () => ({ url: world.watchingUrl }), async (page) => {
  await until(page, () => document.querySelector('#unlock').textContent === 'Only watching');
  assert.equal(await page.isDisabled('#unlock'), true);
  const sent = await world.subscribe('ntnu-slam/server/#');
  const refused = await page.evaluate(() => new Promise((resolve) => {
    const socket = new WebSocket(`ws://${location.host}/api`);
    socket.onopen = () => socket.send(JSON.stringify({ topic: 'ntnu-slam/server/robot1/run', payload: 'stop' }));
    socket.onmessage = ({ data }) => data.includes('$web/refused') && resolve(data);
  }));
  assert.match(refused, /only watches/);
  await world.publish('ntnu-slam/server/robot1/end', 'x'); // earlier messages have arrived
  await eventually('the end', () => sent.lines.some((line) => line.includes('/end')));
  sent.stop();
  assert.equal(sent.lines.length, 1);
});

pageTest('a wrong token is reported, and three end the connection', {}, async (page) => {
  await page.click('#unlock');
  await page.fill('#token', 'a-token-that-is-not-valid');
  await page.click('#token-form .main');
  await until(page, () => document.querySelector('#token-words').textContent === 'unknown token');
  assert.equal(await page.evaluate(() => window.slamgw.model.maySend), false);
  const code = await page.evaluate(() => new Promise((resolve) => {
    const socket = new WebSocket(`ws://${location.host}/api`);
    socket.onopen = () => { for (let i = 0; i < 5; i++) socket.send('{"topic":"$web/token","payload":"guess"}'); };
    socket.onclose = (event) => resolve(event.code);
  }));
  assert.ok(code >= 1000);
});

test('the token is in no URL, survives a reload, and stays in its tab', async () => {
  const page = await world.open();
  const urls = [];
  page.on('request', (request) => urls.push(request.url()));
  page.on('websocket', (socket) => urls.push(socket.url()));
  await world.unlock(page);
  await page.reload();
  await page.waitForFunction(() => window.slamgw?.model.maySend);
  assert.ok(urls.length > 5 && urls.every((url) => !url.includes(token) && !url.includes('?')), urls.join('\n'));
  const other = await page.context().newPage();
  await other.goto(world.url);
  await other.waitForFunction(() => window.slamgw?.model.isOpen);
  assert.equal(await other.evaluate(() => window.slamgw.model.maySend), false);
  await page.context().close();
});

// ---- who may come

const ask = (path, headers, method = 'GET') => new Promise((resolve, reject) => {
  http.request({ host: '127.0.0.1', port: world.ports.web, path, headers, method }, (response) => {
    let text = '';
    response.on('data', (part) => { text += part; }).on('end', () => resolve({ status: response.statusCode, headers: response.headers, text }));
  }).on('error', reject).end();
});

test('* a wrong Host is refused, for the page and for the metrics', async () => {
  for (const host of ['evil.test', `evil.test:${world.ports.web}`, `127.0.0.1.evil.test:${world.ports.web}`]) {
    assert.ok([400, 403].includes((await ask('/', { host })).status), host);
    assert.ok([400, 403].includes((await ask('/metrics', { host })).status), host);
  }
  assert.equal((await ask('/', { host: `localhost:${world.ports.web}` })).status, 200);
});

test('a page under a name that was rebound to this host sees nothing', async () => {
  const context = await world.browser.newContext();
  const page = await context.newPage();
  const response = await page.goto(`http://evil.test:${world.ports.web}/`);
  assert.equal(response.status(), 403);
  const isRefused = await page.evaluate(() => new Promise((resolve) => {
    const socket = new WebSocket(`ws://${location.host}/api`);
    socket.onopen = () => resolve(false);
    socket.onerror = () => resolve(true);
  }));
  assert.equal(isRefused, true);
  await context.close();
});

test('* a foreign page cannot open the WebSocket', async () => {
  const server = http.createServer((request, response) => response.end('<!doctype html><title>foreign</title>')).listen(0, '127.0.0.1');
  const context = await world.browser.newContext();
  const page = await context.newPage();
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  const opened = (port) => page.evaluate((to) => new Promise((resolve) => {
    const socket = new WebSocket(`ws://127.0.0.1:${to}/api`);
    socket.onopen = () => resolve(true);
    socket.onerror = () => resolve(false);
  }), port);
  assert.equal(await opened(world.ports.web), false);
  const read = await page.evaluate((to) => fetch(`http://127.0.0.1:${to}/metrics`).then(() => true, () => false), world.ports.web);
  assert.equal(read, false);
  await context.close();
  server.close();
});

test('answers confine the page, and only GET is answered', async () => {
  const { headers } = await ask('/', {});
  assert.match(headers['content-security-policy'], /default-src 'none'.*frame-ancestors 'none'.*require-trusted-types-for/);
  assert.equal(headers['x-content-type-options'], 'nosniff');
  assert.equal((await ask('/', {}, 'POST')).status, 405);
  assert.equal((await ask('/../../etc/passwd', {})).status, 404);
});

pageTest('a script that somehow got into the page does not run', {}, async (page) => {
  const ran = await page.evaluate(() => {
    const script = document.createElement('script');
    try { script.textContent = 'window.wasRun = true'; } catch { /* Trusted Types */ }
    document.body.append(script);
    try { document.body.innerHTML += '<b>markup</b>'; return true; } catch { return Boolean(window.wasRun); }
  });
  assert.equal(ran, false);
  page.errors.length = 0; // the browser reports what it refused
});

// ---- robots and gateways

pageTest('the table and the picture show which robot is on which gateway over which mesh', { view: 'robots' }, async (page) => {
  await until(page, () => [...document.querySelectorAll('#table tbody tr')].filter((row) => /^robot\d/.test(row.textContent) && row.textContent.includes('online')).length >= 6);
  const row = (name) => page.locator('#table tbody tr', { has: page.locator('td:first-child', { hasText: new RegExp(`^${name}$`) }) });
  assert.match(await row('robot1').textContent(), /online.*Thread.*here/);
  assert.match(await row('robot5').textContent(), /online.*BLE Mesh.*here/);
  await page.click('#table th:nth-child(3) button');
  const meshes = await page.$$eval('#table tbody td:nth-child(3)', (all) => all.map((cell) => cell.textContent));
  assert.deepEqual(meshes, [...meshes].sort((a, b) => a.localeCompare(b)));
  const picture = await page.textContent('#picture');
  for (const word of ['Broker', 'here', 'BLE Mesh', 'Thread', 'robot3', 'robot6']) assert.ok(picture.includes(word), picture);
  await until(page, () => /robot5-\d+ dBm · way not known · TTL \d/.test(document.querySelector('#picture').textContent));
  await until(page, () => /robot1[\d.]+ ms · .*?127\.0\.0\.1:\d+/.test(document.querySelector('#picture').textContent));
  await page.fill('#find-robots', 'thread');
  await until(page, () => document.querySelectorAll('#picture li').length === 3 && document.querySelectorAll('#table tbody tr').length === 3);
  await page.fill('#find-robots', '');
  await until(page, () => document.querySelector('#gateways tbody').textContent.includes('MiB'));
  await page.waitForTimeout(6000); // for sparklines that are worth a picture
  await shot(page, 'robots.png');
});

pageTest('* the picture shows the neighbours of a Thread border router, and its robots', { view: 'robots' }, async (page) => {
  const document = JSON.parse(readFileSync(new URL('../../vectors/thread_border_router.json', import.meta.url)));
  const at = 'ntnu-slam/gateway/pi/';
  await world.publish(at + 'state', '{"state":"online"}', '-r');
  await world.publish(at + 'robots/near', '{"state":"online","mesh":"thread","address":"[fe80::1322:3344:5566:7788%4]:47193"}', '-r');
  await world.publish(at + 'stats', '{"meshes":{"thread":{"state":"up","role":"router"}}}');
  for (let i = 0; i < 8; i++) {
    document.neighbours.forEach((node, n) => { node.rssi_last_dbm = -49 - 10 * n - i; });
    await world.publish(at + 'thread', JSON.stringify(document), '-r');
  }
  const mesh = page.locator('#picture .card', { hasText: 'pi' }).locator('.mesh');
  const rows = () => mesh.locator('li').allTextContents();
  await eventually('both neighbours are drawn', async () => (await rows()).length === 2 && /near.*-56 dBm/.test((await rows())[0]));
  const [near, other] = await rows();
  assert.match(near, /near.*child 0x4401 · link quality 2 of 3 · -56 dBm · 1\.2 % of frames lost/);
  assert.match(other, /99aabbccddeeff00.*leader 0x8000 · link quality 3 of 3 · -66 dBm/);
  assert.match(await mesh.textContent(), /this node: router · SLAM · channel 15 · 0x4400 · d2e15a0c0b0a0908/);
  assert.deepEqual(await mesh.locator('.way line').evaluateAll((lines) => lines.map((line) => line.getAttribute('stroke-width'))), ['2', '3']);
  assert.match(await page.locator('#table tbody tr', { hasText: 'near' }).textContent(), /-56 dBm/);
  await shot(page, 'border_router.png');
  await world.publish(at + 'thread', JSON.stringify({ ...document, role: 'detached', neighbours: null }), '-r');
  await world.publish(at + 'stats', '{"meshes":{"thread":{"state":"up","role":"detached"}}}');
  await until(page, () => /Gateway pi: its host has no Thread network \(detached\)/.test(document.querySelector('#problems').textContent));
  await world.publish(at + 'thread', '', '-r');
  await until(page, () => window.slamgw.model.gateways.get('pi').thread === null);
  for (const rest of ['robots/near', 'state']) await world.publish(at + rest, '', '-r');
});

// ---- trace

pageTest('the trace decodes, filters, pauses and downloads', { view: 'trace' }, async (page) => {
  await until(page, () => document.querySelectorAll('#messages tbody tr').length >= 20);
  await page.selectOption('#trace-robot', 'robot2');
  await page.selectOption('#trace-type', 'update');
  await until(page, () => document.querySelectorAll('#messages tbody tr').length >= 10);
  const rows = await page.$$eval('#messages tbody tr', (all) => all.map((row) => [...row.cells].map((cell) => cell.textContent)));
  for (const [time, from, robot, type, content] of rows) {
    assert.match(time, /^\d\d:\d\d:\d\d\.\d{3}$/);
    assert.deepEqual([from, robot, type], ['robot (thread)', 'robot2', 'update']);
    assert.match(content, /^x -?\d+  y -?\d+  sees (nothing|(\(-?\d+, -?\d+\) ?)+)$/);
  }
  await page.keyboard.press('Escape');
  await page.click('#pause');
  const held = await page.textContent('#messages tbody');
  await page.waitForTimeout(1200);
  assert.equal(await page.textContent('#messages tbody'), held);
  const lines = (await downloaded(page, '#download')).octets.toString().trim().split('\n');
  assert.equal(lines[0], 'time,from,robot,type,topic,encoding,payload,content');
  assert.ok(lines.length > 10 && lines.slice(1).every((line) => line.includes(',robot2,update,ntnu-slam/robot/robot2/update,hex,')));
});

pageTest('histograms count intervals and latency', { view: 'trace' }, async (page) => {
  await until(page, () => /n \d\d+ .*lost by gaps/.test(document.querySelector('#gap-words').textContent));
  await until(page, () => /gateway to here: n \d\d+/.test(document.querySelector('#delay-words').textContent));
  const inked = await page.evaluate(() => ['gaps', 'delays'].map((id) => {
    const canvas = document.querySelector(`#${id}`);
    return canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.filter((value, i) => i % 4 === 3 && value > 100).length;
  }));
  assert.ok(inked.every((count) => count > 200), inked.join());
  await page.waitForTimeout(5000); // more bars for the picture
  await shot(page, 'trace.png');
});

// ---- people and their screens

pageTest('everything can be done with keys', { unlocked: true }, async (page) => {
  await manyPoints(page);
  await page.keyboard.press('2');
  assert.equal(await page.isVisible('#table'), true);
  await page.keyboard.press('3');
  assert.equal(await page.isVisible('#messages'), true);
  await page.keyboard.press('1');
  await page.keyboard.press('n');
  assert.equal(await page.isVisible('#pilot'), true);
  const left = await page.evaluate(() => { window.slamgw.map.fits = false; return window.slamgw.map.view.left; });
  await page.keyboard.press('ArrowLeft');
  assert.equal(await page.evaluate(() => window.slamgw.map.view.left), left + 60);
  await page.keyboard.press('g');
  assert.equal(await page.getAttribute('#show-grid', 'aria-pressed'), 'false');
  await page.keyboard.press('Escape');
  assert.equal(await page.isVisible('#pilot'), false);
  await page.keyboard.press('?');
  assert.equal(await page.isVisible('#keys-dialog'), true);
  await page.keyboard.press('Escape');
  assert.equal(await page.isVisible('#keys-dialog'), false);
  await page.focus('#tab-map');
  await page.keyboard.press('ArrowRight');
  assert.equal(await page.evaluate(() => document.activeElement.id), 'tab-robots');
});

pageTest('a screen of 360 px holds every view', { width: 360, height: 640, hasTouch: true }, async (page) => {
  await manyPoints(page);
  for (const view of ['robots', 'trace', 'map']) {
    await page.click(`#tab-${view}`);
    await page.waitForTimeout(700);
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= 360), view);
    await shot(page, `phone-${view}.png`);
  }
  assert.equal(await page.isVisible('#list'), true);
});

pageTest('dark where the system is dark, and by choice', { colorScheme: 'dark' }, async (page) => {
  const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const dark = await ground();
  await manyPoints(page);
  await shot(page, 'map-dark.png');
  await page.click('#theme');
  assert.notEqual(await ground(), dark);
  await page.reload();
  assert.notEqual(await ground(), dark);
});

pageTest('no motion where the system asks for none', { reducedMotion: 'reduce' }, async (page) => {
  await manyPoints(page);
  const jumped = await page.evaluate(() => {
    const { map } = window.slamgw;
    map.zoom(3);
    map.fits = true;
    return map.fit(false); // whether it is still on its way
  });
  assert.equal(jumped, false);
});

// ---- metrics

test('* promtool accepts the metrics', async () => {
  await eventually('stats have come', () => world.metric('slamgw_gateway_uptime_seconds'));
  const { text, headers } = await ask('/metrics', {});
  assert.match(headers['content-type'], /^text\/plain; version=0\.0\.4/);
  const said = await new Promise((resolve) => {
    const child = execFile('promtool', ['check', 'metrics'], (error, out, err) => resolve(`${error ?? ''}${out}${err}`));
    child.stdin.end(text);
  });
  assert.equal(said, '');
  for (const name of ['slamgw_gateway_up', 'slamgw_gateway_messages_total', 'slamgw_robot_online', 'slamgw_web_pages']) assert.ok(text.includes(`\n${name}`), name);
});

// ---- hostile robots, nonsense, bounds

pageTest('* a robot with a hostile name is text in every view', {}, async (page) => {
  const names = [hostile, '__proto__', 'constructor', '"onload="alert(2)', '\u202eevil', 'r\u043ebot1'];
  const shown = names.map((name) => name.replace('\u202e', '\\u202e').replace('\u043e', '\\u043e'));
  for (const name of names) {
    await world.update(name, 1, 2, 30, 40);
    await world.publish(`ntnu-slam/robot/${name}/adv`, '<script>alert(3)</script>');
    await world.publish(`ntnu-slam/gateway/other/robots/${name}`, JSON.stringify({ state: 'online', mesh: hostile, address: hostile }), '-r');
  }
  await world.publish(`ntnu-slam/gateway/other/commands/${hostile}`, JSON.stringify({ type: 'cmd', outcome: hostile, why: hostile }));
  await world.publish('ntnu-slam/gateway/other/state', JSON.stringify({ state: 'online', version: hostile }), '-r');
  await world.publish('ntnu-slam/gateway/other/stats', JSON.stringify({ version: hostile, broker: { state: 'down', why: hostile, missing_rights: [{ what: hostile, grant: 'topic read x/#' }] }, meshes: { [hostile]: { state: 'down', detail: hostile } }, store: [], robots: null }));
  await until(page, (all) => all.every((name) => window.slamgw.model.robots.get(name)?.state === 'online'), names);
  const listed = () => page.$$eval('#list .name', (all) => all.map((one) => one.textContent));
  await eventually('all names are listed', async () => (await listed()).filter((name) => shown.includes(name)).length === names.length);
  for (const view of ['robots', 'trace', 'map']) {
    await page.click(`#tab-${view}`);
    await page.waitForTimeout(700); // two rounds of the tables
    assert.equal(await page.$$eval('img:not(h1 img), #table script, #messages script, b, [onerror], [onload]', (all) => all.length), 0, view);
    assert.ok((await page.textContent('body')).includes(hostile), view);
    if (view !== 'robots') continue;
    assert.ok((await page.textContent('#problems')).includes('In the access control list: topic read x/#'));
    assert.match(await page.textContent('#problems'), /2 names are made to look like another: .*\\u043ebot1/);
    assert.deepEqual(await page.$$eval('#table .deceptive', (all) => all.map((one) => one.textContent).sort()), ['\\u202eevil', 'r\\u043ebot1']);
    await shot(page, 'deceptive.png');
  }
  for (const name of names) await world.publish(`ntnu-slam/gateway/other/robots/${name}`, '', '-r');
  await world.publish('ntnu-slam/gateway/other/state', '', '-r');
});

pageTest('a first visitor without robots has a list of steps, each with its command', {}, async (page) => {
  const marks = async () => Object.fromEntries(await page.$$eval('#steps li', (all) => all.map((one) => [one.children[1].textContent, `${one.className} ${one.children[3].textContent}`.trim()])));
  await until(page, () => window.slamgw.model.gateways.get('here')?.stats);
  await page.evaluate(() => {
    const { model, map } = window.slamgw;
    model.robots.clear();
    for (const name of ['takeRobot', 'takePresence', 'takeNumbers', 'takeLife', 'takePast']) model[name] = () => {};
    map.repaint();
  });
  await until(page, () => !document.querySelector('#empty').hidden && /permit-join.*with a token/.test(document.querySelector('#steps').textContent));
  assert.deepEqual(await marks(), { Broker: 'done', Gateway: 'done', 'Board of the BLE mesh': 'done', Thread: 'done', 'First robot': 'todo sudo slam-gatewayctl ble permit-join', 'Commands from this page': 'done' });
  await shot(page, 'steps.png');
  await page.evaluate(() => { Object.assign(window.slamgw.model.gateways.get('here').stats.meshes.ble, { state: 'disabled', detail: '' }); });
  await until(page, () => /slam-gateway-sim thread/.test(document.querySelector('#steps').textContent));
  assert.match((await marks())['Board of the BLE mesh'], /^off echo .*ble_mesh/);
  await page.evaluate(() => { window.slamgw.model.gateways.clear(); window.slamgw.model.takeGateway = () => {}; });
  await until(page, () => /Gatewaynone has been heard on this broker/.test(document.querySelector('#steps').textContent));
  assert.equal((await marks()).Gateway, 'todo systemctl status slam-gateway');
});

pageTest('* a button lets new BLE robots join: one by name, then any', { view: 'robots' }, async (page) => {
  const words = (pattern) => until(page, (source) => new RegExp(source).test(document.querySelector('#join-words').textContent), pattern);
  const ready = (pattern) => until(page, (source) => [...document.querySelectorAll('#join-events .good')].some((line) => new RegExp(source).test(line.textContent)), pattern);
  world.startClosedMesh();
  await until(page, () => window.slamgw.model.gateways.get('there')?.stats?.meshes?.ble?.state === 'up');
  await page.click('#join');
  await page.selectOption('#join-gateway', 'here');
  await words('^Gateway here takes no requests: ble_mesh.provisioning.over_mqtt is not set');
  assert.equal(await page.textContent('#join-command'), 'sudo slam-gatewayctl ble permit-join --minutes 5');
  assert.equal(await page.isVisible('#join-begin'), false);
  await page.selectOption('#join-gateway', 'there');
  await words('unlock this page');
  await page.fill('#join-name', 'lego-1');
  await page.click('#join-begin');
  await page.fill('#token', token);
  await page.click('#token-form .main');
  await until(page, () => window.slamgw.model.maySend);
  await page.click('#join-begin');
  await ready('^lego-1 is ready$');
  await until(page, () => window.slamgw.model.robots.get('lego-1')?.state === 'online');
  await page.click('#join-begin');
  await words('^lego-1 is another robot already');
  await page.fill('#join-name', '');
  await page.waitForTimeout(1100); // a gateway takes one request a second
  await page.click('#join-begin');
  await ready('^ble-.* is ready$');
  await words('^Robots may join for another 4:[0-5][0-9]: switch them on');
  await shot(page, 'join.png');
  await page.click('#join-end');
  await until(page, () => document.querySelector('#join-words').textContent === '' && document.querySelector('#join-end').hidden);
  const robots = await page.evaluate(() => [...window.slamgw.model.robots.values()].filter((robot) => robot.best?.gateway === 'there').map(({ id }) => id));
  assert.equal(robots.length, 2, robots.join());
  await world.endClosedMesh(robots);
});

// ---- the page of one robot

pageTest('the keyboard opens a robot’s page from the table; the page has a URL of its own', { view: 'robots' }, async (page) => {
  await until(page, () => document.querySelectorAll('#table tbody tr').length >= 6);
  await page.locator('#table tbody tr', { has: page.locator('td:first-child', { hasText: /^robot1$/ }) }).focus();
  await page.keyboard.press('Enter');
  await until(page, () => !document.querySelector('#robot').hidden && location.hash === '#/robot/robot1');
  await page.reload();
  await until(page, () => document.querySelector('#robot-name').textContent === 'robot1' && document.querySelector('#robot-state').textContent === 'online');
  await page.goBack();
  await until(page, () => !document.querySelector('#robots').hidden);
});

for (const [robot, mesh] of [['robot1', 'Thread'], ['robot5', 'BLE Mesh']]) {
  pageTest(`* the page of a robot on ${mesh} has its numbers and messages, and commands it by typed places`, { view: `/robot/${robot}`, unlocked: true }, async (page) => {
    await until(page, () => document.querySelectorAll('#said tbody tr').length >= 10 && /\d (ms|dBm)/.test(document.querySelector('#facts').textContent));
    const facts = Object.fromEntries(await page.$$eval('#facts > div', (all) => all.map((one) => [...one.children].map((part) => part.textContent))));
    assert.deepEqual([facts.State, facts.Mesh, facts.Gateway], ['online', mesh, 'here']);
    if (mesh === 'BLE Mesh') assert.match(facts.Signal + facts.Hops + facts['TTL on arrival'], /^-\d+ dBm(\d|not known)\d$/);
    else assert.match(`${facts.Signal} ${facts['Latency p50, p99']}`, /^undefined [\d.]+ ms, [\d.]+ ms$/);
    const sent = await world.subscribe(`ntnu-slam/server/${robot}/#`);
    await page.fill('#send-x', '-12');
    await page.fill('#send-y', '34');
    await page.keyboard.press('Enter');
    await until(page, () => /cmd: go to \(-12, 34\).*delivered after \d+ ms/.test(document.querySelector('#commands tbody').textContent));
    await page.click('#robot-stop');
    await until(page, () => /run: stop.*delivered/.test(document.querySelector('#commands tbody tr').textContent));
    await page.click('#robot-start');
    await until(page, () => /run: start.*delivered/.test(document.querySelector('#commands tbody tr').textContent));
    await eventually('all commands', () => sent.lines.length >= 3);
    sent.stop();
    assert.deepEqual(sent.lines.map((line) => line.split(' ')[1]), ['f4ff2200', '73746f70', '7374617274']);
    await until(page, (id) => window.slamgw.model.robots.get(id).day?.online.at(-1) > 0 && /^online \d+ %/.test(document.querySelector('#day-words').textContent), robot);
    await shot(page, `page-${robot}.png`);
    await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
    await page.click('#lines li:first-child button');
    await eventually('it is copied', async () => await page.evaluate(() => navigator.clipboard.readText()) === `slam-gatewayctl doctor ${robot}`);
    await page.click('#robot-point');
    await until(page, (id) => !document.querySelector('#map').hidden && window.slamgw.map.chosen.id === id, robot);
  });
}

pageTest('lines to copy quote a name with a quotation mark and omit one that deceives', {}, async (page) => {
  await world.update("it's", 1, 2);
  await world.update('r\u043ebot1', 1, 2);
  await page.goto(`${world.url}#/robot/it's`);
  await until(page, () => document.querySelector('#lines code')?.textContent === "slam-gatewayctl doctor 'it'\\''s'");
  await page.goto(`${world.url}#/robot/r%D0%BEbot1`);
  await until(page, () => document.querySelectorAll('#lines li').length === 0 && !document.querySelector('#no-lines').hidden);
  await page.goto(`${world.url}#/robot/%E0%A4%A`);
  await until(page, () => document.querySelector('#robot-state').textContent.startsWith('No robot of this name'));
});

pageTest('invalid documents on the topics harm nothing', {}, async (page) => {
  for (const payload of ['', '{', '[]', 'null', '5', '{"state":5}', '{"robots":{"x":[]}}', '{"robots":[1]}', '{"meshes":{"ble":null}}', '{"broker":{"missing_rights":[1,null,{"what":{}}]}}', '{"broker":{"missing_rights":{"a":1}}}', Buffer.from('fffe00', 'hex'), '{"x":1e999,"y":{}}', '{"x":1e22,"y":0,"obstacles":[{"x":-1e300,"y":1}]}',
    Buffer.from('{"state":"online"}\0\xff{', 'latin1'), '\ufeff{"state":"online"}', `{"state":${'['.repeat(30000)}${']'.repeat(30000)}}`]) {
    for (const topic of ['gateway/odd/state', 'gateway/odd/stats', 'gateway/odd/numbers', 'gateway/odd/thread', 'gateway/odd/robots/odd', 'gateway/odd/commands/odd', 'robot/odd/update', 'robot/odd', 'server/odd/cmd', 'gateway/odd']) await world.publish(`ntnu-slam/${topic}`, payload);
  }
  for (const view of ['robots', 'trace', 'map']) {
    await page.click(`#tab-${view}`);
    await page.waitForTimeout(700);
  }
  await world.publish('ntnu-slam/gateway/odd/state', '', '-r');
  await until(page, () => document.querySelector('#link').textContent === 'Live');
});

pageTest('of 1200 robots the page shows 1000, reports the rest and keeps those that send', {}, async (page) => {
  await until(page, () => [...window.slamgw.model.robots.keys()].filter((id) => /^robot\d$/.test(id)).length === 6);
  await world.publishMany(Array.from({ length: 1200 }, (_, i) => [`ntnu-slam/robot/crowd${i}/adv`, 'x']));
  await until(page, () => window.slamgw.model.robots.size === 1000 && window.slamgw.model.leftOut.size >= 206);
  await until(page, () => /^\d+ more robots are not shown/.test(document.querySelector('#left-out').textContent));
  await eventually('a newcomer is shown', async () => { // once the others have been silent for 10 s
    await world.update('newcomer', 10, 20, 30, 40);
    return page.evaluate(() => window.slamgw.model.robots.get('newcomer')?.pose);
  });
  const kept = await page.evaluate(() => ({ size: window.slamgw.model.robots.size, names: [...window.slamgw.model.robots.keys()] }));
  assert.equal(kept.size, 1000);
  for (let i = 1; i <= 6; i++) assert.ok(kept.names.includes(`robot${i}`), 'robots that send stay');
  await page.click('#tab-robots');
  await until(page, () => document.querySelector('#problems').textContent.includes('more robots are not shown'));
});

pageTest('payloads that are too large do not reach the page', {}, async (page) => {
  await world.publish('ntnu-slam/gateway/huge/state', `{"state":"${'x'.repeat(5 << 20)}"}`);
  await world.publish('ntnu-slam/gateway/large/state', `{"state":"${'x'.repeat(100000)}"}`);
  await world.publish('ntnu-slam/gateway/small/state', '{"state":"online"}');
  await until(page, () => window.slamgw.model.gateways.has('small'));
  const known = await page.evaluate(() => ['huge', 'large', 'small'].map((id) => window.slamgw.model.gateways.get(id)?.state));
  assert.deepEqual(known, [undefined, null, { state: 'online' }]);
  for (const payload of [`{"state":"${'x'.repeat(50000)}"}`, 'y'.repeat(50000)]) await world.publish('ntnu-slam/gateway/small/state', payload);
  await until(page, () => window.slamgw.model.gateways.get('small').state === null);
  assert.ok(await page.evaluate(() => window.slamgw.model.messages.every(({ message }) => JSON.stringify(message).length < 10000)));
  for (const id of ['huge', 'large', 'small']) await world.publish(`ntnu-slam/gateway/${id}/state`, '');
  await until(page, () => document.querySelector('#link').textContent === 'Live');
});

test('a refused subscription is shown with the line that grants it', async () => {
  const page = await world.open({ url: await world.startStrict(), view: 'robots' });
  await until(page, () => /does not let this page read ntnu-slam\/robot\/#/.test(document.querySelector('#problems').textContent));
  assert.match(await page.textContent('#problems'), /topic read ntnu-slam\/gateway\/#/);
  assert.equal(await page.textContent('#link'), 'Rights missing');
  await page.context().close();
  await world.end('strict');
  await world.end('strictBroker');
});

const handshake = (socket) => socket.write(`GET /api HTTP/1.1\r\nHost: 127.0.0.1:${world.ports.web}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n`);

test('messages to a page that reads nothing are dropped, and other pages stay live', async () => {
  const before = await world.metric('slamgw_web_dropped_messages_total');
  const page = await world.open();
  const slow = net.connect(world.ports.web, '127.0.0.1');
  await new Promise((resolve) => slow.once('connect', resolve));
  handshake(slow);
  await new Promise((resolve) => slow.once('data', resolve));
  slow.pause();
  const flood = Buffer.alloc(4000, 'x').toString() + '\n';
  await eventually('messages are dropped', async () => {
    const child = execFile('mosquitto_pub', ['-p', String(world.ports.broker), '-t', 'ntnu-slam/robot/flood/adv', '-l']);
    child.stdin.end(flood.repeat(1500));
    await new Promise((resolve) => child.on('exit', resolve));
    return await world.metric('slamgw_web_dropped_messages_total') > before;
  });
  assert.equal(await page.textContent('#link'), 'Live');
  assert.ok(await world.metric('slamgw_web_resident_memory_bytes') < 64e6);
  slow.destroy();
  await page.context().close();
});

test('more pages than there is room for are refused', async () => {
  const sockets = [];
  const answers = [];
  for (let i = 0; i < 40; i++) {
    const socket = net.connect(world.ports.web, '127.0.0.1');
    socket.once('data', (data) => answers.push(Number(String(data).slice(9, 12))));
    socket.on('error', () => {});
    handshake(socket);
    sockets.push(socket);
  }
  await eventually('all are answered', () => answers.length === 40);
  assert.ok(answers.filter((status) => status === 101).length <= 32, answers.join());
  assert.ok(answers.includes(503));
  for (const socket of sockets) socket.destroy();
  await eventually('their room is free again', async () => await world.metric('slamgw_web_pages') === 0);
});

test('invalid HTTP ends its own connection only', async () => {
  for (const garbage of ['\0\0\0\0', 'GET', `GET / HTTP/1.1\r\n${'X: y\r\n'.repeat(5000)}\r\n`, 'GET /api HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n\r\n']) {
    const socket = net.connect(world.ports.web, '127.0.0.1');
    socket.on('error', () => {});
    socket.end(garbage);
    await new Promise((resolve) => socket.on('close', resolve).resume());
  }
  assert.equal((await ask('/', {})).status, 200);
});

test('the metrics of nineteen thousand robots do not hold up the page', async () => {
  await world.publishMany(Array.from({ length: 19000 }, (_, i) => [`ntnu-slam/gateway/many/robots/r${i}`, '{"state":"online","mesh":"thread","address":"[fd00::1]:1"}']));
  await eventually('they are known', async () => (await ask('/metrics', {})).text.includes('robot="r18999"'));
  const order = [];
  await Promise.all([
    ask('/metrics', {}).then(({ text }) => order.push(text.split('\n').filter((line) => line.startsWith('slamgw_robot_online')).length)),
    ask('/icon.svg', {}).then(({ status }) => order.push(status)),
  ]);
  assert.equal(order[0], 200, 'the file first, though it was asked for later');
  assert.ok(order[1] >= 19000, String(order));
  // At most two clients get the metrics at a time; the others are refused.
  const statuses = (await Promise.all(Array.from({ length: 6 }, () => ask('/metrics', {})))).map(({ status }) => status);
  assert.ok(statuses.includes(200) && statuses.every((status) => [200, 503].includes(status)), statuses.join());
  assert.equal((await ask('/metrics', {})).status, 200);
  await world.end('web'); // the tests that follow have six robots again
  await world.startWeb();
});

// ---- absent brokers and gateways

pageTest('* without the broker commands are refused at once; then the page is live again', { unlocked: true }, async (page) => {
  await manyPoints(page);
  await world.publish('ntnu-slam/gateway/ghost/state', '{"state":"online"}', '-r');
  await until(page, () => window.slamgw.model.gateways.has('ghost'));
  await world.end('broker');
  await until(page, () => document.querySelector('#link').textContent === 'Broker away');
  await choose(page, 'robot1');
  await page.click('#stop');
  await outcome(page, 'refused: no connection to the broker');
  await page.click('#tab-robots');
  await until(page, () => /does not reach the broker/.test(document.querySelector('#problems li').textContent));
  await shot(page, 'trouble.png');
  await world.startBroker();
  await until(page, () => document.querySelector('#link').textContent === 'Live');
  await until(page, () => window.slamgw.model.gateways.has('here') && !window.slamgw.model.gateways.has('ghost')); // this broker stores no retained messages
  const before = await page.evaluate(() => window.slamgw.model.robots.get('robot1').messages);
  await until(page, (count) => window.slamgw.model.robots.get('robot1').messages > count + 3, before);
});

pageTest('the page stays unlocked over a restart of slam-gateway-web', { unlocked: true }, async (page) => {
  await world.end('web', 'SIGKILL');
  await until(page, () => document.querySelector('#link').textContent === 'No connection');
  await world.startWeb();
  await until(page, () => document.querySelector('#link').textContent === 'Live' && window.slamgw.model.maySend);
  page.errors.length = 0; // the browser reports each attempt
});

pageTest('* robots of a dead gateway are unknown since its death', { view: 'robots' }, async (page) => {
  await until(page, () => document.querySelector('#gateways tbody').textContent.includes('MiB'));
  await world.end('daemon', 'SIGKILL');
  await until(page, () => /^Gateway here is gone since \d\d:\d\d.*systemctl status slam-gateway/.test(document.querySelector('#problems li').textContent));
  await until(page, () => /^Gateway here is gone since \d\d:\d\d$/.test(document.querySelector('#link').textContent));
  await until(page, () => !document.querySelector('#trouble').hidden);
  const states = () => page.$$eval('#table tbody tr', (rows) => rows.filter((row) => /^robot\d$/.test(row.cells[0].textContent)).map((row) => row.cells[1].textContent));
  await eventually('no robot is online', async () => (await states()).filter((state) => /^unknown since \d\d:\d\d$/.test(state)).length === 6);
  assert.deepEqual(await page.$$eval('#picture .dot.online', (all) => all.map((dot) => dot.parentElement.textContent)), ['Broker']);
  assert.deepEqual(await page.$$eval('#gateways tbody td', (cells) => cells.slice(3).map((cell) => cell.textContent)), Array(6).fill('–'));
  await shot(page, 'gone.png');
  await page.click('#tab-map');
  assert.ok(await page.evaluate(() => [...window.slamgw.model.robots.values()].filter(({ id }) => /^robot\d$/.test(id)).every((robot) => robot.isGone)));
  await shot(page, 'gone-map.png');
  assert.equal(await world.metric('slamgw_gateway_up'), 0);
  assert.equal(await world.metric('slamgw_robot_online'), null);
  world.startDaemon();
  await until(page, () => document.querySelector('#link').textContent === 'Live');
  await until(page, () => window.slamgw.model.robots.get('robot1').state === 'online');
});

pageTest('a clock 3 h ahead is reported, and robots of its gateway have the right age', { view: 'robots' }, async (page) => {
  const ahead = new Date(Date.now() + 3 * 3600e3).toISOString();
  await world.publish('ntnu-slam/gateway/fast/state', JSON.stringify({ state: 'online', since: ahead }), '-r');
  await world.publish('ntnu-slam/gateway/fast/robots/early', JSON.stringify({ state: 'online', mesh: 'ble', since: ahead, last_seen: ahead }), '-r');
  await until(page, () => /The clock of gateway fast is 3 h ahead/.test(document.querySelector('#problems').textContent));
  const row = await page.locator('#table tbody tr', { hasText: 'early' }).textContent();
  assert.match(row, /online.*fast.*\d s/);
  for (const topic of ['robots/early', 'state']) await world.publish(`ntnu-slam/gateway/fast/${topic}`, '', '-r');
  await until(page, () => document.querySelector('#link').textContent === 'Live');
});

test('slam-gateway-web exits with 0 on SIGTERM while pages are open', async () => {
  const web = world.processes.get('web');
  const page = await world.open();
  const slow = net.connect(world.ports.web, '127.0.0.1', () => handshake(slow));
  const idle = net.connect(world.ports.web, '127.0.0.1', () => idle.write('GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n'));
  for (const socket of [slow, idle]) {
    socket.on('error', () => {});
    await new Promise((resolve) => socket.once('data', resolve));
    socket.pause();
  }
  web.kill('SIGTERM');
  assert.equal(await web.ended, 0);
  world.processes.delete('web');
  slow.destroy();
  idle.destroy();
  await page.context().close();
});
