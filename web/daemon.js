// SPDX-License-Identifier: Apache-2.0
// The daemon's HTTP interface as the page uses it: requests, errors in words, the login, and the
// link that knows whether what is shown is live.

export class DaemonError extends Error {
  constructor(status, error) {
    super(error.what || `the daemon answered ${status}`);
    this.status = status;
    this.where = error.where || '';
    this.cure = error.cure || '';
  }
  get words() {
    return this.cure ? `${this.message}\n${this.cure}` : this.message;
  }
}

/** Called when the daemon requires its token; resolves to true once logged in. */
let askForToken = async () => false;
export function setLogin(ask) {
  askForToken = ask;
}

// A browser keeps six connections to one server. All-off must not wait behind five pictures.
const kUrgent = 'given up for an urgent request';
const underWay = new Set();

function freeTheLine() {
  for (const controller of underWay) {
    controller.abort(kUrgent);
  }
}

async function send(path, options, patienceMs) {
  const controller = new AbortController();
  const timer = setTimeout(() => controller.abort(), patienceMs);
  underWay.add(controller);
  try {
    return await fetch(path, {...options, signal: controller.signal, cache: 'no-store'});
  } finally {
    clearTimeout(timer);
    underWay.delete(controller);
  }
}

/** @throws DaemonError, or TypeError/AbortError when nobody answers */
async function ask(path, options = {}, patienceMs = 10000) {
  let response = await send(path, options, patienceMs);
  if (response.status === 401 && await askForToken()) {
    response = await send(path, options, patienceMs);
  }
  if (!response.ok) {
    const body = await response.json().catch(() => ({}));
    throw new DaemonError(response.status, body.error || {});
  }
  return response;
}

export const get = async (path, patienceMs) => (await ask(path, {}, patienceMs)).json();
export const getBlob = async path => (await ask(path)).blob();
export async function post(path, body, patienceMs) {
  const text = body === undefined || typeof body === 'string' ? body : JSON.stringify(body);
  return (await ask(path, {method: 'POST', body: text}, patienceMs)).json();
}

/** All-off: every other request is abandoned for it. */
export function postUrgent(path) {
  freeTheLine();
  return post(path, undefined, kPatienceMs);
}

/** @throws DaemonError when the token is wrong */
export async function logIn(token) {
  const response = await send('/v1/login', {method: 'POST', body: token}, 10000);
  if (!response.ok) {
    const body = await response.json().catch(() => ({}));
    throw new DaemonError(response.status, body.error || {});
  }
}

/** Words for any error of the functions above. */
export function wordsOf(error) {
  if (error instanceof DaemonError) {
    return error.words;
  }
  if (error === kUrgent) {
    return 'Given up: all lights off went first.';
  }
  return 'The daemon does not answer. Is haarlightd running, and this machine connected to it?';
}

const kKinds = ['state', 'fault', 'retry', 'light', 'controller', 'committed', 'finished', 'error'];
const kPollMs = 1000;
const kMinGapMs = 200;
const kPatienceMs = 3000;
const kOldMs = 5000;  // an answer older than this is no longer live

/**
 * Follows the daemon: news arrive by server-sent events and make the link ask for the whole state
 * at once; it asks every second besides. `handlers`: state(json), event(kind, data), lost(since),
 * found(). What was shown before lost() is old until found().
 */
export class Link {
  constructor(handlers) {
    this.handlers = handlers;
    this.isLive = null;  // not known yet
    this.lastAnswer = 0;
    this.isAsking = false;
    this.wantsMore = false;
    this.timer = null;
    this.source = null;
  }

  start() {
    this.shareEvents();
    this.poll();
    setInterval(() => this.checkAge(), 1000);
    document.addEventListener('visibilitychange', () => {
      if (!document.hidden) {
        this.checkAge();
        this.soon();
      }
    });
  }

  /** Whatever keeps an answer away: what is shown grows old. */
  checkAge() {
    if (this.isLive && Date.now() - this.lastAnswer > kOldMs) {
      this.isLive = false;
      this.handlers.lost(this.lastAnswer);
    }
  }

  /**
   * One page of all that are open listens and tells the others: each listener keeps one of the
   * browser's six connections. Where a page may not take a lock (no secure context) each listens
   * for itself while it can be seen.
   */
  shareEvents() {
    if (navigator.locks && 'BroadcastChannel' in window) {
      this.channel = new BroadcastChannel('haarlight-events');
      this.channel.onmessage = event => this.take(event.data.kind, event.data.data);
      navigator.locks.request('haarlight-events', () => new Promise(() => this.listen()));
      return;
    }
    const follow = () => {
      if (document.hidden) {
        this.source?.close();
        this.source = null;
      } else {
        this.listen();
      }
    };
    document.addEventListener('visibilitychange', follow);
    follow();
  }

  take(kind, data) {
    this.handlers.event(kind, data);
    this.soon();
  }

  listen() {
    this.source?.close();
    const source = new EventSource('/v1/events');
    this.source = source;
    for (const kind of kKinds) {
      source.addEventListener(kind, event => {
        if (event.data === undefined) {
          return;  // the connection, not the daemon's word "error"
        }
        let data = {};
        try {
          data = JSON.parse(event.data);
        } catch { /* a line of another version */ }
        this.channel?.postMessage({kind, data});
        this.take(kind, data);
      });
    }
    source.onerror = () => {
      this.soon();  // the state's answer decides whether we are cut off
      if (source.readyState === EventSource.CLOSED) {
        setTimeout(() => this.source === source && this.listen(), 2000);
      }
    };
  }

  /** Ask now, but not more than five times a second. */
  soon() {
    if (this.isAsking) {
      this.wantsMore = true;
      return;
    }
    const wait = Math.max(0, kMinGapMs - (performance.now() - this.lastAsked));
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.poll(), wait || 0);
  }

  async poll() {
    clearTimeout(this.timer);
    this.isAsking = true;
    this.wantsMore = false;
    this.lastAsked = performance.now();
    try {
      const state = await get('/v1/state', kPatienceMs);
      this.lastAnswer = Date.now();
      if (this.isLive !== true) {
        this.isLive = true;
        this.handlers.found();
      }
      await this.handlers.state(state);
    } catch (error) {
      if (error === kUrgent) {
        this.wantsMore = true;
      } else if (!(error instanceof DaemonError) && this.isLive !== false) {
        this.isLive = false;
        this.handlers.lost(this.lastAnswer);
      } else if (error instanceof DaemonError && error.status !== 401) {
        this.handlers.refused?.(error);
      }
    }
    this.isAsking = false;
    const wait = this.wantsMore ? kMinGapMs : kPollMs;
    this.timer = setTimeout(() => this.poll(), wait);
  }
}
