// SPDX-License-Identifier: Apache-2.0
// Describes payloads in words. `update` and `cmd` are little-endian int16 pairs in centimetres.
const signed = (hex, at) => {
  const low = parseInt(hex.substr(at, 2), 16);
  const high = parseInt(hex.substr(at + 2, 2), 16);
  return ((high << 8 | low) << 16) >> 16;
};

// Accepts only the range of int16, also in JSON: far beyond it, a step on the map no longer changes a coordinate.
const isPlace = (number) => Number.isFinite(number) && Math.abs(number) <= 32768;

// Returns {x, y, obstacles: [x, y, ...]} or null. The payload is 4 + 4n octets, n = 0..4, with at most one stray octet at the
// end; or JSON.
export function decodeUpdate(message) {
  const hex = message.payload;
  if (message.encoding === 'hex') {
    const octets = hex.length / 2;
    if (octets < 4 || octets > 21 || octets % 4 > 1) return null;
    const obstacles = [];
    for (let at = 8; at + 8 <= hex.length; at += 8) obstacles.push(signed(hex, at), signed(hex, at + 4));
    return { x: signed(hex, 0), y: signed(hex, 4), obstacles };
  }
  try {
    const { x, y, obstacles = [] } = JSON.parse(hex);
    const flat = obstacles.slice(0, 4).flatMap((o) => [o.x, o.y]);
    return [x, y, ...flat].every(isPlace) ? { x, y, obstacles: flat } : null;
  } catch {
    return null;
  }
}

export function encodeCmd(x, y) {
  const octets = new DataView(new ArrayBuffer(4));
  octets.setInt16(0, x, true);
  octets.setInt16(2, y, true);
  return Array.from(new Uint8Array(octets.buffer), (o) => o.toString(16).padStart(2, '0')).join('');
}

const pairs = (flat) => {
  const words = [];
  for (let i = 0; i < flat.length; i += 2) words.push(`(${flat[i]}, ${flat[i + 1]})`);
  return words.join(' ');
};

// Returns one line of text for any message.
export function describe(message, type) {
  if (message.bytes !== undefined) return `${message.bytes} octets, too long to show`;
  if (type === 'update') {
    const update = decodeUpdate(message);
    if (update) return `x ${update.x}  y ${update.y}  ${update.obstacles.length ? 'sees ' + pairs(update.obstacles) : 'sees nothing'}`;
  }
  if (type === 'cmd' && message.encoding === 'hex' && message.payload.length === 8)
    return `go to ${pairs([signed(message.payload, 0), signed(message.payload, 4)])}`;
  if (message.encoding === 'hex') return message.payload.replace(/(..)/g, '$1 ').trim() || '(empty)';
  if (message.encoding !== 'json') return message.payload;
  const said = message.payload;
  if (said && said.outcome) return `${said.type}: ${said.outcome}${said.after_ms === undefined ? '' : ` after ${said.after_ms} ms`}${said.why ? `, ${said.why}` : ''}`;
  return JSON.stringify(said);
}
