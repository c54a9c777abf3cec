// The map of missions: clusters that come apart or are listed, tiles beneath, and links to missions.

/** Uses the map of the search and that of a project; returns what they showed. The page may log refused tiles. */
export async function useMissionsMap(page, address, projectId, checkPage) {
  const map = page.locator("[data-missions-map]");
  const placed = () => map.getAttribute("data-placed").then(Number);
  const clusters = () => page.locator("[data-cluster]").allInnerTexts();
  const missions = () => page.locator("[data-mission]").evaluateAll((links) => links.map((link) => link.getAttribute("aria-label")));
  const whenClusters = (expected) => page.waitForFunction((texts) => JSON.stringify([...document.querySelectorAll("[data-cluster]")].map((one) => one.textContent)) === texts, JSON.stringify(expected));

  await page.goto(`${address}/search?tab=map`);
  await page.locator("[data-cluster]").first().waitFor();
  await page.locator("img[data-tile].loaded").first().waitFor();
  const shown = { placed: await placed(), clusters: await clusters(), missions: await missions(), notes: await page.locator("[data-map-notes]").innerText() };
  shown.attribution = await page.locator("[data-attribution]").innerText();
  await page.waitForFunction(() => [...document.querySelectorAll("img[data-tile]")].every((tile) => tile.complete));
  shown.tiles = await page.locator("img[data-tile]").evaluateAll((tiles) => tiles.map((tile) => [tile.src, getComputedStyle(tile).visibility]));
  await checkPage(page, "search-map");

  // From far away, all missions are one cluster, which comes apart.
  await page.locator("[data-map]").focus();
  for (let presses = 0; presses < 20 && (await clusters())[0] !== String(shown.placed); presses += 1) await page.keyboard.press("-");
  const far = await clusters();
  await page.locator("[data-cluster]").click();
  await whenClusters(shown.clusters);
  const near = { clusters: await clusters(), missions: await missions() };

  // Missions at the same place are listed.
  await page.locator("[data-cluster]").click();
  const list = page.locator("[data-listed]");
  await list.waitFor();
  const listed = { names: await list.getByRole("link").allInnerTexts(), hasFocus: await list.evaluate((element) => element === document.activeElement) };
  await checkPage(page, "search-map-listed");
  await list.getByRole("button", { name: "Close the list" }).click();
  await list.waitFor({ state: "detached" });

  await page.locator("[data-mission]").first().click();
  await page.waitForURL((url) => url.pathname.startsWith("/missions/"));
  await page.locator("[data-metadata]").waitFor();
  const opened = await page.locator("h1").innerText();

  await page.goto(`${address}/projects/${projectId}`);
  await page.getByRole("button", { name: "Map" }).click();
  await page.waitForURL((url) => url.searchParams.get("view") === "map");
  await map.waitFor();
  return { shown, far, near, listed, opened, ofProject: await placed() };
}
