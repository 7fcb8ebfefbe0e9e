// The page of a picture lit by direction, in a real browser against the real server; its pictures
// against `haarlight convert`'s.
//   node reflectance_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR]
// scripts/page_test BUILD --reflectance runs it.

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
const folder = path.join(out, 'reflectance');
fs.mkdirSync(folder, {recursive: true});

const [kWidth, kHeight] = [60, 45];

/** Numbers that repeat from run to run. */
function dice(seed) {
  let state = seed;
  return () => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0) / 2 ** 32;
}

/** A half ball of radius 20 on a plane, lit by the law of Lambert, as luminance a u + b v + c w of a PTM_LRGB. */
function writeBall(file) {
  const header = `PTM_1.2\nPTM_FORMAT_LRGB\n${kWidth}\n${kHeight}\n1 1 1 2 2 2 \n128 128 128 128 128 0 \n`;
  const [luminance, colours] = [Buffer.alloc(6 * kWidth * kHeight), Buffer.alloc(3 * kWidth * kHeight)];
  const draw = dice(7);
  for (let row = 0; row < kHeight; ++row) {  // from the lowest
    for (let x = 0; x < kWidth; ++x) {
      const p = row * kWidth + x;
      const [u, v] = [(x + 0.5 - kWidth / 2) / 20, (row + 0.5 - kHeight / 2) / 20];
      const isBall = Math.hypot(u, v) < 1;
      luminance.set([90, 90, 128, 128 + (isBall ? 90 * u : 0), 128 + (isBall ? 90 * v : 0), 60 + 20 * draw()]
        .map(n => Math.round(n)), 6 * p);
      colours.set([220, 190 + 30 * draw(), 160].map(n => Math.round(n)), 3 * p);
    }
  }
  fs.writeFileSync(file, Buffer.concat([Buffer.from(header, 'latin1'), luminance, colours]));
  return file;
}

/** Coefficients of any kind in three colours. */
function writeNoise(file) {
  const header = `PTM_1.2\nPTM_FORMAT_RGB\n${kWidth}\n${kHeight}\n0.5 0.5 0.5 0.5 0.5 1 \n128 128 128 128 128 0 \n`;
  const draw = dice(3);
  const bytes = Buffer.from(Uint8Array.from({length: 18 * kWidth * kHeight}, () => 256 * draw()));
  fs.writeFileSync(file, Buffer.concat([Buffer.from(header, 'latin1'), bytes]));
  return file;
}

const convert = (input, output, ...words) =>
  execFileSync(haarlight, ['convert', input, output, '--force', '--quiet', ...words.map(String)]);

const kFiles = {
  lrgb: () => writeBall(path.join(folder, 'ball.ptm')),
  rgb: () => writeNoise(path.join(folder, 'noise.ptm')),
  hsh: () => {
    const file = path.join(folder, 'noise.rti');
    convert(kFiles.rgb(), file);
    return file;
  },
  web: () => {
    const file = path.join(folder, 'web');
    convert(kFiles.rgb(), file);
    return file;
  },
};

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

/** Drags the light to (x, y) of the ball. */
async function dragTo(page, x, y) {
  const box = await page.locator('#ball').boundingBox();
  const radius = box.width / 2 * 0.94;
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 + radius * x, box.y + box.height / 2 - radius * y);
  await page.mouse.up();
  await settled(page);
}

for (const [name, make] of Object.entries(kFiles)) {
  await suite.test(`${name}: wherever the light stands, the picture is the command's`, async () => {
    const file = make();
    return viewing(file, async page => {
      let most = 0;
      for (const [x, y] of [[0, 0], [0.6, 0.2], [-0.4, -0.7], [0, 0.99]]) {
        await dragTo(page, x, y);
        const light = await page.evaluate(() => window.haarlightView.shown.light);
        const png = path.join(folder, 'relit.png');
        convert(file, png, '--light', light.join(','));
        const url = `data:image/png;base64,${fs.readFileSync(png).toString('base64')}`;
        const {worst, share} = await compareWithPng(page, url);
        expect(worst <= 1, `light ${light}: differs by ${worst} of 255`);
        most = Math.max(most, share);
      }
      return `at most ${(100 * most).toFixed(3)} % of the values differ, by one`;
    });
  });
}

