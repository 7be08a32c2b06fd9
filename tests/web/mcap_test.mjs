// SPDX-License-Identifier: Apache-2.0
// The MCAP file of robots' places and points, read back by a reader of the test's own that takes nothing but what
// https://mcap.dev/spec allows, and decodes CDR by the schemas that the file itself has.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { mcap } from '../../web/page/mcap.js';
import { Robot } from '../../web/page/model.js';

const MAGIC = '894d434150300d0a';

class Reader {
  constructor(octets) { this.octets = octets; this.at = 0; }
  take(size) {
    assert.ok(this.at + size <= this.octets.length, 'beyond the end');
    this.at += size;
    return this.octets.subarray(this.at - size, this.at);
  }
  u8() { return this.take(1)[0]; }
  u16() { return this.take(2).readUInt16LE(); }
  u32() { return this.take(4).readUInt32LE(); }
  u64() { return this.take(8).readBigUInt64LE(); }
  text() { return new TextDecoder('utf-8', { fatal: true }).decode(this.take(this.u32())); }
  map(key, value) {
    const inner = new Reader(this.take(this.u32()));
    const entries = [];
    while (inner.at < inner.octets.length) entries.push([inner[key](), inner[value]()]);
    return Object.fromEntries(entries);
  }
  end() { assert.equal(this.at, this.octets.length, 'octets are left'); }
}
const RECORDS = {
  1: (r) => ({ profile: r.text(), library: r.text() }),
  2: (r) => ({ summaryStart: r.u64(), offsetStart: r.u64(), crc: r.u32() }),
  3: (r) => ({ id: r.u16(), name: r.text(), encoding: r.text(), text: r.text() }),
  4: (r) => ({ id: r.u16(), schema: r.u16(), topic: r.text(), encoding: r.text(), metadata: r.map('text', 'text') }),
  5: (r) => ({ channel: r.u16(), sequence: r.u32(), logged: r.u64(), published: r.u64(), data: r.take(r.octets.length - r.at) }),
  11: (r) => ({ messages: r.u64(), schemas: r.u16(), channels: r.u32(), attachments: r.u32(), metadata: r.u32(), chunks: r.u32(), from: r.u64(), to: r.u64(), counts: r.map('u16', 'u64') }),
  15: (r) => ({ crc: r.u32() }),
};
function readMcap(octets) {
  assert.equal(octets.subarray(0, 8).toString('hex'), MAGIC);
  assert.equal(octets.subarray(-8).toString('hex'), MAGIC);
  const file = new Reader(octets.subarray(0, -8));
  file.take(8);
  const records = [];
  while (file.at < file.octets.length) {
    const [at, kind, size] = [file.at, file.u8(), file.u64()];
    assert.ok(RECORDS[kind], `record ${kind}`);
    const content = new Reader(file.take(Number(size)));
    records.push({ at, kind, ...RECORDS[kind](content) });
    content.end();
  }
  const kinds = records.map(({ kind }) => kind);
  assert.match(kinds.join(' '), /^1( 3| 4| 5)+ 15( 3| 4)+ 11 2$/, 'data section, DataEnd, summary section, footer');
  const end = kinds.indexOf(15);
  const of = (kind, all) => all.filter((record) => record.kind === kind);
  const [data, summary] = [records.slice(0, end), records.slice(end + 1)];
  assert.equal(records.at(-1).summaryStart, BigInt(summary[0].at));
  const bare = ({ at, ...rest }) => rest;
  for (const kind of [3, 4]) assert.deepEqual(of(kind, summary).map(bare), of(kind, data).map(bare));
  const schemas = new Map(of(3, data).map((schema) => [schema.id, schema]));
  const channels = new Map(of(4, data).map((channel) => [channel.id, channel]));
  const messages = of(5, data).map((message) => ({ ...message, ...decoded(message, channels, schemas) }));
  const [totals] = of(11, summary);
  assert.deepEqual([totals.messages, totals.schemas, totals.channels], [BigInt(messages.length), schemas.size, channels.size]);
  assert.deepEqual([totals.from, totals.to], [messages[0].logged, messages.at(-1).logged]);
  for (const { id } of channels.values()) assert.equal(totals.counts[id], BigInt(messages.filter(({ channel }) => channel === id).length));
  return { profile: records[0].profile, schemas, channels, messages };
}

function decoded(message, channels, schemas) {
  const channel = channels.get(message.channel);
  const schema = schemas.get(channel.schema);
  assert.deepEqual([schema.id > 0, schema.encoding, channel.encoding], [true, 'ros2msg', 'cdr']);
  const [own, ...used] = schema.text.split(`\n${'='.repeat(80)}\nMSG: `);
  const types = new Map(used.map((text) => [text.slice(0, text.indexOf('\n')), text.slice(text.indexOf('\n') + 1)]));
  assert.equal(message.data.subarray(0, 4).toString('hex'), '00010000');
  const r = new Reader(message.data.subarray(4));
  const plain = (size, read) => () => { r.take((size - r.at % size) % size); return read(r.take(size)); };
  const simple = {
    bool: plain(1, (o) => (assert.ok(o[0] <= 1), o[0] === 1)), uint8: plain(1, (o) => o[0]), int32: plain(4, (o) => o.readInt32LE()),
    uint32: plain(4, (o) => o.readUInt32LE()), float64: plain(8, (o) => o.readDoubleLE()),
    string: () => { const text = r.take(simple.uint32()); assert.equal(text.at(-1), 0); return text.subarray(0, -1).toString(); },
  };
  const value = (type) => (type.endsWith('[]') ? Array.from({ length: simple.uint32() }, () => value(type.slice(0, -2))) : simple[type] ? simple[type]() : struct(types.get(type)));
  const struct = (text) => Object.fromEntries(text.split('\n').filter((line) => !line.includes('=')).map((line) => line.split(' ')).map(([type, name]) => [name, value(type)]));
  const content = struct(own);
  r.end();
  const { sec, nanosec } = content.header.stamp;
  assert.equal(BigInt(sec) * 1000000000n + BigInt(nanosec), message.logged);
  return { topic: channel.topic, type: schema.name, content };
}

