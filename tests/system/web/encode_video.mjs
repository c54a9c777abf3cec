// Encodes small videos with the browser, and says which codecs it can decode. Prints JSON.
// Arguments: the folder with playwright-core, the browser, a sign-in link, the server's address, and the number of frames.
import { launchBrowser } from "./chromium.mjs";

const [web, executablePath, , address, count] = process.argv.slice(2);
const browser = await launchBrowser(web, executablePath);
const page = await browser.newPage();
await page.goto(`${address}/sign-in`);
await page.getByRole("button", { name: "Sign in" }).waitFor(); // the page goes nowhere else then

/** Each picture shows its number: eight bars, white for 1, the highest bit first; below, a red and a blue half. */
const result = await page.evaluate(async (frames) => {
  const [width, height, keyEvery] = [64, 48, 20];
  const codecs = { vp9: "vp09.00.10.08", av1: "av01.0.08M.08", h264: "avc1.42001f", h265: "hev1.1.6.L93.90" };
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");

  function draw(number) {
    for (let bit = 0; bit < 8; bit += 1) {
      context.fillStyle = (number >> (7 - bit)) & 1 ? "white" : "black";
      context.fillRect(bit * 8, 0, 8, height / 2);
    }
    context.fillStyle = "rgb(220 30 30)";
    context.fillRect(0, height / 2, width / 2, height / 2);
    context.fillStyle = "rgb(30 30 220)";
    context.fillRect(width / 2, height / 2, width / 2, height / 2);
  }

  async function encoded(codec) {
    const chunks = [];
    const encoder = new VideoEncoder({ output: (chunk) => chunks.push(chunk), error: () => undefined });
    encoder.configure({ codec, width, height, bitrate: 2_000_000, latencyMode: "realtime", ...(codec.startsWith("avc1") ? { avc: { format: "annexb" } } : {}) });
    for (let number = 0; number < frames; number += 1) {
      draw(number);
      const frame = new VideoFrame(canvas, { timestamp: number * 100_000 });
      encoder.encode(frame, { keyFrame: number % keyEvery === 0 });
      frame.close();
      while (encoder.encodeQueueSize > 4) await new Promise((resolve) => setTimeout(resolve));
    }
    await encoder.flush();
    encoder.close();
    return chunks.map((chunk) => {
      const bytes = new Uint8Array(chunk.byteLength);
      chunk.copyTo(bytes);
      return btoa(String.fromCharCode(...bytes));
    });
  }

  const videos = {};
  const decodable = [];
  for (const [format, codec] of Object.entries(codecs)) {
    if ((await VideoDecoder.isConfigSupported({ codec })).supported) decodable.push(format);
    const { supported } = await VideoEncoder.isConfigSupported({ codec, width, height });
    if (supported) videos[format] = await encoded(codec);
  }
  return { videos, decodable };
}, Number(count));
await browser.close();
process.stdout.write(JSON.stringify(result));
