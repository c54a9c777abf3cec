/** Small MCAPs, made by the library that others make them with. */

import { McapWriter } from "@mcap/core";
import { joined } from "../formats/recording";

export interface MadeMessage {
  topic: string;
  logTimeNs: bigint;
  data: Uint8Array;
}

export interface MadeTopic {
  name: string;
  schema: { name: string; encoding: string; data: Uint8Array };
  messageEncoding: string;
}

export async function madeMcap(topics: MadeTopic[], messages: MadeMessage[], { chunkSize = 4096, isClosed = true } = {}): Promise<Uint8Array> {
  const parts: Uint8Array[] = [];
  let position = 0n;
  const writable = {
    position: () => position,
    write: (bytes: Uint8Array) => {
      parts.push(bytes.slice());
      position += BigInt(bytes.length);
      return Promise.resolve();
    },
  };
  const writer = new McapWriter({ writable, chunkSize });
  await writer.start({ profile: "", library: "test" });
  const channels = new Map<string, number>();
  for (const { name, schema, messageEncoding } of topics) {
    const schemaId = await writer.registerSchema(schema);
    channels.set(name, await writer.registerChannel({ topic: name, schemaId, messageEncoding, metadata: new Map() }));
  }
  for (const [sequence, { topic, logTimeNs, data }] of messages.entries()) {
    const channelId = channels.get(topic) ?? -1;
    await writer.addMessage({ channelId, sequence, logTime: logTimeNs, publishTime: logTimeNs, data });
  }
  if (isClosed) await writer.end();
  return joined(parts);
}
