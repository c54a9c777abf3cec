// A real OpenID provider (npm oidc-provider) for tests. Its one argument is JSON: port, redirect_uri, client_id,
// client_secret, kid (whose key is new with every start), late_s (how late its clock is), logout_uri (for back-channel
// logout). Says "ready" when it is. POST /test/remove/NAME removes an account.
import { generateKeyPair, exportJWK } from "jose";
import { Provider } from "oidc-provider";

const asked = JSON.parse(process.argv[2]);
const now = Date.now;
Date.now = () => now() - asked.late_s * 1000;

const { privateKey } = await generateKeyPair("RS256", { extractable: true });
const key = { ...(await exportJWK(privateKey)), kid: asked.kid, alg: "RS256", use: "sig" };
const day = 24 * 3600;
const removed = new Set();
const issuer = `http://127.0.0.1:${asked.port}`;
const provider = new Provider(issuer, {
  clients: [
    {
      client_id: asked.client_id,
      client_secret: asked.client_secret,
      redirect_uris: [asked.redirect_uri],
      response_types: ["code"],
      grant_types: ["authorization_code", "refresh_token"],
      backchannel_logout_uri: asked.logout_uri,
      backchannel_logout_session_required: true,
    },
  ],
  jwks: { keys: [key] },
  pkce: { required: () => true },
  cookies: { keys: ["only for tests"] },
  claims: { openid: ["sub"], email: ["email", "email_verified"], profile: ["name"] },
  // What the browser keeps must outlast a clock that is late; what is signed must not.
  ttl: { Interaction: day, Session: day, Grant: day, AuthorizationCode: 60, AccessToken: 3600, IdToken: 3600 },
  features: { devInteractions: { enabled: true }, backchannelLogout: { enabled: true } },
  // It sends logout tokens to public addresses only, and gives up after 2.5 s.
  fetch: (url, options) => fetch(url, { ...options, dispatcher: undefined, signal: undefined }),
  // As other providers do, without asking for consent each time.
  issueRefreshToken: () => true,
  expiresWithSession: () => false,
  findAccount: (_context, id) =>
    removed.has(id)
      ? undefined
      : {
          accountId: id,
          claims: () => ({ sub: id, name: id, email: `${id}@lab.example`, email_verified: true }),
        },
});
provider.use(async (context, next) => {
  const [, name] = /^\/test\/remove\/(.+)$/.exec(context.path) ?? [];
  if (name === undefined) return next();
  removed.add(name);
  context.status = 204;
});
provider.listen(asked.port, "127.0.0.1", () => console.log("ready"));
