// SPDX-License-Identifier: Apache-2.0
// The places and points of robots over time as an MCAP file (https://mcap.dev/spec) of ROS 2 messages, which Foxglove and
// `ros2 bag` read. Metres, in the frame `map`.
const MAGIC = [0x89, 0x4d, 0x43, 0x41, 0x50, 0x30, 0x0d, 0x0a];
const [HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, STATISTICS, DATA_END] = [0x01, 0x02, 0x03, 0x04, 0x05, 0x0b, 0x0f];
const MOST_MESSAGES = 200000; // some 30 MB; the newest are kept
const FRAME = 'map';
const FLOAT32 = 7; // of sensor_msgs/PointField

// The texts of ROS 2's message definitions: the schema's own text, then the definitions that it uses.
const line = `\n${'='.repeat(80)}\nMSG: `;
const header = `${line}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id${line}builtin_interfaces/Time\nint32 sec\nuint32 nanosec`;
const SCHEMAS = [
  ['geometry_msgs/msg/PoseStamped', `std_msgs/Header header\ngeometry_msgs/Pose pose${header}${line}geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation${line}geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z${line}geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w`],
  ['sensor_msgs/msg/PointCloud2', `std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense${header}${line}sensor_msgs/PointField\nuint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count`],
];
const [POSE, POINTS] = [1, 2];

const utf8 = new TextEncoder();
// A growing buffer of little-endian values.
class Octets {
  constructor() {
    this.view = new DataView(new ArrayBuffer(256));
    this.size = 0;
  }
  room(size) {
    const at = this.size;
    this.size += size;
    if (this.size > this.view.byteLength) {
      const grown = new Uint8Array(2 * this.size);
      grown.set(new Uint8Array(this.view.buffer, 0, at));
      this.view = new DataView(grown.buffer);
    }
    return at;
  }
  put(setter, size, value) {
    const at = this.room(size);
    this.view[setter](at, value, true);
    return this;
  }
  u8(value) { return this.put('setUint8', 1, value); }
  u16(value) { return this.put('setUint16', 2, value); }
  u32(value) { return this.put('setUint32', 4, value); }
  u64(value) { return this.put('setBigUint64', 8, BigInt(value)); }
  f32(value) { return this.put('setFloat32', 4, value); }
  f64(value) { return this.put('setFloat64', 8, value); }
  all(octets) {
    const at = this.room(octets.length);
    new Uint8Array(this.view.buffer).set(octets, at);
    return this;
  }
  text(value) { const octets = utf8.encode(value); return this.u32(octets.length).all(octets); }
  get octets() { return new Uint8Array(this.view.buffer, 0, this.size); }
}
// CDR (XCDR1, little-endian): values are aligned to multiples of their size, counted after the first four octets.
class Cdr extends Octets {
  constructor() { super(); this.all([0, 1, 0, 0]); }
  align(size) { while ((this.size - 4) % size) this.u8(0); return this; }
  u32(value) { this.align(4); return super.u32(value); }
  f64(value) { this.align(8); return super.f64(value); }
  text(value) { const octets = utf8.encode(value); return this.u32(octets.length + 1).all(octets).u8(0); }
  header(at) { return this.u32(Math.floor(Math.round(at) / 1000)).u32(Math.round(at) % 1000 * 1e6).text(FRAME); }
}

function poseOf({ at, x, y, yaw }) {
  const cdr = new Cdr().header(at);
  for (const value of [x / 100, y / 100, 0, 0, 0, Math.sin(yaw / 2), Math.cos(yaw / 2)]) cdr.f64(value);
  return cdr.octets;
}
function pointsOf({ at, points }) {
  const cdr = new Cdr().header(at).u32(1).u32(points.length).u32(4);
  ['x', 'y', 'z', 'intensity'].forEach((name, i) => cdr.text(name).u32(4 * i).u8(FLOAT32).u32(1));
  cdr.u8(0).u32(16).u32(16 * points.length).u32(16 * points.length);
  const data = new Octets();
  for (const [x, y, value] of points) data.f32(x / 100).f32(y / 100).f32(0).f32(value);
  return cdr.all(data.octets).u8(1).octets;
}

