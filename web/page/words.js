// SPDX-License-Identifier: Apache-2.0
// Shows values in words.
export const byText = new Intl.Collator(undefined, { numeric: true }).compare; // robot2 before robot10
export const meshNames = { __proto__: null, ble: 'BLE Mesh', thread: 'Thread' };
export const number = (value, digits = 0) => (Number.isFinite(value) ? value.toFixed(digits) : '–');
export const ms = (us) => (Number.isFinite(us) ? `${(us / 1000).toFixed(us < 10000 ? 1 : 0)} ms` : '–');
export const dbm = (value) => (Number.isFinite(value) ? `${value} dBm` : '–');
export const bytes = (value) => (!Number.isFinite(value) ? '–' : value < 1e6 ? `${(value / 1024).toFixed(0)} KiB` : `${(value / 1048576).toFixed(1)} MiB`);

export function age(time) {
  if (!(time >= 0)) return '–';
  const seconds = time / 1000;
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} days`;
}
const two = (value) => String(value).padStart(2, '0');
// Returns "14:02", with the date in front if the day is not today.
export function hourOf(time, now) {
  const at = new Date(time);
  const day = at.toDateString() === new Date(now).toDateString() ? '' : `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} `;
  return `${day}${two(at.getHours())}:${two(at.getMinutes())}`;
}
export function clock(time) {
  const at = new Date(time);
  return `${two(at.getHours())}:${two(at.getMinutes())}:${two(at.getSeconds())}.${String(at.getMilliseconds()).padStart(3, '0')}`;
}

// Describes the program's decision about a robot or gateway (web/server/roster.hpp): "unknown since 14:02".
export function lifeWords(life, now) {
  if (!life) return 'unknown';
  return ['unknown', 'gone', 'silent'].includes(life.state) && life.since ? `${life.state} since ${hourOf(life.since, now)}` : life.state;
}
export function stateWords(robot, now) {
  const trouble = robot.state === 'online' && ['contested', 'deaf'].find((word) => robot.best?.[word] === true);
  return trouble || lifeWords(robot.life, now);
}
export function outcomeWords(command) {
  if (!command.outcome) return 'on its way …';
  const after = Number.isFinite(command.after) ? ` after ${command.after} ms` : '';
  return `${command.outcome}${after}${command.why ? `: ${command.why}` : ''}`;
}
