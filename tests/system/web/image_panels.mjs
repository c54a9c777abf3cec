// The image panels of a recording of image_samples.py: what they draw, and what they say.

/** Returns functions that open panels and read them. `open` and `checkPage` are those of the program. */
export function imagePanels({ page, open, checkPage }) {
  const panelOf = (topic) => page.locator(`[data-panel="image"]`, { has: page.locator("h2", { hasText: new RegExp(`^${topic}$`) }) });

  async function pixelsOf(panel) {
    return panel.locator("canvas").evaluate((canvas) => {
      const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
      copy.drawImage(canvas, 0, 0);
      const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
      let text = "";
      for (const byte of data) text += String.fromCharCode(byte);
      return { width: canvas.width, height: canvas.height, rgba: btoa(text) };
    });
  }

  /** What a panel shows once it shows something. */
  async function stateOf(topic) {
    const panel = panelOf(topic);
    await panel.locator("[data-image][data-log-time], [data-read-failure]").first().waitFor();
    const failures = await panel.locator("[data-read-failure] strong").allTextContents();
    if (failures.length > 0) return { failure: failures[0] };
    const image = panel.locator("[data-image]");
    const bar = panel.locator("[data-colour-bar]");
    const range = (await bar.count()) === 0 ? null : await bar.evaluate(({ dataset, textContent }) => ({ least: Number(dataset.least), greatest: Number(dataset.greatest), text: textContent }));
    return { logTime: await image.getAttribute("data-log-time"), annotations: await image.getAttribute("data-annotations"), range, facts: await panel.locator(".facts").innerText(), ...(await pixelsOf(panel)) };
  }

  async function statesOf(topics) {
    const states = {};
    for (const topic of topics) states[topic] = await stateOf(topic);
    return states;
  }

  /** The text beside the picture while the pointer is over a pixel. */
  async function valueAt(topic, x, y) {
    const canvas = panelOf(topic).locator("canvas");
    const { width, height } = await canvas.boundingBox();
    const size = await canvas.evaluate((element) => [element.width, element.height]);
    const scale = Math.min(width / size[0], height / size[1]);
    const margin = [(width - size[0] * scale) / 2, (height - size[1] * scale) / 2];
    await canvas.hover({ position: { x: margin[0] + (x + 0.5) * scale, y: margin[1] + (y + 0.5) * scale } });
    return panelOf(topic).locator("[data-pixel]").textContent();
  }

  async function depth(file, time) {
    await open(file, time, "image:KEY@/thermal");
    const thermal = { "/thermal": await stateOf("/thermal") };
    const noValue = await valueAt("/thermal", 12, 6);
    const topics = ["/depth/mm", "/depth/m", "/depth/png", "/depth/rvl"];
    await open(file, time, ...topics.map((topic) => `image:KEY@${topic}`));
    const states = { ...thermal, ...(await statesOf(topics)) };
    const values = [await valueAt("/depth/mm", 40, 30), await valueAt("/depth/m", 40, 30), await valueAt("/depth/m", 32, 22), noValue];
    const panel = panelOf("/depth/mm");
    await panel.getByRole("button", { name: "Settings" }).click();
    await panel.locator('[data-setting="map"]').selectOption("grey");
    await panel.locator('[data-setting="least"]').fill("1000");
    await panel.locator('[data-setting="least"]').press("Enter");
    await page.locator('[data-colour-bar][data-least="1000"]').waitFor();
    await panel.locator('[data-setting="greatest"]').fill("1500");
    await panel.locator('[data-setting="greatest"]').press("Enter");
    await page.locator('[data-colour-bar][data-least="1000"][data-greatest="1500"]').waitFor();
    await checkPage("viewer-depth");
    const fixed = await stateOf("/depth/mm");
    await page.reload();
    const reloaded = await stateOf("/depth/mm");
    return { states, values, fixed, isSame: reloaded.rgba === fixed.rgba };
  }

  async function annotated(file, time) {
    const topics = ["/front/image", "/rear/image"];
    await open(file, time, ...topics.map((topic) => `image:KEY@${topic}`));
    for (const topic of topics) await panelOf(topic).locator("[data-annotations]").waitFor();
    const states = await statesOf(topics);
    await panelOf("/front/image").getByRole("button", { name: "Settings" }).click();
    await checkPage("viewer-annotations");
    await panelOf("/front/image").locator('[data-setting="annotations"]').selectOption("=/rear/boxes");
    await panelOf("/front/image").locator(`[data-annotations]:not([data-annotations="${states["/front/image"].annotations}"])`).waitFor();
    const other = await stateOf("/front/image");
    await panelOf("/front/image").locator('[data-setting="annotations"]').selectOption("=");
    await panelOf("/front/image").locator("[data-image]:not([data-annotations])").waitFor();
    return { states, other, none: await stateOf("/front/image") };
  }

  /** What each of the first messages of topics shows beside a good camera. The last one comes by a step from the one before. */
  async function damaged(file, times) {
    const topics = ["/bad/raw", "/bad/compressed", "/front/image"];
    const steps = [];
    const last = times.at(-1);
    for (const time of times.slice(0, -1)) {
      await open(file, time, "image:KEY@/bad/raw", "image:KEY@/bad/compressed", "image:KEY@/front/image,annotations");
      steps.push(await statesOf(topics));
      if (steps.length === 2) await checkPage("viewer-damaged-images");
    }
    await page.keyboard.press(".");
    for (const topic of topics) await panelOf(topic).locator(`[data-log-time="${last}"]`).waitFor();
    return [...steps, await statesOf(topics)];
  }

  /** What the panel of a video shows at a time, and after each of some keys, which lead to the frame of a time. */
  async function video(file, { topic, time, keys }) {
    await open(file, time, `image:KEY@${topic}`);
    const states = [await stateOf(topic)];
    if (states[0].failure) return states;
    for (const [key, expected] of keys) {
      await page.keyboard.press(key);
      await panelOf(topic).locator(`[data-log-time="${expected}"]`).waitFor();
      states.push(await stateOf(topic));
    }
    return states;
  }

  return { depth, annotated, damaged, video };
}