// Returns the robot's places with its heading, which is the direction of its last step of more than 1 cm.
function posesOf(robot) {
  let [yaw, last] = [0, robot.track[0]];
  return robot.track.map(({ at, x, y }) => {
    if (Math.hypot(x - last.x, y - last.y) > 1) [yaw, last] = [Math.atan2(y - last.y, x - last.x), { x, y }];
    return { at, x, y, yaw };
  });
}
// Returns a cloud for each time, with the points that the robot saw then.
function cloudsOf(robot) {
  const clouds = new Map();
  for (let i = 0; i < robot.kept; i++) {
    const at = robot.times[i];
    if (!clouds.has(at)) clouds.set(at, { at, points: [] });
    clouds.get(at).points.push(robot.points.subarray(i * 3, i * 3 + 3));
  }
  return [...clouds.values()];
}
// Makes a unique ROS 2 name for each robot; such names have letters, digits and _ only.
function topicNames(robots) {
  const taken = new Set();
  return robots.map(({ id }) => {
    const plain = id.replace(/[^A-Za-z0-9_]/g, '_').replace(/^(?=[^A-Za-z])/, 'robot_');
    let name = plain;
    for (let n = 2; taken.has(name); n++) name = `${plain}_${n}`;
    taken.add(name);
    return name;
  });
}

// Returns the file's parts for a Blob; null while there are no messages.
export function mcap(robots) {
  const channels = [];
  const messages = [];
  const names = topicNames(robots);
  robots.forEach((robot, i) => {
    for (const [schema, what, all, write] of [[POSE, 'pose', posesOf(robot), poseOf], [POINTS, 'obstacles', cloudsOf(robot), pointsOf]]) {
      if (!all.length) continue;
      const channel = { id: channels.length, schema, topic: `/${names[i]}/${what}`, robot: robot.id, count: 0 };
      channels.push(channel);
      for (const each of all) messages.push({ channel, at: each.at, data: () => write(each) });
    }
  });
  if (!messages.length) return null;
  messages.sort((a, b) => a.at - b.at).splice(0, messages.length - MOST_MESSAGES);
  return written(channels, messages);
}

function written(channels, messages) {
  const parts = [new Uint8Array(MAGIC)];
  let size = MAGIC.length;
  const add = (kind, content) => {
    const { octets } = new Octets().u8(kind).u64(content.size).all(content.octets);
    parts.push(octets);
    size += octets.length;
  };
  const ns = (at) => BigInt(Math.round(at)) * 1000000n;
  const describe = () => {
    SCHEMAS.forEach(([name, text], i) => add(SCHEMA, new Octets().u16(i + 1).text(name).text('ros2msg').text(text)));
    for (const { id, schema, topic, robot } of channels) {
      const metadata = new Octets().text('robot').text(robot);
      add(CHANNEL, new Octets().u16(id).u16(schema).text(topic).text('cdr').u32(metadata.size).all(metadata.octets));
    }
  };
  add(HEADER, new Octets().text('ros2').text('slam-gateway-web'));
  describe();
  for (const { channel, at, data } of messages) add(MESSAGE, new Octets().u16(channel.id).u32(channel.count++).u64(ns(at)).u64(ns(at)).all(data()));
  add(DATA_END, new Octets().u32(0));
  const summary = size;
  describe();
  const counts = new Octets();
  for (const { id, count } of channels) if (count) counts.u16(id).u64(count);
  const totals = new Octets().u64(messages.length).u16(SCHEMAS.length).u32(channels.length).u32(0).u32(0).u32(0);
  add(STATISTICS, totals.u64(ns(messages[0].at)).u64(ns(messages.at(-1).at)).u32(counts.size).all(counts.octets));
  add(FOOTER, new Octets().u64(summary).u64(0).u32(0));
  parts.push(new Uint8Array(MAGIC));
  return parts;
}
