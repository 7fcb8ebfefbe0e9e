// The viewer's movable receiver in a real browser: its light against the command's, and what a user does.
//   node receiver_test.mjs PROGRAMS MODULES OUT [--only NAME] [--images DIR --demo BASIS.hlb]
// PROGRAMS: the build's folder apps/; MODULES: where playwright-core is installed; OUT: pictures.
// scripts/page_test BUILD --receiver runs it.

import {execFileSync} from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {Browser, Suite, expect, until} from './harness.mjs';
import {contrast, fitsThePhone, namesAndRoles, tabOrder} from './page_rules.mjs';
import {Viewer, compareWithPng, relight, settled} from './view_harness.mjs';

const [programs, modules, out] = process.argv.slice(2, 5).map(p => path.resolve(p));
const option = name => {
  const i = process.argv.indexOf(name);
  return i < 0 ? '' : process.argv[i + 1];
};
const source = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const haarlight = path.join(programs, 'haarlight/haarlight');
const folder = path.join(out, 'receiver');
fs.rmSync(folder, {recursive: true, force: true});
fs.mkdirSync(folder, {recursive: true});

const kSmall8 = fs.readFileSync(path.join(source, 'configs/rigs/small8.toml'), 'utf8');
const kRoom = path.join(source, 'configs/environments/room.hdr');
const kBoxes = 'schema = 1\nname = "boxes"\n[[material]]\nname = "m"\nkd = [0.3]\n' +
  '[[box]]\nlow = [-30.0, -30.0, 20.0]\nhigh = [30.0, 30.0, 80.0]\nmaterial = "m"\n' +
  '[[box]]\nlow = [-90.0, -10.0, 40.0]\nhigh = [-30.0, 10.0, 55.0]\nmaterial = "m"\n';
const kNothing = 'schema = 1\nname = "nothing"\n[[material]]\nname = "m"\nkd = [0.3]\n' +
  '[[box]]\nlow = [9000.0, 9000.0, 0.0]\nhigh = [9010.0, 9010.0, 10.0]\nmaterial = "m"\n';

/** A basis file of a scene over the small rig, rendered without noise. */
function captured(name, scene, change = text => text) {
  const file = path.join(folder, `${name}.hlb`);
  if (!fs.existsSync(file)) {
    fs.writeFileSync(path.join(folder, `${name}-rig.toml`), change(kSmall8.replace('texel = 2.0', 'texel = 4.0')));
    fs.writeFileSync(path.join(folder, `${name}-scene.toml`), scene);
    execFileSync(path.join(programs, '../tests/web/made_capture'),
                 [file, path.join(folder, `${name}-rig.toml`), path.join(folder, `${name}-scene.toml`)]);
  }
  return file;
}

const browser = await new Browser().begin(modules);
const suite = new Suite(browser, option('--only'));
const textOf = (page, selector) => page.locator(selector).innerText();

/** Runs `body(page, viewer)` on a fresh server and page. */
async function viewing(file, body, context = {}) {
  const viewer = await new Viewer(programs).begin(file);
  try {
    const page = await browser.page(`${viewer.url}/`, context);
    await settled(page);
    return await body(page, viewer);
  } finally {
    await browser.closePages();
    await viewer.end();
    expect(viewer.process.exitCode === 0, `haarlight view ended with ${viewer.process.exitCode}`);
  }
}

/** The mode, with its exact picture. */
async function receiving(page) {
  await page.locator('#show-receiver').click();
  await page.evaluate(() => window.haarlightView.receiver.opened);
  await exact(page);
}

const exact = page => page.evaluate(() => window.haarlightView.receiver.engine.settled());
const shapeOf = page => page.evaluate(() => {
  const {heightMm, tiltDeg, turnDeg} = window.haarlightView.receiver.shape;
  return {heightMm, tiltDeg, turnDeg};
});

const boxes = (body, context) => viewing(captured('boxes', kBoxes), async (page, viewer) => {
  await receiving(page);
  return body(page, viewer);
}, context);

/** Writes the sheet as a scene whose camera sees it from above, a point in each pixel. @return  its exposure */
async function sceneFromAbove(page) {
  const {scene, exposure} = await page.evaluate(() => {
    const {shape, scene: {exposure: factor}} = window.haarlightView.receiver;
    const {corner, across, down, normal} = shape.sheet();
    const target = corner.map((x, i) => x + 0.5 * across[i] + 0.5 * down[i]);
    const far = 2000;
    return {exposure: factor, scene: shape.sceneText({
      size: [shape.cols, shape.rows], target, eye: target.map((x, i) => x + far * normal[i]),
      up: down.map(x => -x / shape.along), fovDeg: 2 * Math.atan(0.5 * shape.along / far) * 180 / Math.PI,
    })};
  });
  fs.writeFileSync(path.join(folder, 'above.toml'), scene);
  return exposure;
}

