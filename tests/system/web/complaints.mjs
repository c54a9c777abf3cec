let hasNetworkChanged = false;

/**
 * Whether the console or the page tells of the machine and not of the page: Docker beside this test made or dropped a
 * network. The browser then breaks off what is under way; the app asks again, and loads anew a page that was broken off.
 */
export function isOfTheMachine(text) {
  if (text.includes("net::ERR_NETWORK_CHANGED")) hasNetworkChanged = true;
  return text.includes("net::ERR_NETWORK_CHANGED") || (hasNetworkChanged && text.startsWith("Failed to fetch dynamically imported module"));
}