await suite.test('the light follows the arrow keys and stays on the half ball', async () =>
  viewing(kFiles.lrgb(), async page => {
    const light = () => page.evaluate(() => window.haarlightView.shown.light);
    await page.locator('#ball').focus();
    await page.keyboard.press('Home');
    await settled(page);
    expect(String(await light()) === '0,0,1', `straight above, not ${await light()}`);
    await page.keyboard.press('ArrowRight');
    await settled(page);
    expect((await light())[0] > 0.04, 'to the right');
    for (let i = 0; i < 12; ++i) {
      await page.keyboard.press('Shift+ArrowUp');
    }
    await settled(page);
    const [x, y, z] = await light();
    expect(Math.abs(Math.hypot(x, y, z) - 1) < 1e-9 && z >= 0 && y > 0.95, `on the rim: ${[x, y, z]}`);
    expect(/° above the picture, -?\d+° counter-clockwise from the right/.test(await textOf(page, '#light-readout')), 'it is told');
    expect(/^haarlight convert ball\.ptm picture\.png --light /.test(await textOf(page, '#command')), 'the command');
  }));

await suite.test('normals lean outwards on a ball, and gloss follows them', async () =>
  viewing(kFiles.lrgb(), async page => {
    await page.locator('#mode').selectOption('normals');
    const colourAt = (x, y) => page.evaluate(([u, v]) => {
      const {width, data} = window.haarlightView.renderer.pixels();
      return [...data.slice(4 * (v * width + u), 4 * (v * width + u) + 3)];
    }, [x, y]);
    const [left, right, top, low] = [await colourAt(16, 22), await colourAt(44, 22), await colourAt(30, 8), await colourAt(30, 36)];
    expect(left[0] < 120 && right[0] > 135, `red leans right: ${left}, ${right}`);
    expect(top[1] > 135 && low[1] < 120, `green leans up: ${top}, ${low}`);
    await page.locator('#mode').selectOption('specular');
    const brightest = () => page.evaluate(() => {
      const {width, data} = window.haarlightView.renderer.pixels();
      let [best, at] = [-1, 0];
      for (let p = 0; p < data.length; p += 4) {
        if (data[p] + data[p + 1] + data[p + 2] > best) {
          [best, at] = [data[p] + data[p + 1] + data[p + 2], p / 4];
        }
      }
      return at % width;
    });
    await page.locator('#diffuse').fill('0.1');
    await dragTo(page, 0.8, 0);
    const right1 = await brightest();
    await dragTo(page, -0.8, 0);
    const left1 = await brightest();
    expect(right1 > 30 && left1 < 30, `the gloss stands at columns ${right1} and ${left1} of 60`);
    expect(await page.locator('#gloss-tools').isVisible(), 'its sliders');
  }));

await suite.test('zoom, and a picture that does not fit the page', async () => {
  await viewing(kFiles.lrgb(), async page => {
    await page.locator('#zoom').selectOption('4');
    const box = await page.locator('#picture').boundingBox();
    expect(Math.abs(box.width - 240) < 1, `240 wide, not ${box.width}`);
  });
  await viewing(kFiles.rgb(), async page => {
    expect(/means of 2 × 2 pixels/.test(await textOf(page, '#picture-facts')), await textOf(page, '#picture-facts'));
  }, {words: ['--memory', '200K']});
});

await suite.test('a server that is gone is told', async () =>
  viewing(kFiles.lrgb(), async (page, viewer) => {
    await viewer.end();
    await dragTo(page, 0.3, 0.3);
    await until(async () => /does not answer[^]*Hint: /.test(await textOf(page, '#problem')), 'the message');
  }, {allowed: [/ERR_CONNECTION_REFUSED/]}));

await suite.test('names, roles, contrast, focus, and a phone', async () => {
  await viewing(kFiles.lrgb(), async page => {
    for (const theme of ['dark', 'light']) {
      await page.evaluate(name => (document.documentElement.dataset.theme = name), theme);
      const problems = [...await namesAndRoles(page), ...await contrast(page)];
      expect(problems.length === 0, `${theme}: ${problems.join('; ')}`);
    }
    const {reached, problems} = await tabOrder(page);
    expect(problems.length === 0, problems.join('; '));
    for (const id of ['zoom', 'save', 'ball', 'mode']) {
      expect(reached.includes(id), `Tab does not reach ${id}: ${reached}`);
    }
    if (option('--images')) {
      await page.screenshot({path: path.join(option('--images'), 'view-reflectance.png')});
    }
  });
  await viewing(kFiles.lrgb(), async page => {
    const problems = await fitsThePhone(page);
    expect(problems.length === 0, problems.join('; '));
  });
});

await suite.test('no console errors, no foreign requests', async () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});

await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
