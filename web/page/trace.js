// SPDX-License-Identifier: Apache-2.0
// The newest messages, decoded; filter, pause, download; histograms of messages that pass the filter.
import { Histogram } from './charts.js';
import { describe } from './decode.js';
import { $, csv, element, keep, save, setText, stamp } from './dom.js';
import { shown } from './shown.js';
import { byText, clock } from './words.js';

const ROWS = 150;
const MAX_TYPES = 50;

export class TraceView {
  constructor(model) {
    Object.assign(this, { model, isPaused: false, held: null, gaps: new Histogram(), delays: new Histogram(), before: new Map(), types: new Set() });
    for (const id of ['trace-robot', 'trace-type', 'trace-text']) {
      $(id).addEventListener('input', () => {
        this.recount();
        this.draw();
      });
    }
    $('pause').addEventListener('click', () => this.pause());
    $('trace-clear').addEventListener('click', () => this.clear());
    $('download').addEventListener('click', () => this.download());
  }

  filter() {
    const [robot, type, text] = [$('trace-robot').value, $('trace-type').value, $('trace-text').value.toLowerCase()];
    return (row) => (!robot || row.robot === robot) && (!type || row.type === type) &&
      (!text || row.message.topic.toLowerCase().includes(text) || this.text(row).toLowerCase().includes(text));
  }
  text(row) {
    row.text ??= describe(row.message, row.type);
    return row.text;
  }

  // ---- histograms
  take(row) {
    if (row.type && !this.types.has(row.type) && this.types.size < MAX_TYPES) {
      this.types.add(row.type);
      $('trace-type').append(element('option', { value: row.type }, row.type));
    }
    this.isCounting ??= this.filter();
    if (this.isCounting(row)) this.count(row);
  }
  count({ from, message }) {
    if (from !== 'robot' || message.retain) return;
    const before = this.before.get(message.topic);
    if (before !== undefined && message.at >= before) this.gaps.add(message.at - before);
    if (this.before.size < 5000 || before !== undefined) this.before.set(message.topic, message.at);
    const received = Date.parse(message.received_at);
    if (received) this.delays.add(message.at - received);
  }
  recount() {
    this.isCounting = this.filter();
    this.gaps.clear();
    this.delays.clear();
    this.before.clear();
    for (const row of this.model.messages) if (this.isCounting(row)) this.count(row);
  }

  // ---- the user's actions
  pause() {
    this.isPaused = !this.isPaused;
    this.held = this.isPaused ? this.model.messages.slice() : null;
    $('pause').setAttribute('aria-pressed', this.isPaused);
    setText($('pause'), this.isPaused ? 'Go on' : 'Pause');
    this.draw();
  }
  clear() {
    this.model.messages = [];
    this.held = this.isPaused ? [] : null;
    this.recount();
    this.draw();
  }
  download() {
    const rows = (this.held ?? this.model.messages).filter(this.filter());
    const lines = rows.map((row) => [new Date(row.message.at).toISOString(), row.from, row.robot, row.type, row.message.topic, row.message.encoding,
      typeof row.message.payload === 'string' ? row.message.payload : JSON.stringify(row.message.payload), this.text(row)].map(csv).join(','));
    save(`trace-${stamp()}.csv`, new Blob(['time,from,robot,type,topic,encoding,payload,content\n', lines.join('\n'), '\n'], { type: 'text/csv' }));
  }

  draw() {
    this.drawRobots();
    const all = this.held ?? this.model.messages;
    const wanted = this.filter();
    const rows = [];
    for (let i = all.length - 1; i >= 0 && rows.length < ROWS; i--) if (wanted(all[i])) rows.push(all[i]);
    const body = $('messages').tBodies[0];
    keep(body, rows.length, () => element('tr', {}, ...Array.from({ length: 5 }, () => element('td'))));
    rows.forEach((row, i) => this.fill(body.rows[i], row));
    setText($('trace-count'), `${rows.length} of ${all.length} kept messages${this.isPaused ? ', paused' : ''}${this.model.lost ? `; ${this.model.lost} were lost, this page is too slow` : ''}`);
    this.drawCharts();
  }
  drawRobots() {
    if (this.known === this.model.roster) return;
    this.known = this.model.roster;
    const select = $('trace-robot');
    const names = [...this.model.robots.keys()].sort(byText);
    const chosen = select.value;
    select.replaceChildren(select.firstElementChild, ...names.map((name) => element('option', { value: name }, name)));
    select.value = chosen;
  }
  fill(line, row) {
    const isBad = ['timeout', 'refused'].includes(row.message.payload?.outcome) || row.type === 'rejected';
    line.className = row.from === 'to robot' ? 'down' : isBad ? 'wrong' : '';
    const mesh = row.message.mesh ? ` (${row.message.mesh})` : '';
    const said = this.text(row);
    [clock(row.message.at), row.from + mesh, row.robot, row.type, said].forEach((text, i) => setText(line.cells[i], text));
    const topic = shown(row.message.topic);
    if (line.title !== topic) line.title = topic;
  }
  drawCharts() {
    const gaps = this.gaps.summary();
    const delays = this.delays.summary();
    const show = (s) => `n ${s.n} · mean ${s.mean.toFixed(1)} · p50 ${s.p50.toFixed(0)} · p99 ${s.p99.toFixed(0)} ms`;
    setText($('gap-words'), gaps ? `${show(gaps)} · ${lossWords(gaps)}` : 'nothing yet');
    setText($('delay-words'), delays ? `gateway to here: ${show(delays)}` : 'needs MQTT 5');
    this.gaps.draw($('gaps'), gaps);
    this.delays.draw($('delays'), delays);
  }
}

// Counts losses as the thesis does: a gap of twice the usual interval is one lost message.
function lossWords({ sorted, n, p50 }) {
  if (!(p50 > 0)) return '';
  const lost = sorted.reduce((sum, gap) => sum + Math.max(0, Math.round(gap / p50) - 1), 0);
  return `lost by gaps ${(100 * lost / (lost + n)).toFixed(1)} %`;
}
