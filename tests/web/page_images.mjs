// The screenshots of docs/reference/page.md, of a run on a virtual cube of 1024 lights with a small camera.

import fs from 'node:fs';
import path from 'node:path';
import {Rig, expect, until} from './harness.mjs';

const shoot = async (page, to, name) => {
  await page.evaluate(() => window.scrollTo(0, 0));
  await page.screenshot({path: path.join(to, `page-${name}.png`)});
};

const told = async page => {
  await page.locator('#warning[open]').waitFor();
  await page.locator('#warning-told').check();
  await page.locator('#warning-go').click();
};

const kPhone = {viewport: {width: 360, height: 740}, deviceScaleFactor: 1.5, isMobile: true, hasTouch: true};

/** Focusing a camera with Bayer colours, brackets half-way, the devices: 64 lights. @param to  folder */
export async function takeSmallImages(browser, programs, cache, source, to) {
  const rig = await new Rig(programs, cache).begin(path.join(source, 'configs/rigs/small8.toml'), {
    scene: path.join(source, 'configs/scenes/airplane.toml'),
    change: text => text
      .replace('size = [64, 56]', 'size = [320, 248]').replace('active_area = 48', 'active_area = 240')
      .replace(/^K = .*/m, 'K = [[439.596, 0.0, 160.0], [0.0, 439.596, 120.0], [0.0, 0.0, 1.0]]')
      .replace('fps = 240.0', 'fps = 40.0').replace('bayer = "none"', 'bayer = "rggb"').replace('"Y16 "', '"RG14"'),
  });
  try {
    const page = await browser.page(rig.url, {colorScheme: 'dark', viewport: {width: 1280, height: 1180}});
    const phone = await browser.page(rig.url, {colorScheme: 'light', ...kPhone});
    await page.locator('#tab-live').click();
    await page.locator('#live-lights').fill('27 36 42');
    await page.locator('#live-exposure').fill('600');
    await page.locator('#live-start').click();
    await told(page);
    await until(async () => /Frame/.test(await page.locator('#live-facts').innerText()), 'a picture');
    await page.locator('#panel-live .wide-look').click();
    await page.locator('#live-zoom button', {hasText: '4:1'}).click();
    await until(async () => Number(await page.locator('#live-sharp-value').innerText()) > 0, 'a sharpness');
    await page.waitForTimeout(1500);
    await shoot(page, to, 'live');
    await phone.locator('#tab-live').click();
    await until(async () => /Frame/.test(await phone.locator('#live-facts').innerText()), 'a picture');
    await phone.locator('#live-zoom button', {hasText: '2:1'}).click();
    await phone.waitForTimeout(1200);
    await phone.locator('#side').evaluate(side => side.scrollIntoView());
    await phone.screenshot({path: path.join(to, 'page-phone-live.png')});
    await fetch(`${rig.url}/v1/abort`, {method: 'POST'});
    await until(async () => (await rig.state()).phase === 'idle', 'the lights to be free');

    await page.locator('#panel-live .wide-look').click();
    await page.locator('#tab-plan').click();
    await page.locator('#plan-text').fill(
      'schema = 1\nname = "brackets"\npatterns = "one_at_a_time"\norder = "bit_reversed"\n' +
      'exposures_us = [300, 600, 1200]\nrepeats = 4\n');
    await page.locator('#plan-start:enabled').waitFor();
    await page.locator('#plan-start').click();
    await told(page);
    await until(async () => (await rig.state()).committed >= 350, 'half of the shots', 120);
    await page.locator('#tab-rig').click();
    await until(async () => /delivers/.test(await page.locator('#devices').innerText()), 'the devices');
    await page.waitForTimeout(2500);
    await shoot(page, to, 'brackets');
    await page.setViewportSize({width: 1280, height: 1350});
    await page.locator('#side').screenshot({path: path.join(to, 'page-rig.png')});
    await fetch(`${rig.url}/v1/abort`, {method: 'POST'});
  } finally {
    await rig.end();
  }
}

/** A run of 1024 lights. @param to  folder of the pictures */
export async function takeImages(browser, programs, cache, source, to) {
  const rig = await new Rig(programs, cache).begin(path.join(source, 'configs/rigs/cube32.toml'), {
    scene: path.join(source, 'configs/scenes/airplane.toml'),
    change: text => text  // half the size: a quarter of the light transport to compute
      .replace('size = [320, 248]', 'size = [160, 128]').replace('active_area = 240', 'active_area = 120')
      .replace(/^K = .*/m, 'K = [[219.798, 0.0, 80.0], [0.0, 219.798, 60.0], [0.0, 0.0, 1.0]]'),
  });
  const committed = async n => until(async () => (await rig.state()).committed >= n, `${n} shots`, 120);
  try {
    const dark = await browser.page(rig.url, {colorScheme: 'dark', viewport: {width: 1280, height: 920}});
    const phone = await browser.page(rig.url, {colorScheme: 'dark', ...kPhone});
    await dark.locator('#plan-start:enabled').waitFor();
    await dark.locator('#plan-start').click();
    await told(dark);
    await committed(330);
    await until(async () => /left/.test(await dark.locator('#run-left').innerText()), 'a time left');
    await shoot(dark, to, 'run');
    await committed(400);
    await shoot(phone, to, 'phone');
    await until(async () => (await rig.state()).phase === 'done', 'the end of the run', 180);

    const light = await browser.page(rig.url, {colorScheme: 'light', viewport: {width: 1280, height: 950}});
    await until(async () => /1.0\d\d/.test(await light.locator('#legend').innerText()), 'the map');
    const canvas = light.locator('.face canvas');
    const box = await canvas.boundingBox();
    await light.mouse.click(box.x + 6.5 / 32 * box.width, box.y + 9.5 / 32 * box.height);
    await light.locator('#shot-words li').first().waitFor();
    await light.waitForTimeout(500);
    await shoot(light, to, 'shot');

    for (const name of fs.readdirSync(to).filter(file => /^page-.*\.png$/.test(file))) {
      expect(fs.statSync(path.join(to, name)).size < 300_000, `${name} is too large for the documents`);
    }
  } finally {
    await rig.end();
  }
}
