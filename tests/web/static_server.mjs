// The plainest web server there is: files of a folder, no ranges, below any path; it can be told to lie.

import {spawn} from 'node:child_process';
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';

const kTypes = {'.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.svg': 'image/svg+xml',
                '.json': 'application/json', '.png': 'image/png', '.jpg': 'image/jpeg'};

export class StaticServer {
  /** @param at  the sub-path of the site, "/" or "/lab/coin/" */
  async begin(folder, at = '/') {
    this.asked = [];
    this.lie = () => null;  // (name, bytes) → {status, type, bytes} or null: the truth
    this.server = http.createServer((request, response) => {
      const name = decodeURIComponent(new URL(request.url, 'http://x').pathname).slice(at.length) || 'index.html';
      const file = path.join(folder, path.normalize(name));
      const isThere = request.url.startsWith(at) && file.startsWith(folder) && fs.existsSync(file);
      const bytes = isThere ? fs.readFileSync(file) : null;
      this.asked.push({name, bytes: bytes?.length ?? 0});
      const lie = this.lie(name, bytes);
      const type = lie?.type ?? kTypes[path.extname(name)] ?? 'application/octet-stream';
      const status = lie?.status ?? (isThere ? 200 : request.url === '/favicon.ico' ? 204 : 404);
      response.writeHead(status, {'Content-Type': type});
      response.end(lie?.bytes ?? bytes ?? 'not found');
    });
    await new Promise(resolve => this.server.listen(0, '127.0.0.1', resolve));
    this.url = `http://127.0.0.1:${this.server.address().port}${at}`;
    return this;
  }

  end() {
    this.server.closeAllConnections();
    return new Promise(resolve => this.server.close(resolve));
  }
}

/** `python3 -m http.server`. @return  {url, end()} */
export function pythonServer(folder) {
  const child = spawn('python3', ['-u', '-m', 'http.server', '0', '--bind', '127.0.0.1', '--directory', folder],
                      {stdio: ['ignore', 'pipe', 'ignore']});
  process.on('exit', () => child.kill('SIGKILL'));
  return new Promise((resolve, reject) => {
    child.once('error', reject);
    child.stdout.on('data', text => {
      const port = /port (\d+)/.exec(text);
      if (port) {
        resolve({url: `http://127.0.0.1:${port[1]}/`, end: () => child.kill('SIGKILL')});
      }
    });
  });
}
