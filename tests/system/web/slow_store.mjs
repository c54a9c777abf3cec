// A proxy that makes the store slow: ranges come after a pause, and all of them share one line. It records them.
import { createServer, request } from "node:http";
import { setTimeout as pause } from "node:timers/promises";

const PART_BYTES = 16 * 1024;

/**
 * Starts the proxy. What has a signed URL is a range of the store; everything else passes at full speed. `ranges` has,
 * in the order of their requests: the path, the first and last byte, how many were sent, and when each began and ended.
 */
export async function slowStore({ bytesPerSecond, latencyMs }) {
  const ranges = [];
  let line = Promise.resolve();

  /** Waits until the line has sent a part, after those of others that came before. */
  function transfer(bytes) {
    line = line.then(() => pause((1000 * bytes) / bytesPerSecond));
    return line;
  }

  async function sendSlowly(upstream, response, range) {
    for await (const data of upstream) {
      for (let at = 0; at < data.length; at += PART_BYTES) {
        const part = data.subarray(at, at + PART_BYTES);
        if (!response.destroyed) await transfer(part.length);
        if (response.destroyed) return; // the browser has cancelled it
        response.write(part);
        range.sentBytes += part.length;
      }
    }
    range.isWhole = true;
    response.end();
  }

  const server = createServer((incoming, response) => {
    const url = new URL(incoming.url);
    const isRange = incoming.method === "GET" && url.searchParams.has("X-Amz-Signature");
    const [, first, last] = /bytes=(\d+)-(\d+)/.exec(incoming.headers.range ?? "") ?? [];
    const range = { path: url.pathname, first: Number(first), last: Number(last), atMs: Date.now(), endedAtMs: null, sentBytes: 0, isWhole: false };
    if (isRange) {
      ranges.push(range);
      response.on("close", () => (range.endedAtMs = Date.now()));
    }
    const outgoing = request(url, { method: incoming.method, headers: incoming.headers }, async (upstream) => {
      if (isRange) await pause(latencyMs);
      response.writeHead(upstream.statusCode, upstream.headers);
      if (!isRange) return upstream.pipe(response);
      return sendSlowly(upstream, response, range).catch((error) => {
        if (!response.destroyed) throw error;
      });
    });
    outgoing.on("error", () => response.destroy());
    response.on("close", () => outgoing.destroy());
    incoming.pipe(outgoing);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return { ranges, address: `http://127.0.0.1:${server.address().port}`, close: () => server.closeAllConnections() || server.close() };
}
