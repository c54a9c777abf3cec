/**
 * Whether the console tells of the machine and not of the page: Docker beside this test made or dropped a network. The
 * browser then breaks off what is under way, and the page asks again.
 */
export const isOfTheMachine = (text) => text.includes("net::ERR_NETWORK_CHANGED");