/** The page's light on the sheet against the command's: how many values differ by how much, of 255. */
async function compareWithCommand(page, file, light) {
  const exposure = await sceneFromAbove(page);
  const picture = path.join(folder, 'above.png');
  execFileSync(haarlight, ['shadow', file, '--scene', path.join(folder, 'above.toml'), '--method', 'hull', ...light, '--subpixels', '1',
                           '--exposure', String(exposure), '-o', picture, '--force', '--quiet'], {stdio: 'ignore'});
  return page.evaluate(async url => {
    const image = new Image();
    image.src = url;
    await image.decode();
    const bitmap = await createImageBitmap(image, {colorSpaceConversion: 'none', premultiplyAlpha: 'none'});
    const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext('2d');
    context.drawImage(bitmap, 0, 0);
    const truth = context.getImageData(0, 0, bitmap.width, bitmap.height).data;
    const {picture: {cols, rows, sums}, scene} = window.haarlightView.receiver;
    let [off, dark, n] = [0, 0, 0];
    for (let p = 0; p < cols * rows; ++p) {
      for (let c = 0; c < 3; ++c, ++n) {
        const v = Math.min(1, scene.exposure * 0.8 / Math.PI * sums[6 * p + c]);
        const code = Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055));
        off += Math.abs(code - truth[4 * p + c]) > 1 ? 1 : 0;
        dark += truth[4 * p + c] < 128 ? 1 : 0;
      }
    }
    return {size: [bitmap.width - cols, bitmap.height - rows], off: off / n, dark: dark / n};
  }, `data:image/png;base64,${fs.readFileSync(picture).toString('base64')}`);
}

/** Sets lights {light: weight} and where the sheet is; waits for the exact picture. */
const setUp = (page, lights, [heightMm, tiltDeg, turnDeg]) => page.evaluate(async ([given, where]) => {
  const {receiver, basis} = window.haarlightView;
  const weights = new Float64Array(basis.nLights);
  Object.entries(given).forEach(([light, weight]) => (weights[light] = weight));
  Object.assign(receiver.shape, where);
  receiver.setWeights([weights]);
  await receiver.engine.settled();
}, [lights, {heightMm, tiltDeg, turnDeg}]);

// ---- the same light as the command ----------------------------------------------------------

// Where 9 rays are all blocked, the command casts 36 if matter that is sure does not block all of them: the
// page does not, and a few points differ by a ray or two of 36.
const kOff = 0.001;

await suite.test('the light on the sheet is what haarlight shadow --method hull computes', async () =>
  boxes(async (page, viewer) => {
    const worst = [];
    for (const [lights, where, least] of [
      [{27: 1}, [0, 0, 0], 0.02], [{27: 1}, [-50, 0, 0], 0.02], [{0: 1, 63: 0.5}, [-40, 20, 30], 0],
      [{9: 1, 36: 2, 54: 1}, [30, -35, 140], 0], [{36: 1}, [60, 0, 0], 0.005], [{7: 1}, [-60, 55, -90], 0],
    ]) {
      await setUp(page, lights, where);
      const words = Object.entries(lights).map(([light, weight]) => `${light}=${weight}`).join(',');
      const {size, off, dark} = await compareWithCommand(page, viewer.file, ['--light', words]);
      expect(String(size) === '0,0', `sizes differ by ${size}`);
      expect(off <= kOff, `lights ${words} at ${where}: ${(100 * off).toFixed(3)} % of the values differ by more than 1 of 255`);
      expect(dark >= least, `lights ${words} at ${where}: there is no shadow`);
      worst.push(off);
    }
    return `at most ${(100 * Math.max(...worst)).toFixed(3)} % of the values differ by more than 1 of 255`;
  }));

