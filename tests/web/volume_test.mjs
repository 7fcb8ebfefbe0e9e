// The page of a volume, in a real browser against the real server; its pictures against `haarlight render volume`'s.
//   node volume_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR]
// scripts/page_test BUILD --volume runs it.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import {Browser, Suite, expect, until} from './harness.mjs';
import {contrast, fitsThePhone, namesAndRoles, tabOrder} from './page_rules.mjs';
import {Viewer, compareWithPng, settled} from './view_harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const option = name => {
  const i = process.argv.indexOf(name);
  return i < 0 ? '' : process.argv[i + 1];
};
const haarlight = path.join(programs, 'haarlight/haarlight');
const folder = path.join(out, 'volume');
fs.mkdirSync(folder, {recursive: true});
const volumes = path.resolve('configs/volumes');
const cube = path.join(volumes, 'cube.toml');

/** A scene with a surface, of which there are no previews. */
function withContour() {
  const file = path.join(folder, 'contour.toml');
  fs.copyFileSync(path.join(volumes, 'cube.vtu'), path.join(folder, 'cube.vtu'));
  fs.writeFileSync(file, `${fs.readFileSync(cube, 'utf8')}
[[contour]]\nfield = "linear"\nvalue = 0.5\ncolour = [0.9, 0.8, 0.2]\nopacity = 0.4\n`);
  return file;
}

const browser = await new Browser().begin(modules);
const suite = new Suite(browser, option('--only'));

async function viewing(file, body, options = {}) {
  const viewer = await new Viewer(programs).begin(file, options.words);
  try {
    const page = await browser.page(`${viewer.url}/`, options.context, options.allowed);
    await settled(page);
    return await body(page, viewer);
  } finally {
    await browser.closePages();
    await viewer.end();
  }
}

const textOf = (page, id) => page.locator(id).textContent();
const kindOf = page => page.evaluate(() => document.getElementById('loading').dataset.kind);
const lookOf = page => page.evaluate(() => window.haarlightView.look);

/** The page's view, rendered by the command. @return  a data URL */
async function rendered(page, ...words) {
  const scene = path.join(folder, 'saved.toml');
  fs.writeFileSync(scene, await page.evaluate(async () => (await fetch('/v1/volume/scene', {
    method: 'POST', body: JSON.stringify(window.haarlightView.look),
  })).text()));
  const png = path.join(folder, 'saved.png');
  execFileSync(haarlight, ['render', 'volume', scene, '-o', png, '--force', '--quiet', ...words]);
  return `data:image/png;base64,${fs.readFileSync(png).toString('base64')}`;
}

async function isTheCommands(page) {
  expect(await kindOf(page) === 'exact', 'the exact picture is shown at rest');
  const {worst} = await compareWithPng(page, await rendered(page));
  expect(worst === 0, `differs by ${worst} of 255`);
}

/** Presses at (x, y) of an element, 0 to 1, and moves by (dx, dy) pixels in steps. */
async function drag(page, id, [x, y], [dx, dy], during = async () => {}) {
  const box = await page.locator(id).boundingBox();
  const [left, top] = [box.x + x * box.width, box.y + y * box.height];
  await page.mouse.move(left, top);
  await page.mouse.down();
  for (let i = 1; i <= 8; ++i) {
    await page.mouse.move(left + i / 8 * dx, top + i / 8 * dy);
    await page.waitForTimeout(30);
  }
  await during();
  await page.mouse.up();
}

await suite.test('the file\'s view is exact to the last code, and the preview\'s difference is told', async () =>
  viewing(cube, async page => {
    await isTheCommands(page);
    expect(/^The exact picture: .*s\.$/.test((await textOf(page, '#picture-facts')).trim()), await textOf(page, '#picture-facts'));
    expect(/was off by [\d.e-]+ in the mean/.test(await textOf(page, '#difference')), await textOf(page, '#difference'));
    expect((await textOf(page, '#command')).includes('cube.toml'), 'the file itself');
    return textOf(page, '#difference');
  }));

