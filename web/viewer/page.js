// SPDX-License-Identifier: Apache-2.0
// What both of the viewer's pages do: problems in words, dark and light, files to save.

import {NoGraphics} from './graphics.js';
import {ServerError} from './server.js';

export const byId = id => document.getElementById(id);

/** A published page says that it needs a server until its scripts run. */
export function begun() {
  byId('unserved')?.remove();
}

export const titleOf = ({file, notes}) => notes?.title || (notes ? file : `${file} – haarlight view`);

/** What whoever published it says of the picture; nothing where `haarlight view` shows it. */
export function showNotes({file, notes, published}) {
  if (!notes) {
    return;
  }
  byId('file-name').textContent = notes.title || file;
  const percent = fraction => `${Number((100 * fraction).toPrecision(2))} %`;
  const lines = [
    ['', notes.description], ['By', notes.author], ['Licence', notes.licence],
    ['Photographed', notes.photographed], ['File', notes.title ? file : ''],
    ['Error', published?.error === undefined ? ''
      : `at most ${percent(published.error)} of the capture, over the pictures of all lights together`],
    ['Pictures', published?.words ?? ''],
  ].filter(([, text]) => text);
  byId('notes').replaceChildren(...lines.flatMap(([name, text]) => {
    const [dt, dd] = [document.createElement('dt'), document.createElement('dd')];
    dt.textContent = name;
    dd.textContent = text;
    return name ? [dt, dd] : [dd];
  }));
  byId('notes-card').hidden = lines.length === 0;
}

/**
 * Puts what went wrong on the page; throws again what is our own mistake.
 * @param instead  the command that needs no graphics
 */
export function tellProblem(error, instead) {
  const box = byId('problem');
  box.hidden = false;
  if (error instanceof ServerError) {
    box.textContent = error.message;
  } else if (error instanceof NoGraphics) {
    box.textContent = `${error.message}\nHint: use a current Firefox, Chrome, Edge or Safari with WebGL 2, ` +
      `or \`${instead}\` for single pictures.`;
  } else {
    box.textContent = `The page made a mistake: ${error.message}\nHint: load the page again.`;
    throw error;
  }
}

/** The browser may take the graphics processor away: stop() ends what would use it, tell(error) says so. */
export function watchGraphics(canvas, stop, tell) {
  canvas.addEventListener('webglcontextlost', event => {
    event.preventDefault();
    stop();
    tell(new ServerError(0, {
      what: 'The graphics processor has dropped the page.', where: 'this browser',
      cure: 'load the page again; close other pages if it comes back',
    }));
  });
}

/** The button that changes dark and light; draw() is for what is drawn on canvases. */
export function connectTheme(draw) {
  byId('theme').addEventListener('click', () => {
    const root = document.documentElement;
    const isDark = root.dataset.theme ? root.dataset.theme === 'dark'
      : !matchMedia('(prefers-color-scheme: light)').matches;
    root.dataset.theme = isDark ? 'light' : 'dark';
    draw();
  });
}

/** A word as a shell takes it. */
export const shellWord = text => /^[\w./=+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;

/** @param pixels  {width, height, data}: RGBA, rows from the top */
export function pngOf({width, height, data}) {
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext('2d').putImageData(new ImageData(data, width, height), 0, 0);
  return canvas.convertToBlob({type: 'image/png'});
}

export function save(blob, name) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
