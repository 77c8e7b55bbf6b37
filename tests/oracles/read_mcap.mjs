// Reads a recording with readers that share no code with Lacuna and prints what they found as JSON.
//
//     node read_mcap.mjs MODULES FILE.mcap    @mcap/core through the index, @mcap/support to decompress,
//                                             @foxglove/rosmsg2-serialization to decode; MODULES holds node_modules
//
// Output as that of read_mcap.py: {"profile", "library", "schemas", "topics": {topic: {"log_time", "stamp", "fields"}},
// "metadata", "attachments": {name: size}}. Floating-point fields are strings that hold all digits.

import { createRequire } from "node:module";
import { open } from "node:fs/promises";
import path from "node:path";

const [modules, file] = process.argv.slice(2);
const require = createRequire(path.join(path.resolve(modules), "package.json"));
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

/** Which of a type's fields are floating-point numbers: JavaScript itself does not tell 1.0 from 1. */
function floats(definitions) {
  const own = definitions.find((d) => d.name == undefined) ?? definitions[0];
  return new Set(own.definitions.filter((f) => f.type.startsWith("float")).map((f) => f.name));
}

function plain(value, isFloat) {
  if (ArrayBuffer.isView(value) || Array.isArray(value)) return Array.from(value, (v) => plain(v, isFloat));
  if (typeof value === "bigint") return Number(value);
  if (typeof value === "number" && isFloat) return Number.isNaN(value) ? "nan" : String(value);
  return value;
}

const handle = await open(file, "r");
const readable = {
  size: async () => BigInt((await handle.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    const { bytesRead } = await handle.read(buffer, 0, Number(length), Number(offset));
    if (bytesRead !== Number(length)) throw new Error(`read ${bytesRead} of ${length} bytes at ${offset}`);
    return buffer;
  },
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
const found = { profile: reader.header.profile, library: reader.header.library, schemas: {}, topics: {}, metadata: {}, attachments: {} };
const decoders = new Map();
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  if (schema.encoding !== "ros2msg" || channel.messageEncoding !== "cdr") throw new Error(`${channel.topic} is not ROS 2`);
  const definitions = parse(new TextDecoder().decode(schema.data), { ros2: true });
  decoders.set(channel.id, { read: new MessageReader(definitions), floats: floats(definitions), topic: channel.topic });
  found.schemas[channel.topic] = schema.name;
}
for await (const message of reader.readMessages()) {
  const decoder = decoders.get(message.channelId);
  const { header, ...fields } = decoder.read.readMessage(message.data);
  const entry = (found.topics[decoder.topic] ??= { log_time: [], stamp: [], fields: {} });
  entry.log_time.push(Number(message.logTime));
  entry.stamp.push(header.stamp.sec * 1e9 + header.stamp.nanosec);
  for (const [name, value] of Object.entries(fields)) {
    (entry.fields[name] ??= []).push(plain(value, decoder.floats.has(name)));
  }
}
for await (const record of reader.readMetadata()) found.metadata[record.name] = Object.fromEntries(record.metadata);
for await (const record of reader.readAttachments()) found.attachments[record.name] = record.data.byteLength;
await handle.close();
process.stdout.write(JSON.stringify(found));
