// The screenshots of docs/page.md, of a run on a virtual cube of 1024 lights with a small camera.

import fs from 'node:fs';
import path from 'node:path';
import {Rig, expect, until} from './harness.mjs';

/** @param to  folder of the pictures */
export async function takeImages(browser, programs, cache, source, to) {
  const rig = await new Rig(programs, cache).begin(path.join(source, 'configs/rigs/cube32.toml'), {
    scene: path.join(source, 'configs/scenes/airplane.toml'),
    change: text => text  // half the size: a quarter of the light transport to compute
      .replace('size = [320, 248]', 'size = [160, 128]').replace('active_area = 240', 'active_area = 120')
      .replace(/^K = .*/m, 'K = [[219.798, 0.0, 80.0], [0.0, 219.798, 60.0], [0.0, 0.0, 1.0]]'),
  });
  const shoot = async (page, name) => {
    await page.evaluate(() => window.scrollTo(0, 0));
    await page.screenshot({path: path.join(to, `page-${name}.png`)});
  };
  const committed = async n => until(async () => (await rig.state()).committed >= n, `${n} shots`, 120);
  const told = async page => {
    await page.locator('#warning[open]').waitFor();
    await page.locator('#warning-told').check();
    await page.locator('#warning-go').click();
  };
  try {
    const dark = await browser.page(rig.url, {colorScheme: 'dark', viewport: {width: 1280, height: 920}});
    const phone = await browser.page(rig.url, {colorScheme: 'dark', viewport: {width: 360, height: 740},
                                               deviceScaleFactor: 1.5, isMobile: true, hasTouch: true});
    await dark.locator('#plan-start:enabled').waitFor();
    await dark.locator('#plan-start').click();
    await told(dark);
    await committed(330);
    await until(async () => /left/.test(await dark.locator('#run-left').innerText()), 'a time left');
    await shoot(dark, 'run');
    await committed(400);
    await shoot(phone, 'phone');
    await until(async () => (await rig.state()).phase === 'done', 'the end of the run', 180);

    const light = await browser.page(rig.url, {colorScheme: 'light', viewport: {width: 1280, height: 950}});
    await until(async () => /1.0\d\d/.test(await light.locator('#legend').innerText()), 'the map');
    const canvas = light.locator('.face canvas');
    const box = await canvas.boundingBox();
    await light.mouse.click(box.x + 6.5 / 32 * box.width, box.y + 9.5 / 32 * box.height);
    await light.locator('#shot-words li').first().waitFor();
    await light.waitForTimeout(500);
    await shoot(light, 'shot');

    await dark.locator('#tab-live').click();
    await dark.locator('#live-lights').fill('330 345');
    await dark.locator('#live-start').click();
    await until(async () => /saturated/.test(await dark.locator('#live-facts').innerText()), 'a picture');
    await dark.waitForTimeout(700);
    await shoot(dark, 'live');
    await fetch(`${rig.url}/v1/abort`, {method: 'POST'});
    for (const name of fs.readdirSync(to).filter(file => /^page-.*\.png$/.test(file))) {
      expect(fs.statSync(path.join(to, name)).size < 300_000, `${name} is too large for the documents`);
    }
  } finally {
    await rig.end();
  }
}