await suite.test('an environment in colour, and a turned one', async () =>
  boxes(async (page, viewer) => {
    await page.locator('#environment-file').setInputFiles(kRoom);
    for (const degrees of [0, 75]) {
      await page.locator('#turn').fill(String(degrees));
      await until(() => page.evaluate(wanted => window.haarlightView.environment?.isExact &&
        window.haarlightView.environment.degrees === wanted, degrees), 'its exact weights');
      await exact(page);
      const {off} = await compareWithCommand(page, viewer.file, ['--cubemap', kRoom, '--rotate', String(degrees)]);
      expect(off <= kOff, `turned by ${degrees} degrees ${(100 * off).toFixed(3)} % of the values differ`);
    }
    expect(/--cubemap room\.hdr --rotate 75 /.test(await page.locator('#receiver-command').textContent()), 'the command');
  }));

await suite.test('the saved scene with the command that is shown', async () =>
  boxes(async (page, viewer) => {
    await page.locator('#receiver-height').fill('-30');
    await exact(page);
    const download = page.waitForEvent('download');
    await page.locator('#save-scene').click();
    await (await download).saveAs(path.join(folder, 'receiver.toml'));
    const [command] = (await page.locator('#receiver-command').textContent()).split('\n');
    expect(/^haarlight shadow boxes\.hlb --scene receiver\.toml --method hull --light \d+ -o shadow\.png$/.test(command), command);
    execFileSync(haarlight, [...command.split(' ').slice(1), '--force', '--quiet'], {cwd: folder, stdio: 'ignore'});
    expect(fs.existsSync(path.join(folder, 'shadow.png')), viewer.file);
  }));

// ---- few rays while it moves ----------------------------------------------------------------

await suite.test('at a movement the lights in groups, then every light: nearer and nearer', async () =>
  boxes(async page => {
    const {pictures, words} = await page.evaluate(async () => {
      const {receiver, basis} = window.haarlightView;
      const {engine} = receiver;
      for (const measured of [engine.nsOf.grouped, engine.nsOf.exact]) {  // a slow processor
        measured.last = [2e4];
        measured.value = 2e4;
        measured.add = () => {};
      }
      engine.nsOf.exact.value = 2e5;
      const found = {pictures: [], words: []};
      const {shown} = engine;
      engine.shown = picture => {
        shown(picture);
        found.pictures.push(picture);
        found.words.push(document.getElementById('receiver-facts').textContent);
      };
      receiver.setWeights([Float64Array.from({length: basis.nLights}, (_, k) => 1 + k % 3)]);
      await engine.settled();
      const finest = found.pictures.at(-1);
      return {words: found.words, pictures: found.pictures.map(({level, cols, rows, sums}) => {
        let [difference, all] = [0, 0];
        const step = finest.cols / cols;
        for (let j = 0; j < rows; ++j) {
          for (let i = 0; i < cols; ++i) {
            const [a, b] = [sums[6 * (j * cols + i)], finest.sums[6 * (j * step * finest.cols + i * step)]];
            difference += (a - b) ** 2;
            all += b ** 2;
          }
        }
        return {level, error: Math.sqrt(difference / all)};
      })};
    });
    expect(pictures.length >= 3 && pictures.at(-1).level.isExact, `${pictures.length} pictures`);
    expect(pictures[0].level.groups === 16 && pictures[0].level.coarse === 2, JSON.stringify(pictures[0].level));
    pictures.slice(1).forEach(({error}, i) => expect(error < pictures[i].error, `step ${i + 1} is not nearer: ${error}`));
    expect(pictures[0].error < 0.15, `the first is off by ${pictures[0].error}`);
    expect(/The 64 lights in 16 groups, 1 ray each, every second point; the others follow/.test(words[0]), words[0]);
    expect(/The 64 lights that are on, 9 rays from each point to each light, 36 where its edge falls\. [\d.]+ m?s\./.test(words.at(-1)),
           words.at(-1));
    return pictures.map(({error}) => error.toPrecision(2)).join(', ');
  }));

// ---- what a user does -----------------------------------------------------------------------

/** The pointer dragged over the picture by some pixels. */
async function dragBy(page, dx, dy, options = {}) {
  const box = await page.locator('#receiver').boundingBox();
  const [x, y] = [box.x + 0.5 * box.width, box.y + 0.5 * box.height];
  await page.mouse.move(x, y);
  await page.mouse.down(options);
  await page.mouse.move(x + dx, y + dy, {steps: 5});
  await page.mouse.up(options);
}