await suite.test('dragging turns it: previews meanwhile, the exact picture at rest', async () =>
  viewing(cube, async page => {
    const before = await lookOf(page);
    await page.evaluate(() => {
      window.kinds = [];
      new MutationObserver(() => window.kinds.push(document.getElementById('loading').dataset.kind))
        .observe(document.getElementById('loading'), {attributes: true, childList: true});
    });
    await drag(page, '#picture', [0.5, 0.5], [120, -40], async () => {
      await until(() => page.evaluate(() => window.kinds.includes('preview')), 'a preview while it moves');
    });
    await settled(page);
    const after = await lookOf(page);
    const arm = look => Math.hypot(...look.camera.eye.map((v, i) => v - look.camera.target[i]));
    expect(Math.abs(arm(after) - arm(before)) < 1e-9, 'as far away as before');
    expect(Math.hypot(...after.camera.eye.map((v, i) => v - before.camera.eye[i])) > 1, 'elsewhere');
    await isTheCommands(page);
    expect(/-view\.toml/.test(await textOf(page, '#command')), await textOf(page, '#command'));
    await page.locator('#reset').click();
    await settled(page);
    expect(JSON.stringify(await lookOf(page)) === JSON.stringify(before), 'the file\'s view again');
    await isTheCommands(page);
  }));

await suite.test('the wheel and the keys: nearer, farther, around, home', async () =>
  viewing(cube, async page => {
    const arm = async () => {
      const {camera} = await lookOf(page);
      return Math.hypot(...camera.eye.map((v, i) => v - camera.target[i]));
    };
    const [home, first] = [await lookOf(page), await arm()];
    await page.locator('#picture').hover();
    await page.mouse.wheel(0, -100);
    await until(async () => await arm() < first, 'nearer');
    await page.locator('#picture').focus();
    await page.keyboard.press('-');
    await page.keyboard.press('-');
    await until(async () => await arm() > first, 'farther');
    await page.keyboard.press('Shift+ArrowRight');
    await page.keyboard.press('ArrowUp');
    await settled(page);
    await isTheCommands(page);
    await page.keyboard.press('Home');
    await settled(page);
    expect(JSON.stringify((await lookOf(page)).camera) === JSON.stringify(home.camera), 'home');
  }));

await suite.test('a point of the density is dragged, and typed', async () =>
  viewing(cube, async page => {
    const before = await lookOf(page);
    const place = await page.evaluate(() => {
      const {density} = window.haarlightView;
      const [value, height] = density.rows[1];
      return [density.x(value) / density.canvas.clientWidth, density.y(height) / density.canvas.clientHeight];
    });
    await drag(page, '#density', place, [25, 50]);
    await settled(page);
    const after = await lookOf(page);
    expect(after.density[1][0] > before.density[1][0] && after.density[1][1] < before.density[1][1] - 0.5,
           `${before.density[1]} became ${after.density[1]}`);
    expect(String(after.density[0]) === String(before.density[0]), 'the others stay');
    await isTheCommands(page);
    await page.locator('#density-number-1').fill('3.125');
    await page.keyboard.press('Enter');
    await settled(page);
    expect((await lookOf(page)).density[1][1] === 3.125, 'as typed');
    await isTheCommands(page);
  }));

await suite.test('points of the colour by keyboard: chosen, moved, added, removed, coloured', async () =>
  viewing(cube, async page => {
    await page.locator('#colour').focus();
    await page.keyboard.press('PageDown');
    expect(/Point 2 of 5/.test(await textOf(page, '#colour-readout')), await textOf(page, '#colour-readout'));
    await page.keyboard.press('Shift+ArrowRight');
    await page.keyboard.press('Insert');
    await settled(page);
    let {colour} = await lookOf(page);
    expect(colour.length === 6 && Math.abs(colour[1][0] - 0.35) < 1e-9, JSON.stringify(colour));
    await page.keyboard.press('Delete');
    await page.locator('#colour-choice').fill('#ff0000');
    await settled(page);
    ({colour} = await lookOf(page));
    expect(colour.length === 5 && colour.some(row => String(row.slice(1)) === '1,0,0'), JSON.stringify(colour));
    await isTheCommands(page);
  }));

