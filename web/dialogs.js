// SPDX-License-Identifier: Apache-2.0
// Questions to the user: the warning before light flashes, the token, "are you sure".

import {logIn, wordsOf} from './daemon.js';

const byId = id => document.getElementById(id);
const kToldForMs = 15 * 60 * 1000;
let toldAt = -Infinity;

function answerOf(dialog) {
  return new Promise(resolve => {
    dialog.returnValue = '';
    dialog.addEventListener('close', () => resolve(dialog.returnValue === 'go'), {once: true});
    dialog.showModal();
  });
}

/**
 * The epilepsy warning. @param text  what will flash, how fast, how long
 * @param always  a run asks every time; single lights not again within a quarter of an hour
 */
export async function mayFlash(text, always) {
  if (!always && Date.now() - toldAt < kToldForMs) {
    return true;
  }
  const [told, go] = [byId('warning-told'), byId('warning-go')];
  byId('warning-text').textContent = text;
  told.checked = false;
  go.disabled = true;
  told.onchange = () => (go.disabled = !told.checked);
  const answer = answerOf(byId('warning'));
  told.focus();
  const isGo = await answer && told.checked;
  if (isGo) {
    toldAt = Date.now();
  }
  return isGo;
}

export async function isSure(title, text, action) {
  byId('sure-title').textContent = title;
  byId('sure-text').textContent = text;
  byId('sure-go').textContent = action;
  return answerOf(byId('sure'));
}

let pending = null;

/** Asks for the token until it is right or the user gives up. One dialog for all callers. */
export function askForToken() {
  pending ??= new Promise(resolve => {
    const [dialog, form, input, problem] =
      [byId('login'), byId('login-form'), byId('login-token'), byId('login-error')];
    let isIn = false;
    problem.textContent = '';
    input.value = '';
    form.onsubmit = async event => {
      event.preventDefault();
      try {
        await logIn(input.value.trim());
        isIn = true;
        dialog.close();
      } catch (error) {
        problem.textContent = error.status === 401 ? 'That is not the token.' : wordsOf(error);
        input.select();
      }
    };
    byId('login-cancel').onclick = () => dialog.close();
    dialog.addEventListener('close', () => {
      input.value = '';
      pending = null;
      resolve(isIn);
    }, {once: true});
    dialog.showModal();
  });
  return pending;
}