await suite.test('dragging raises, tilts and turns the sheet, or turns the view; so do keys and sliders', async () =>
  boxes(async page => {
    await page.locator('#receiver').scrollIntoViewIfNeeded();
    await dragBy(page, 0, 60);
    const low = await shapeOf(page);
    expect(low.heightMm < -20 && low.tiltDeg === 0, `dragged down: ${JSON.stringify(low)}`);
    expect(await textOf(page, '#receiver-height-text') === `${Math.round(low.heightMm)} mm`, 'the height is told');
    await page.locator('#drag-tilt').click();
    await dragBy(page, 50, -50);
    const tilted = await shapeOf(page);
    expect(tilted.tiltDeg > 10 && tilted.turnDeg > 10 && tilted.heightMm === low.heightMm, JSON.stringify(tilted));
    const viewOf = () => page.evaluate(() => JSON.stringify(window.haarlightView.receiver.scene.camera()));
    const before = await viewOf();
    await page.locator('#drag-view').click();
    await dragBy(page, 40, 0);
    expect(await viewOf() !== before && JSON.stringify(await shapeOf(page)) === JSON.stringify(tilted), 'the view alone has turned');
    await page.locator('#view-camera').click();
    const eye = JSON.parse(await viewOf()).eye.map(x => Math.round(x));
    expect(String(eye) === '0,-560,520', `the camera's view is from ${eye}`);
    await page.locator('#view-reset').click();
    expect(JSON.stringify(await shapeOf(page)) === '{"heightMm":0,"tiltDeg":0,"turnDeg":0}', 'as it began');
    await page.locator('#drag-height').click();
    await page.locator('#receiver').focus();
    await page.keyboard.press('ArrowUp');
    await page.keyboard.press('Shift+ArrowUp');
    expect((await shapeOf(page)).heightMm === 12, 'arrow keys');
    await page.locator('#receiver-tilt').fill('-25');
    await page.locator('#receiver-turn').fill('90');
    expect(JSON.stringify(await shapeOf(page)) === '{"heightMm":12,"tiltDeg":-25,"turnDeg":90}', 'sliders');
  }));

await suite.test('the light of the map lights both pictures', async () =>
  boxes(async (page, viewer) => {
    const before = await page.evaluate(() => Array.from(window.haarlightView.receiver.picture.sums));
    const canvas = page.locator('.face canvas');
    const box = await canvas.boundingBox();
    await page.mouse.click(box.x + 6.5 / 8 * box.width, box.y + 1.5 / 8 * box.height);
    await exact(page);
    const moved = await page.evaluate(old => {
      const {sums} = window.haarlightView.receiver.picture;
      return sums.reduce((n, v, i) => n + (Math.abs(v - old[i]) > 0.2 * Math.max(v, old[i]) ? 1 : 0), 0) / sums.length;
    }, before);
    expect(moved > 0.01, `the light falls elsewhere: ${moved}`);
    await page.locator('#show-picture').click();
    await settled(page);
    const {worst} = await compareWithPng(page, relight(haarlight, viewer.file, ['--light', '14'], folder).url);
    expect(worst <= 1, `the picture differs from the command's by ${worst}`);
    await page.locator('#show-receiver').click();
    await page.locator('#clear').click();
    await exact(page);
    await page.evaluate(async () => {  // dark while the light before is still being computed
      const {receiver, basis} = window.haarlightView;
      receiver.setWeights([new Float64Array(basis.nLights).fill(1)]);
      await new Promise(resolve => requestAnimationFrame(() => requestAnimationFrame(resolve)));
      receiver.setWeights([new Float64Array(basis.nLights)]);
      await new Promise(resolve => requestAnimationFrame(() => requestAnimationFrame(resolve)));
      await receiver.engine.settled();
    });
    expect(/No light is on/.test(await textOf(page, '#receiver-facts')), await textOf(page, '#receiver-facts'));
  }));

await suite.test('what is assumed is shown, and the picture is saved as it is', async () =>
  boxes(async page => {
    const orange = () => page.evaluate(() => {
      const {scene} = window.haarlightView.receiver;
      scene.draw();
      const {data} = scene.pixels();
      let n = 0;
      for (let i = 0; i < data.length; i += 4) {
        n += data[i] > data[i + 2] + 40 ? 1 : 0;
      }
      return n;
    });
    expect(await orange() === 0, 'nothing is orange');
    await page.locator('#show-assumed').check();
    expect(await orange() > 50, 'what is assumed is orange');
    const download = page.waitForEvent('download');
    await page.locator('#save-receiver').click();
    expect((await download).suggestedFilename() === 'boxes-shadow.png', 'its name');
    await (await download).saveAs(path.join(folder, 'saved.png'));
    expect(fs.statSync(path.join(folder, 'saved.png')).size > 5000, 'a picture');
  }));

