// SPDX-License-Identifier: Apache-2.0
// ./dev browser-test --pictures: the pictures of docs/images. Six robots drive for half a minute, and one is sent somewhere.
import { execFileSync } from 'node:child_process';
import { join } from 'node:path';
import { World, keepDirectory } from './world.mjs';

const SIZES = [[390, 844], [820, 1180], [1280, 800], [1920, 1080]];
const made = [];
const shot = async (page, name) => {
  made.push(join(keepDirectory, `${name}.png`));
  await page.screenshot({ path: made.at(-1) });
};

const world = await World.start({});
const page = await world.open({ unlocked: true });
await page.waitForFunction(() => [...window.slamgw.model.robots.values()].filter((robot) => robot.kept > 60).length === 6);
await page.locator('#list li', { hasText: 'robot1' }).locator('button').click();
await page.waitForTimeout(25000); // a ring on the map
const at = await page.evaluate(() => [window.slamgw.map.view.px(-30), window.slamgw.map.view.py(25)]);
const box = await page.locator('#world').boundingBox();
await page.mouse.click(box.x + at[0], box.y + at[1]);
await page.waitForFunction(() => document.querySelector('#outcomes li')?.textContent.includes('delivered'));
await page.waitForTimeout(1500);
await shot(page, 'map');
for (const [width, height] of SIZES) {
  for (const colorScheme of ['light', 'dark']) {
    const other = await world.open({ width, height, colorScheme, hasTouch: width < 1000 });
    await other.waitForFunction(() => [...window.slamgw.model.robots.values()].filter((robot) => robot.pose && robot.state === 'online').length >= 6);
    await other.waitForTimeout(3000); // the past has come
    await shot(other, `map-${width}-${colorScheme}`);
    await other.context().close();
  }
}
await page.click('#tab-robots');
await page.waitForTimeout(32000); // three points of each ten-minute line
await page.mouse.move(5, 700);
await shot(page, 'robots');
await world.stop();
execFileSync('pngquant', ['--force', '--ext', '.png', '128', ...made]);
process.exit(0);