await suite.test('exposure: a factor that the command takes', async () =>
  viewing(cube, async page => {
    const own = await page.evaluate(() => window.haarlightView.shown.facts.exposure);
    await page.locator('#exposure').fill('-1');
    await settled(page);
    const factor = await page.evaluate(() => window.haarlightView.shown.facts.exposure);
    expect(factor === own / 2, `${factor} is not half of ${own}`);
    expect((await textOf(page, '#command')).includes(`--exposure ${factor}`), await textOf(page, '#command'));
    const {worst} = await compareWithPng(page, await rendered(page, '--exposure', String(factor)));
    expect(worst === 0, `differs by ${worst} of 255`);
  }));

await suite.test('files to save: the picture, its numbers, the scene', async () =>
  viewing(cube, async page => {
    for (const [id, name, first] of [['#save', 'cube-view.png', '\x89PNG'], ['#save-exr', 'cube-view.exr', '\x76\x2f\x31\x01'],
                                     ['#save-scene', 'cube-view.toml', 'schema = 1']]) {
      const [download] = await Promise.all([page.waitForEvent('download'), page.locator(id).click()]);
      expect(download.suggestedFilename() === name, download.suggestedFilename());
      const file = path.join(folder, name);
      await download.saveAs(file);
      expect(fs.readFileSync(file, 'latin1').startsWith(first), `${name} begins otherwise`);
    }
  }));

await suite.test('without previews small exact pictures serve, and the page says so', async () =>
  viewing(withContour(), async page => {
    expect(/No preview: previews draw no contours/.test(await textOf(page, '#picture-facts')), await textOf(page, '#picture-facts'));
    await drag(page, '#picture', [0.5, 0.5], [60, 0], async () => {
      await until(async () => /coarse/.test(await textOf(page, '#loading')), 'a coarse picture');
    });
    await settled(page);
    await isTheCommands(page);
  }));

await suite.test('two pages at once show each its own view', async () =>
  viewing(cube, async (page, viewer) => {
    const other = await browser.page(`${viewer.url}/`);
    await settled(other);
    await Promise.all([drag(page, '#picture', [0.5, 0.5], [90, 0]), other.locator('#picture').press('ArrowUp')]);
    for (const one of [page, other]) {
      await settled(one);
      await isTheCommands(one);
    }
  }));

await suite.test('a server that is gone, and a view that it refuses, are told', async () =>
  viewing(cube, async (page, viewer) => {
    await page.evaluate(() => window.haarlightView.engine.want({...window.haarlightView.look, density: []}));
    await until(async () => /Hint: /.test(await textOf(page, '#problem')), 'what is wrong');
    await page.locator('#reset').click();
    await settled(page);
    expect(!await page.locator('#problem').isVisible(), 'all is well again');
    await viewer.end();
    await page.locator('#picture').press('ArrowLeft');
    await until(async () => /does not answer[^]*Hint: /.test(await textOf(page, '#problem')), 'the message');
  }, {allowed: [/ERR_CONNECTION_REFUSED/, /400/]}));

await suite.test('names, roles, contrast, focus, and a phone', async () => {
  await viewing(cube, async page => {
    for (const theme of ['light', 'dark']) {
      await page.evaluate(name => (document.documentElement.dataset.theme = name), theme);
      const problems = [...await namesAndRoles(page), ...await contrast(page)];
      expect(problems.length === 0, `${theme}: ${problems.join('; ')}`);
    }
    const {reached, problems} = await tabOrder(page);
    expect(problems.length === 0, problems.join('; '));
    for (const id of ['picture', 'exposure', 'save-scene', 'density', 'colour', 'colour-add']) {
      expect(reached.includes(id), `Tab does not reach ${id}: ${reached}`);
    }
    await page.evaluate(() => document.activeElement?.blur());
    if (option('--images')) {
      await drag(page, '#picture', [0.5, 0.5], [-50, 20]);
      await settled(page);
      await page.mouse.move(0, 0);
      await page.evaluate(() => window.scrollTo(0, 0));
      await page.screenshot({path: path.join(option('--images'), 'view-volume.png')});
    }
  }, {context: {colorScheme: 'dark', viewport: {width: 1280, height: 1000}}});
  await viewing(cube, async page => {
    const problems = await fitsThePhone(page);
    expect(problems.length === 0, problems.join('; '));
  }, {context: {viewport: {width: 360, height: 740}, deviceScaleFactor: 1.5, isMobile: true, hasTouch: true}});
});

await suite.test('no console errors, no foreign requests', async () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});

await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
