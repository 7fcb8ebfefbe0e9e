// SPDX-License-Identifier: Apache-2.0
// The files of a folder that `haarlight publish` wrote, instead of a server. Every one is checked:
// its length and checksum are known before, so that a server's own "not found" page, a torn copy or
// an old file is told by its name and never shown. docs/reference/http-api.md, "A published folder".

import {ServerError} from './server_error.js';

const mark = document.querySelector('meta[name="haarlight-published"]')?.content.split(' ');

/** Whether files answer; else `haarlight view` does. */
export const isPublished = mark !== undefined;

const kCure = 'copy the published folder to the server again, whole; if it comes back, publish it again: haarlight publish';

const table = Uint32Array.from({length: 256}, (_, n) => {
  for (let bit = 0; bit < 8; ++bit) {
    n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  }
  return n >>> 0;
});

/** The checksum of zip and PNG, as 8 hexadecimal digits. */
export function crc32(bytes) {
  let sum = 0xffffffff;
  for (const byte of bytes) {
    sum = table[(sum ^ byte) & 0xff] ^ (sum >>> 8);
  }
  return ((sum ^ 0xffffffff) >>> 0).toString(16).padStart(8, '0');
}

/** @throws ServerError  naming one of the folder's files */
export function refuse(what, name, status = 0) {
  throw new ServerError(status, {what, where: new URL(name, document.baseURI).href, cure: kCure});
}

/**
 * The bytes of one of the folder's files.
 * @param bytes  that it has; @param checksum  of it, or none where the file's own format has one
 * @throws ServerError  missing, torn, or not this file
 */
export async function fileBytes(name, bytes, checksum, options = {}, version = '') {
  let response;
  try {
    response = await fetch(name + version, options);
  } catch (error) {
    if (options.signal?.aborted) {
      throw error;
    }
    refuse('The web server does not answer a request for a file of this page.', name);
  }
  if (!response.ok) {
    refuse(response.status === 404 ? 'A file of this page is missing.'
      : `The web server answered with status ${response.status} to a request for a file of this page.`, name, response.status);
  }
  let found;
  try {
    found = await response.arrayBuffer();
  } catch (error) {
    if (options.signal?.aborted) {
      throw error;
    }
    refuse('A file of this page arrived incomplete.', name);
  }
  if (found.byteLength !== bytes) {
    refuse(/text\/html/.test(response.headers.get('Content-Type') ?? '')
      ? 'The web server sent a page of its own instead of a file of this page.'
      : `A file of this page has ${found.byteLength} bytes instead of ${bytes}.`, name);
  }
  if (checksum && crc32(new Uint8Array(found)) !== checksum) {
    refuse('A file of this page is damaged.', name);
  }
  return found;
}

/** What keeps a browser from taking an older folder's file for this one's. */
export const versionOf = () => `?${mark[2]}`;

let aboutFound = null;

/** What the folder says of itself. */
export function publishedAbout() {
  aboutFound ??= (async () => {
    const [folder, bytes, checksum] = mark;
    const text = await fileBytes(`${folder}/about.json`, Number(bytes), checksum, {}, versionOf());
    return JSON.parse(new TextDecoder().decode(text));
  })();
  return aboutFound;
}

/** The bytes that the server's path brings: a packed file of the folder. */
export async function publishedBytes(path, options) {
  const name = path.replace(/^\/v1\/\w+\/(?:[0-9a-f]{8,}\/)?/, '');
  const {files} = await publishedAbout();
  const file = `${mark[0]}/${name}.bin`;
  if (files[name] === undefined) {
    refuse('This page and its data are of different versions.', file);
  }
  const packed = await fileBytes(file, files[name], '', options);
  try {
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
    return await new Response(stream).arrayBuffer();
  } catch {
    return refuse('A file of this page is damaged.', file);
  }
}

/** Light weights of an environment at its angles, instead of a Turntable: all of them exact. */
export class PublishedTurns {
  static async open(environment, nLights) {
    const numbers = new Float32Array(await publishedBytes(environment.file));
    return new PublishedTurns(environment, numbers, nLights);
  }

  constructor(environment, numbers, nLights) {
    Object.assign(this, {environment, numbers, nLights});
    this.isExact = true;
  }

  get step() {
    return 360 / this.environment.turns;
  }

  at(degrees) {
    const {colours, turns, missing_share: missing, layout} = this.environment;
    const turn = (Math.round(degrees / this.step) % turns + turns) % turns;
    const weights = Array.from({length: colours}, (_, c) =>
      Float64Array.from(this.numbers.subarray((turn * colours + c) * this.nLights, (turn * colours + c + 1) * this.nLights)));
    return {is_ready: true, weights, layout, missing_share: missing[turn]};
  }

  async fill() {}

  end() {}
}