const AT = 1700000000123;
const read = (robots) => readMcap(Buffer.concat(mcap(robots).map((part) => Buffer.from(part))));
function robotNamed(id, origin = null) {
  const robot = new Robot(id, 0, origin);
  robot.apply({ x: 0, y: 0, obstacles: [] }, AT, () => {});
  robot.apply({ x: 0, y: 50, obstacles: [30, 50, 0, 90] }, AT + 200, () => {});
  return robot;
}

test('places and points are read back in metres, with the heading of the last step', () => {
  const { profile, messages, schemas } = read([robotNamed('robot1')]);
  assert.equal(profile, 'ros2');
  assert.deepEqual([...schemas.values()].map(({ name }) => name), ['geometry_msgs/msg/PoseStamped', 'sensor_msgs/msg/PointCloud2']);
  const poses = messages.filter(({ topic }) => topic === '/robot1/pose').map(({ content }) => content);
  assert.deepEqual(poses.map(({ pose }) => [pose.position.x, pose.position.y]), [[0, 0], [0, 0.5]]);
  assert.equal(poses[0].header.frame_id, 'map');
  const { z, w } = poses[1].pose.orientation;
  assert.ok(Math.abs(2 * Math.atan2(z, w) - Math.PI / 2) < 1e-9);
  const [cloud, ...more] = messages.filter(({ topic }) => topic === '/robot1/obstacles').map(({ content }) => content);
  assert.equal(more.length, 0);
  assert.deepEqual([cloud.height, cloud.width, cloud.point_step, cloud.row_step, cloud.data.length], [1, 2, 16, 32, 32]);
  assert.deepEqual(cloud.fields.map(({ name, offset, datatype, count }) => [name, offset, datatype, count]), [['x', 0, 7, 1], ['y', 4, 7, 1], ['z', 8, 7, 1], ['intensity', 12, 7, 1]]);
  const floats = Buffer.from(cloud.data);
  assert.deepEqual([0, 4, 16, 20].map((at) => Math.round(100 * floats.readFloatLE(at))), [30, 50, 0, 90]);
});

test('a robot that moves 1 cm at a time has a trail and a heading, too', () => {
  const robot = new Robot('slow', 0, null);
  for (let i = 0; i <= 100; i++) {
    robot.apply({ x: 0, y: -i, obstacles: [] }, AT + 200 * i, () => {});
    if (i === 10) robot.forgetDrawing();
  }
  assert.ok(robot.trail.length > 30, `${robot.trail.length} places`);
  assert.equal(robot.heading, -Math.PI / 2);
  const { z, w } = read([robot]).messages.at(-1).content.pose.orientation;
  assert.ok(Math.abs(2 * Math.atan2(z, w) + Math.PI / 2) < 1e-9);
});

test('a robot that rests has one place, however its position flickers', () => {
  const robot = new Robot('rests', 0, null);
  for (let i = 0; i < 100; i++) robot.apply({ x: i % 2, y: 0, obstacles: [] }, AT + 200 * i, () => {});
  assert.deepEqual([robot.trail.length, robot.heading], [1, null]);
});

test('messages of all robots are in the order of time, and count up in each channel', () => {
  const { messages } = read([robotNamed('a'), robotNamed('b')]);
  assert.deepEqual(messages.map(({ logged }) => logged), messages.map(({ logged }) => logged).sort());
  for (const id of new Set(messages.map(({ channel }) => channel)))
    messages.filter(({ channel }) => channel === id).forEach(({ sequence }, i) => assert.equal(sequence, i));
});

test('topics are distinct names that ROS 2 allows; channels have the robots’ own names', () => {
  const ids = ['lego-1', 'lego_1', '5', 'robot_5', 'ø', 'a.b'];
  const { channels } = read(ids.map((id) => robotNamed(id)));
  const poses = [...channels.values()].filter(({ topic }) => topic.endsWith('/pose'));
  assert.deepEqual(poses.map(({ metadata }) => metadata.robot), ids);
  const topics = ['lego_1', 'lego_1_2', 'robot_5', 'robot_5_2', 'robot__', 'a_b'].map((name) => `/${name}/pose`); // docs/web.md
  assert.deepEqual(poses.map(({ topic }) => topic), topics);
});

test('without places there is no file', () => {
  assert.equal(mcap([]), null);
  assert.equal(mcap([new Robot('silent', 0, null)]), null);
});
