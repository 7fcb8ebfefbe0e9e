// A virtual rig, a daemon and a browser for the tests of the page, and a list of tests that run one
// after the other. Uses Debian's Chromium through playwright-core.

import {execFileSync, spawn} from 'node:child_process';
import fs from 'node:fs';
import {createRequire} from 'node:module';
import net from 'node:net';
import os from 'node:os';
import path from 'node:path';

export const sleep = ms => new Promise(resolve => setTimeout(resolve, ms));

export class Failure extends Error {}
export function expect(claim, words) {
  if (!claim) {
    throw new Failure(words);
  }
}

/** Waits until `condition` gives something true, and returns it. */
export async function until(condition, words, seconds = 30) {
  const end = Date.now() + seconds * 1000;
  let problem = '';
  while (Date.now() < end) {
    try {
      const value = await condition();
      if (value) {
        return value;
      }
    } catch (error) {
      problem = ` (${error.message.split('\n')[0]})`;
    }
    await sleep(50);
  }
  throw new Failure(`waited ${seconds} s for ${words}${problem}`);
}

function freePort() {
  return new Promise((resolve, reject) => {
    const server = net.createServer();
    server.on('error', reject);
    server.listen(0, '127.0.0.1', () => {
      const {port} = server.address();
      server.close(() => resolve(port));
    });
  });
}

const children = new Set();
process.on('exit', () => children.forEach(child => child.kill('SIGKILL')));  // also after a failure

/** haarlight-sim and haarlightd on a copy of a rig file with ports and folders of its own. */
export class Rig {
  constructor(programs, cache) {
    this.programs = programs;
    this.cache = cache;
    this.folder = fs.mkdtempSync(path.join(os.tmpdir(), 'haarlight-page-'));
    this.processes = {};
  }

  /** @param options  change(text): edits the rig file; token; scene */
  async begin(source, options = {}) {
    this.port = await freePort();
    const bus = await freePort();
    let text = fs.readFileSync(source, 'utf8');
    const set = (key, value) => {
      text = text.replace(new RegExp(`^${key} = .*`, 'm'), `${key} = ${value}`);
    };
    set('device', `"${this.folder}/camera.sock"`);
    set('folder', `"${this.folder}/sessions"`);
    set('port', this.port);
    text = text.replace(/127\.0\.0\.1:\d+/, `127.0.0.1:${bus}`);
    if (options.token) {
      fs.writeFileSync(path.join(this.folder, 'token'), `${options.token}\n`);
      text = text.replace(/^\[http\]$/m, '[http]\ntoken_file = "token"');
    }
    this.rig = path.join(this.folder, 'rig.toml');
    fs.writeFileSync(this.rig, options.change ? options.change(text) : text);
    this.scene = options.scene;
    this.commands = path.join(this.folder, 'commands');
    execFileSync('mkfifo', [this.commands]);
    await this.beginSim();
    await this.beginDaemon();
    return this;
  }

  run(name, program, words) {
    const log = fs.openSync(path.join(this.folder, `${name}.log`), 'a');
    const child = spawn(program, words, {stdio: ['ignore', log, log]});
    this.processes[name] = child;
    children.add(child);
    child.once('exit', () => children.delete(child));
    fs.closeSync(log);
  }

  log(name) {
    return fs.readFileSync(path.join(this.folder, `${name}.log`), 'utf8');
  }

  async beginSim() {
    const ready = path.join(this.folder, 'ready');
    fs.rmSync(ready, {force: true});
    this.run('sim', path.join(this.programs, 'haarlight-sim/haarlight-sim'),
             [this.rig, '--scene', this.scene, '--ready-file', ready, '--cache', this.cache,
              '--commands', this.commands]);
    await until(() => {
      expect(this.processes.sim.exitCode === null, `the simulator ended: ${this.log('sim')}`);
      return fs.existsSync(ready);
    }, 'the simulator', 240);
  }

  async beginDaemon() {
    this.run('daemon', path.join(this.programs, 'haarlightd/haarlightd'), [this.rig]);
    await until(async () => (await fetch(`${this.url}/healthz`)).ok, 'the daemon', 60);
  }

  get url() {
    return `http://127.0.0.1:${this.port}`;
  }

  async state() {
    return (await fetch(`${this.url}/v1/state`)).json();
  }

  /** To the virtual rig: sim/rig_commands.h. */
  order(words) {
    fs.writeFileSync(this.commands, `${words}\n`);
  }

  signal(name, signal) {
    const process = this.processes[name];
    process.kill(signal);
    return process;
  }

  async stop(name, signal = 'SIGTERM') {
    const process = this.processes[name];
    if (process && process.exitCode === null && process.signalCode === null) {
      process.kill('SIGCONT');
      process.kill(signal);
      await new Promise(resolve => process.once('exit', resolve));
    }
    return process?.exitCode;
  }

  async end() {
    const code = await this.stop('daemon');
    await this.stop('sim');
    fs.rmSync(this.folder, {recursive: true, force: true});
    expect(code === 0 || code === undefined || code === null, `the daemon ended with ${code}`);
  }
}

/** Chromium, and pages that note every console error, broken script and foreign request. */
export class Browser {
  async begin(modules) {
    const {chromium} = createRequire(path.join(modules, 'package.json'))('playwright-core');
    const program = ['/usr/bin/chromium', '/usr/bin/chromium-browser'].find(p => fs.existsSync(p));
    expect(program, 'Chromium is not installed');
    this.browser = await chromium.launch({
      executablePath: program,
      args: ['--no-sandbox', '--disable-dev-shm-usage', '--disable-gpu', '--force-color-profile=srgb'],
    });
    this.problems = [];
    this.contexts = [];
    return this;
  }

  /**
   * A fresh page. @param allowed  patterns of console errors that the test provokes
   * @param prepare  called with the page before it is opened
   */
  async page(url, options = {}, allowed = [], prepare = async () => {}) {
    const context = await this.browser.newContext({viewport: {width: 1280, height: 900}, ...options});
    this.contexts.push(context);
    const page = await context.newPage();
    page.setDefaultTimeout(20000);
    page.allowed = allowed;
    page.on('console', message => {
      const text = message.text();
      if (message.type() === 'error' && !page.allowed.some(pattern => pattern.test(text))) {
        this.problems.push(`console: ${text}`);
      }
    });
    page.on('pageerror', error => this.problems.push(`script: ${error.message}`));
    context.on('request', request => {
      const {origin} = new URL(request.url());
      if (origin !== new URL(url).origin && !/^(blob|data):/.test(request.url())) {
        this.problems.push(`foreign request: ${request.url()}`);
      }
    });
    await prepare(page);
    await page.goto(url);
    return page;
  }

  /** After each test, also one that failed. */
  async closePages() {
    await Promise.all(this.contexts.splice(0).map(context => context.close().catch(() => {})));
  }

  async end() {
    await this.browser.close();
  }
}

/** Tests run in order; each prints one line. */
export class Suite {
  constructor(browser, only) {
    this.browser = browser;
    this.only = only;
    this.failed = 0;
    this.run = 0;
  }

  async test(name, body) {
    if (this.only && !name.includes(this.only)) {
      return;
    }
    const begun = Date.now();
    ++this.run;
    try {
      const note = await body();
      console.log(`ok      ${name}${note ? `: ${note}` : ''} (${((Date.now() - begun) / 1000).toFixed(1)} s)`);
    } catch (error) {
      ++this.failed;
      console.log(`FAILED  ${name}: ${error instanceof Failure ? error.message : error.stack}`);
    }
    await this.browser.closePages();
  }
}
