// SPDX-License-Identifier: Apache-2.0
// ./dev browser-test --bench [--soak-minutes N]: 100 robots at 5/s with 2000 obstacle points each on the map. Frames a
// second in headless Chromium, CPU and memory of slam-gateway-web and of the page, octets of the page. Prints one JSON
// object; not a test. With --soak-minutes N the page stays open for N minutes and prints memory each minute: it must stay flat.
import { readFileSync } from 'node:fs';
import { setTimeout as sleep } from 'node:timers/promises';
import { World } from './world.mjs';

const ROBOTS = Number(process.env.SLAMGW_BENCH_ROBOTS ?? 100);
const SECONDS = Number(process.env.SLAMGW_BENCH_SECONDS ?? 30);
const SOAK_MINUTES = Number(process.env.SLAMGW_SOAK_MINUTES || 0);
const world = await World.start({ thread: 0, ble: 0, daemon: false });
world.spawn('feed', 'python3', [new URL('feed.py', import.meta.url).pathname, String(world.ports.broker), String(ROBOTS)]);
const page = await world.open();
const pid = world.processes.get('web').pid;
const ticks = () => readFileSync(`/proc/${pid}/stat`, 'utf8').split(' ').slice(13, 15).reduce((sum, n) => sum + Number(n), 0);
const resident = () => Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, 'utf8'))[1]);
await page.waitForFunction((n) => window.slamgw.model.robots.size >= n, ROBOTS);
// 2000 points each: those of the first minutes, made at once.
await page.evaluate(() => {
  for (const robot of window.slamgw.model.robots.values()) {
    for (let i = 0; i < 2000; i++) {
      const angle = Math.random() * 2 * Math.PI;
      robot.addPoint(80 * Math.cos(angle) + Math.random() * 3, 80 * Math.sin(angle) + Math.random() * 3, 1, Date.now());
    }
  }
});
const measure = async (seconds) => {
  const [began, cpu, frames, messages] = [performance.now(), ticks(), await page.evaluate(() => window.slamgw.map.frames), await world.metric('slamgw_web_messages_total')];
  await sleep(seconds * 1000);
  const passed = (performance.now() - began) / 1000;
  return {
    frames_per_second: ((await page.evaluate(() => window.slamgw.map.frames)) - frames) / passed,
    program_cpu_percent: (ticks() - cpu) / passed, // a tick is 10 ms
    messages_per_second: ((await world.metric('slamgw_web_messages_total')) - messages) / passed,
  };
};
const drawing = (isFresh) => page.evaluate((fresh) => {
  const { map } = window.slamgw;
  const began = performance.now();
  for (let i = 0; i < 20; i++) {
    if (fresh) map.layerAt = -Infinity;
    map.draw();
    map.context.getImageData(0, 0, 1, 1); // waits until it is drawn
  }
  return (performance.now() - began) / 20;
}, isFresh);
await sleep(3000);
const result = await measure(SECONDS);
result.frame_ms = await drawing(false);
result.fresh_frame_ms = await drawing(true); // once a second, and while the map moves
result.program_rss_mib = resident() / 1024;
result.page_heap_mib = await page.evaluate(() => performance.memory.usedJSHeapSize / 1048576);
result.points = await page.evaluate(() => [...window.slamgw.model.robots.values()].reduce((sum, robot) => sum + robot.kept, 0));
result.dropped = await world.metric('slamgw_web_dropped_messages_total');
result.page_octets_compressed = 0;
for (const name of ['', ...new Set(await page.evaluate(() => performance.getEntriesByType('resource').map((entry) => new URL(entry.name).pathname.slice(1))))]) {
  const response = await fetch(world.url + name, { headers: { 'accept-encoding': 'gzip' } });
  if (response.ok) result.page_octets_compressed += Number(response.headers.get('content-length'));
}

// The heap after a collection; without it the garbage since the last one would be counted.
const session = await page.context().newCDPSession(page);
const memory = async () => {
  await session.send('HeapProfiler.collectGarbage');
  return { program_rss_mib: resident() / 1024, page_heap_mib: (await session.send('Runtime.getHeapUsage')).usedSize / 1048576 };
};
if (SOAK_MINUTES) result.soak = [];
for (let minute = 0; minute <= SOAK_MINUTES && SOAK_MINUTES; minute++) {
  if (minute) await sleep(60000);
  const now = { minute, ...(await memory()), frames: await page.evaluate(() => window.slamgw.map.frames), messages: await world.metric('slamgw_web_messages_total') };
  console.error(JSON.stringify(now));
  result.soak.push(now);
}
console.log(JSON.stringify(result, null, 1));
await world.stop();
