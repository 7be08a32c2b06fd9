// SPDX-License-Identifier: Apache-2.0
// What the browser tests stand on: Mosquitto, slam-gatewayd, simulated robots, slam-gateway-web and Chromium, all real, on
// free ports of loopback in a directory of their own.
import { execFile, spawn } from 'node:child_process';
import { existsSync, mkdtempSync, openSync, rmSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import net from 'node:net';
import dgram from 'node:dgram';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { setTimeout as sleep } from 'node:timers/promises';
import { promisify } from 'node:util';

const { chromium } = createRequire(process.env.SLAMGW_TOOLS + '/')('playwright-core');
export const bin = process.env.SLAMGW_BIN;
export const keepDirectory = process.env.SLAMGW_KEEP;
export const token = 'a-token-of-the-tests-0123456789';
const run = promisify(execFile);
export const PATIENCE_MS = Number(process.env.SLAMGW_PATIENCE_MS ?? 90000); // machines are shared; a passing test never waits for it

export async function eventually(what, check) {
  const end = Date.now() + PATIENCE_MS;
  let last;
  while (Date.now() < end) {
    last = await check();
    if (last) return last;
    await sleep(50);
  }
  throw new Error(`never: ${what} (last: ${JSON.stringify(last)})`);
}

const freeTcp = () => new Promise((resolve) => {
  const server = net.createServer().listen(0, '127.0.0.1', () => {
    const { port } = server.address();
    server.close(() => resolve(port));
  });
});
const freeUdp = () => new Promise((resolve) => {
  const socket = dgram.createSocket('udp4').bind(0, '127.0.0.1', () => {
    const { port } = socket.address();
    socket.close(() => resolve(port));
  });
});
const answers = (port) => new Promise((resolve) => {
  const socket = net.connect(port, '127.0.0.1', () => resolve(socket.destroy() && true)).on('error', () => resolve(false));
});

export class World {
  static async start(options = {}) {
    const world = new World();
    await world.build(options);
    return world;
  }

  async build({ thread = 3, ble = 3, origins = {}, daemon = true }) {
    this.directory = mkdtempSync(join(tmpdir(), 'slam-gateway-web-'));
    this.processes = new Map();
    // A run that is interrupted leaves nothing behind.
    process.on('exit', () => this.processes.forEach((child) => child.kill('SIGKILL')));
    for (const signal of ['SIGINT', 'SIGTERM']) process.on(signal, () => process.exit(1));
    this.ports = { broker: await freeTcp(), web: await freeTcp(), watching: await freeTcp(), mqttsn: await freeUdp(), strictBroker: await freeTcp(), strict: await freeTcp() };
    this.write('mosquitto.conf', `listener ${this.ports.broker} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\nmax_queued_messages 100000\n`);
    writeFileSync(join(this.directory, 'token'), token + '\n', { mode: 0o600 });
    const robots = [...Array(ble).keys()].map((i) => ({ id: `robot${thread + i + 1}`, ble_address: `0x01${String(i).padStart(2, '0')}` }));
    for (const [id, origin] of Object.entries(origins)) robots.push({ id, origin });
    const config = (web, broker = this.ports.broker) => JSON.stringify({
      gateway: { id: 'here' }, broker: { uri: `mqtt://127.0.0.1:${broker}` }, robots,
      ble_mesh: { enabled: ble > 0, device: join(this.directory, 'board') },
      mqttsn: { listen: [`127.0.0.1:${this.ports.mqttsn}`], multicast_group: null },
      store: { directory: join(this.directory, 'store') }, control: { socket: join(this.directory, 'control.sock') }, web,
    });
    this.write('gateway.json', config({ listen: `127.0.0.1:${this.ports.web}`, token_file: 'token' }));
    this.write('watching.json', config({ listen: `127.0.0.1:${this.ports.watching}` }));
    this.write('strict.json', config({ listen: `127.0.0.1:${this.ports.strict}` }, this.ports.strictBroker));
    await this.startBroker();
    await Promise.all([this.startWeb('web', 'gateway.json'), this.startWeb('watching', 'watching.json')]);
    if (daemon) this.startDaemon();
    if (ble) this.spawn('ble', join(bin, 'slam-gateway-sim'), ['ble', '--tty', join(this.directory, 'board'), '--robots', String(ble), '--seed', '7']);
    if (thread) this.spawn('thread', join(bin, 'slam-gateway-sim'), ['thread', '--gateway', `127.0.0.1:${this.ports.mqttsn}`, '--robots', String(thread), '--seed', '7']);
    this.browser = await chromium.launch({
      executablePath: '/usr/bin/chromium',
      args: ['--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
        '--disable-component-update', '--disable-sync', '--host-resolver-rules=MAP evil.test 127.0.0.1'],
    });
  }

  write(name, text) { writeFileSync(join(this.directory, name), text); }
  spawn(name, program, args) {
    const log = openSync(join(this.directory, name + '.log'), 'a');
    const child = spawn(program, args, { cwd: this.directory, stdio: ['ignore', log, log] });
    child.ended = new Promise((resolve) => child.on('exit', resolve));
    this.processes.set(name, child);
    return child;
  }
  async end(name, signal = 'SIGTERM') {
    const child = this.processes.get(name);
    this.processes.delete(name);
    child?.kill(signal);
    await child?.ended;
  }
  async startBroker() {
    this.spawn('broker', 'mosquitto', ['-c', join(this.directory, 'mosquitto.conf')]);
    await eventually('the broker listens', () => answers(this.ports.broker));
  }
  async startWeb(name = 'web', file = 'gateway.json') {
    this.spawn(name, join(bin, 'slam-gateway-web'), ['--config', join(this.directory, file)]);
    await eventually('slam-gateway-web listens', () => answers(this.ports[name]));
  }
  // Starts a broker that refuses subscriptions in SUBACK, and the program on it.
  async startStrict() {
    this.write('rights.json', JSON.stringify({ defaultACLAccess: { publishClientSend: true, publishClientReceive: true, subscribe: false, unsubscribe: true } }));
    const plugin = ['/usr/lib/x86_64-linux-gnu', '/usr/lib/aarch64-linux-gnu', '/usr/lib'].map((place) => `${place}/mosquitto_dynamic_security.so`).find(existsSync);
    this.write('strict.conf', `listener ${this.ports.strictBroker} 127.0.0.1\nallow_anonymous true\nplugin ${plugin}\nplugin_opt_config_file ${join(this.directory, 'rights.json')}\n`);
    this.spawn('strictBroker', 'mosquitto', ['-c', join(this.directory, 'strict.conf')]);
    await eventually('the strict broker listens', () => answers(this.ports.strictBroker));
    await this.startWeb('strict', 'strict.json');
    return `http://127.0.0.1:${this.ports.strict}/`;
  }
  startDaemon() {
    this.spawn('daemon', join(bin, 'slam-gatewayd'), ['--config', join(this.directory, 'gateway.json')]);
  }
  // A second gateway, `there`, and two robots that wait to be let in.
  startClosedMesh() {
    const file = (name) => join(this.directory, name);
    this.write('there.json', JSON.stringify({
      gateway: { id: 'there' }, broker: { uri: `mqtt://127.0.0.1:${this.ports.broker}` }, mqttsn: { enabled: false },
      ble_mesh: { enabled: true, device: file('board-there'), provisioning: { enabled: false, over_mqtt: true } },
      store: { directory: file('store-there') }, control: { socket: file('there.sock') },
    }));
    this.spawn('there', join(bin, 'slam-gatewayd'), ['--config', file('there.json')]);
    this.spawn('new-robots', join(bin, 'slam-gateway-sim'), ['ble', '--tty', file('board-there'), '--robots', '2', '--unprovisioned', '--rate', '2']);
  }
  async endClosedMesh(robots) {
    await this.end('new-robots');
    await this.end('there');
    for (const robot of robots) await this.publish(`ntnu-slam/gateway/there/robots/${robot}`, '', '-r');
    await this.publish('ntnu-slam/gateway/there/state', '', '-r');
  }
  async stop() {
    await this.browser?.close();
    for (const name of [...this.processes.keys()].reverse()) await this.end(name);
    rmSync(this.directory, { recursive: true, force: true });
  }

  get url() { return `http://127.0.0.1:${this.ports.web}/`; }
  get watchingUrl() { return `http://127.0.0.1:${this.ports.watching}/`; }

  // ---- the broker's side
  async publish(topic, payload, ...options) {
    const isEmpty = payload.length === 0;
    const child = run('mosquitto_pub', ['-p', String(this.ports.broker), '-q', '1', '-t', topic, isEmpty ? '-n' : '-s', ...options]);
    if (isEmpty) child.child.stdin.destroy(); // it reads nothing then, and may have ended already
    else child.child.stdin.end(payload);
    await child;
  }
  // Many at once, over one MQTT 3.1.1 connection at QoS 0: [topic, payload] each.
  async publishMany(messages) {
    const text = (value) => {
      const octets = Buffer.from(value);
      return Buffer.concat([Buffer.from([octets.length >> 8, octets.length & 255]), octets]);
    };
    const packet = (type, ...parts) => {
      const body = Buffer.concat(parts);
      const length = [];
      for (let left = body.length; ; left >>= 7) {
        length.push(left & 127 | (left > 127 ? 128 : 0));
        if (left <= 127) break;
      }
      return Buffer.concat([Buffer.from([type, ...length]), body]);
    };
    const socket = net.connect(this.ports.broker, '127.0.0.1');
    socket.write(packet(0x10, text('MQTT'), Buffer.from([4, 2, 0, 0]), text('')));
    await new Promise((resolve, reject) => socket.once('data', resolve).once('error', reject));
    for (const [topic, payload] of messages) socket.write(packet(0x30, text(topic), Buffer.from(payload)));
    socket.end(packet(0xe0));
    await new Promise((resolve) => socket.once('close', resolve).resume());
  }
  // int16 pairs, as a robot sends them
  static positions(...numbers) {
    const octets = Buffer.alloc(numbers.length * 2);
    numbers.forEach((number, i) => octets.writeInt16LE(number, i * 2));
    return octets;
  }
  async update(robot, ...numbers) { await this.publish(`ntnu-slam/robot/${robot}/update`, World.positions(...numbers)); }
  // Lines "topic hex" from now on; .stop() ends it.
  async subscribe(filter) {
    const lines = [];
    const child = spawn('stdbuf', ['-oL', 'mosquitto_sub', '-d', '-p', String(this.ports.broker), '-t', filter, '-F', '%t %x'], { stdio: ['ignore', 'pipe', 'ignore'] });
    let rest = '';
    let stands = false;
    child.stdout.on('data', (text) => {
      const parts = (rest + text).split('\n');
      rest = parts.pop();
      for (const line of parts) {
        if (line.startsWith('Subscribed')) stands = true;
        if (line.startsWith('ntnu-slam/')) lines.push(line);
      }
    });
    await eventually('the subscription stands', () => stands);
    return { lines, stop: () => child.kill() };
  }

  // ---- the browser's side
  async open({ url = this.url, view = 'map', width = 1280, height = 800, unlocked = false, ...options } = {}) {
    const context = await this.browser.newContext({ viewport: { width, height }, acceptDownloads: true, ...options });
    const page = await context.newPage();
    page.setDefaultTimeout(PATIENCE_MS);
    page.errors = [];
    page.on('pageerror', (error) => page.errors.push(error.message));
    page.on('console', (message) => message.type() === 'error' && page.errors.push(message.text()));
    page.on('dialog', (dialog) => {
      page.errors.push(`dialog: ${dialog.message()}`);
      dialog.dismiss();
    });
    await page.goto(`${url}#${view}`);
    await page.waitForFunction(() => window.slamgw?.model.isOpen);
    if (unlocked) await this.unlock(page);
    return page;
  }
  async unlock(page) {
    await page.click('#unlock');
    await page.fill('#token', token);
    await page.click('#token-form .main');
    await page.waitForFunction(() => window.slamgw.model.maySend);
  }
  async metric(name, url = this.url) {
    const text = await (await fetch(url + 'metrics')).text();
    const line = text.split('\n').find((each) => each.startsWith(name + ' ') || each.startsWith(name + '{'));
    return line ? Number(line.split(' ').pop()) : null;
  }
}
