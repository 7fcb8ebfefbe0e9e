// SPDX-License-Identifier: Apache-2.0
// Requests to `haarlight view`, or, in a published folder, to its files; and what went wrong in words.

import {isPublished, publishedAbout, publishedBytes} from './published.js';
import {ServerError} from './server_error.js';

export {ServerError} from './server_error.js';
export {isPublished} from './published.js';

/** @throws ServerError  the server's own words, or that it is gone */
export async function ask(path, options = {}) {
  let response;
  try {
    response = await fetch(path, options);
  } catch {
    throw new ServerError(0, {
      what: 'The viewer does not answer.', where: location.origin,
      cure: 'start haarlight view again, and open the address that it prints',
    });
  }
  if (!response.ok) {
    const words = await response.json().catch(() => null);
    throw new ServerError(response.status, words?.error ?? {
      what: `The server answered with status ${response.status}.`, where: path,
      cure: 'start haarlight view again, and open the address that it prints',
    });
  }
  return response;
}

/** What the file is that is shown. */
export const askAbout = async path => isPublished ? publishedAbout() : askJson(path);
export const askJson = async (path, options) => (await ask(path, options)).json();
export const askBytes = async (path, options) =>
  isPublished ? publishedBytes(path, options) : (await ask(path, options)).arrayBuffer();
