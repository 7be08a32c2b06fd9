// SPDX-License-Identifier: Apache-2.0
// Reads an MCAP file with @mcap/core, by its index and as a stream, and prints its contents as JSON.
const fs = require("fs");
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");

class Readable {
  constructor(octets) { this.octets = octets; }
  async size() { return BigInt(this.octets.length); }
  async read(offset, size) { return this.octets.subarray(Number(offset), Number(offset) + Number(size)); }
}

const text = (octets) => Buffer.from(octets).toString("utf8");

async function main(path) {
  const octets = new Uint8Array(fs.readFileSync(path));
  const reader = await McapIndexedReader.Initialize({ readable: new Readable(octets) });
  const topics = {};
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    const topic = (topics[channel.topic] ??= { schema: reader.schemasById.get(channel.schemaId).name, count: 0 });
    topic.count += 1;
    topic.last = JSON.parse(text(message.data));
  }
  const schemas = {};
  for (const schema of reader.schemasById.values()) {
    schemas[schema.name] = { encoding: schema.encoding, text: JSON.parse(text(schema.data)) };
  }
  const stream = new McapStreamReader({ validateCrcs: true });
  stream.append(octets);
  let streamed = 0;
  for (let record; (record = stream.nextRecord()); ) streamed += record.type === "Message" ? 1 : 0;
  if (!stream.done()) throw new Error("the stream has no end");
  const found = reader.statistics;
  const statistics = { messages: Number(found.messageCount), chunks: found.chunkCount, first: String(found.messageStartTime),
    last: String(found.messageEndTime) };
  process.stdout.write(JSON.stringify({ statistics, topics, schemas, streamed }));
}

main(process.argv[2]).catch((error) => { console.error(error); process.exit(1); });