await suite.test('the hull is carved once: the next page reads it', async () => {
  const file = captured('boxes', kBoxes);
  fs.rmSync(`${file}.hull`, {force: true});
  await viewing(file, async page => {
    expect(!fs.existsSync(`${file}.hull`), 'nobody has asked for it yet');
    await page.locator('#show-receiver').click();
    expect(/Carving the object/.test(await textOf(page, '#receiver-wait')), 'that it takes a while is told');
    await page.evaluate(() => window.haarlightView.receiver.opened);
    expect(fs.existsSync(`${file}.hull`), 'it is kept');
    expect(await textOf(page, '#receiver-wait') === '', 'nothing is waited for');
  });
});

// ---- none -----------------------------------------------------------------------------------

await suite.test('a capture that can have no hull says why', async () => {
  const absent = async (file, words) => viewing(file, async page => {
    expect(await page.locator('#shows').isHidden(), 'there is no such mode');
    const told = await textOf(page, '#receiver-absent');
    expect(words.test(told) && /Hint: /.test(told), told);
  });
  await absent(captured('few', kBoxes, text => text.replace('rows = 8', 'rows = 1').replace('cols = 8', 'cols = 3')),
               /3 lights shine on the shadow plane: too few/);
  const imported = path.join(folder, 'import.hlb');
  execFileSync(path.join(programs, '../tests/web/made_basis'), [imported, '--grid', '8']);
  await absent(imported, /no rig/);
});

await suite.test('a capture without an object says so when it is carved', async () =>
  viewing(captured('nothing', kNothing), async page => {
    await page.locator('#show-receiver').click();
    await page.evaluate(() => window.haarlightView.receiver.opened);
    expect(/show no object[^]*Hint: /.test(await textOf(page, '#receiver-absent')), await textOf(page, '#receiver-absent'));
    expect(await page.locator('#shows').isHidden() && await page.locator('#picture').isVisible(), 'the picture is shown again');
  }));

// ---- everybody ------------------------------------------------------------------------------

await suite.test('names, roles, contrast, focus', async () =>
  boxes(async page => {
    for (const theme of ['dark', 'light']) {
      await page.evaluate(name => (document.documentElement.dataset.theme = name), theme);
      const problems = [...await namesAndRoles(page), ...await contrast(page)];
      expect(problems.length === 0, `${theme}: ${problems.join('; ')}`);
    }
    const {reached, problems} = await tabOrder(page);
    expect(problems.length === 0, problems.join('; '));
    for (const id of ['receiver', 'drag-height', 'receiver-height', 'receiver-tilt', 'receiver-turn', 'save-scene']) {
      expect(reached.includes(id), `Tab does not reach ${id}: ${reached}`);
    }
  }));

await suite.test('fits a phone', async () =>
  boxes(async page => {
    const problems = await fitsThePhone(page);
    expect(problems.length === 0, problems.join('; '));
  }, {viewport: {width: 360, height: 740}, isMobile: true, hasTouch: true}));

if (option('--images')) {
  await suite.test('pictures for the documents', async () => {
    const demo = option('--demo') || path.join(source, 'out/demo/biplane.hlb');
    expect(fs.existsSync(demo), `no ${demo}: run ./demo first, or name a capture with --demo`);
    await viewing(demo, async page => {
      await receiving(page);
      await page.locator('#environment-file').setInputFiles(kRoom);
      await until(() => page.evaluate(() => window.haarlightView.environment?.isExact), 'the room');
      await page.locator('#receiver-height').fill('-60');
      await page.locator('#receiver-tilt').fill('6');
      await exact(page);
      await page.waitForTimeout(1000);
      const file = path.join(path.resolve(option('--images')), 'view-receiver.png');
      await page.evaluate(() => window.scrollTo(0, 0));
      await page.screenshot({path: file});
      expect(fs.statSync(file).size < 300_000, 'the picture is too large for the documents');
    }, {colorScheme: 'dark', viewport: {width: 1280, height: 1000}});
  });
}

await suite.test('no console errors, no foreign requests', () => {
  expect(browser.problems.length === 0, browser.problems.join('\n'));
});
await browser.end();
console.log(`${suite.run - suite.failed} passed, ${suite.failed} failed`);
process.exit(suite.failed === 0 && suite.run > 0 ? 0 : 1);
