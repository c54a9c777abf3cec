let hasNetworkChanged = false;

/** Screenshots of WebGL make a browser without a GPU wait, of which it warns. */
const SLOW_DRAWING = "GPU stall due to ReadPixels";

/**
 * Returns whether an error is caused by the machine, not by the page: it has no GPU, or Docker created or removed a
 * network during the test. The browser then aborts its requests; the app repeats them, and loads an aborted page again.
 */
export function isEnvironmentError(text) {
  if (text.includes("net::ERR_NETWORK_CHANGED")) hasNetworkChanged = true;
  return text.includes(SLOW_DRAWING) || text.includes("net::ERR_NETWORK_CHANGED") || (hasNetworkChanged && text.startsWith("Failed to fetch dynamically imported module"));
}
