// What MCAP's own JavaScript library finds in a file, as JSON; it runs beside the node_modules of the test.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";

const file = await open(process.argv[2]);
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});
const decoders = new Map();
const topics = {};
for (const [id, { topic, messageEncoding, schemaId }] of reader.channelsById) {
  const { name, encoding, data } = reader.schemasById.get(schemaId);
  topics[topic] = { messageEncoding, schema: name, schemaEncoding: encoding, sequences: [], stamps: [], messages: [] };
  if (encoding === "protobuf") {
    const type = protobufFromBinaryDescriptor(data).lookupType(name);
    decoders.set(id, (bytes) => type.toObject(type.decode(bytes), { longs: Number, bytes: Array, defaults: true }));
  } else if (messageEncoding === "json") {
    decoders.set(id, (bytes) => JSON.parse(new TextDecoder().decode(bytes)));
  }
}
for await (const { channelId, sequence, logTime, publishTime, data } of reader.readMessages()) {
  const found = topics[reader.channelsById.get(channelId).topic];
  found.sequences.push(sequence);
  found.stamps.push([Number(logTime), Number(publishTime)]);
  found.messages.push(decoders.get(channelId)?.(data) ?? data.length);
}
const metadata = {};
for await (const record of reader.readMetadata()) metadata[record.name] = Object.fromEntries(record.metadata);
await file.close();
const { messageCount, channelMessageCounts, chunkCount } = reader.statistics;
const counts = [...channelMessageCounts].map(([id, count]) => [reader.channelsById.get(id).topic, Number(count)]);
const statistics = { messages: Number(messageCount), chunks: chunkCount, topics: Object.fromEntries(counts) };
console.log(JSON.stringify({ profile: reader.header.profile, topics, metadata, statistics }));
