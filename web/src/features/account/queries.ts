// Queries and mutations of the user's own account.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import { sessionTexts as texts } from "@/texts/account";

type Schemas = components["schemas"];
export type Account = Schemas["AccountRead"];
export type Identity = Schemas["IdentityRead"];
export type TotpEnrolment = Schemas["TotpEnrolment"];

/** The page itself, where a provider sends one back to. */
const HERE = "/account";

export function useAccount() {
  return useQuery({ queryKey: keys.account, queryFn: ({ signal }) => call(api.GET("/api/v1/me/account", { signal })) });
}

export function useIdentities() {
  return useQuery({ queryKey: keys.identities, queryFn: ({ signal }) => call(api.GET("/api/v1/me/identities", { signal })) });
}

export function useSignInMethods() {
  return useQuery({ queryKey: keys.signInMethods, queryFn: ({ signal }) => call(api.GET("/api/v1/auth/methods", { signal })), staleTime: Infinity });
}

export function useUnlink() {
  const queries = useQueryClient();
  return async (identity: Identity) => {
    try {
      await call(api.DELETE("/api/v1/me/identities/{identity_id}", { params: { path: { identity_id: identity.id } } }));
    } finally {
      void queries.invalidateQueries({ queryKey: keys.identities });
    }
  };
}

export function useLink() {
  return useMutation({
    mutationFn: async (provider: string) => {
      const begun = await call(api.POST("/api/v1/auth/providers/{name}/link", { params: { path: { name: provider } }, body: { return_to: HERE } }));
      globalThis.location.assign(begun.url);
    },
  });
}

/** Mutations of the second factor; they refetch the account. */
export function useTotp() {
  const queries = useQueryClient();
  const refresh = () => void queries.invalidateQueries({ queryKey: keys.account });
  const changed = async <Data>(request: Promise<Data>): Promise<Data> => {
    try {
      return await request;
    } finally {
      refresh();
    }
  };
  return {
    begin: () => call(api.POST("/api/v1/me/totp")),
    confirm: (code: string) => call(api.POST("/api/v1/me/totp/confirm", { body: { code } })),
    renew: () => call(api.POST("/api/v1/me/totp/recovery-codes")),
    disable: () => changed(call(api.DELETE("/api/v1/me/totp"))),
    refresh,
  };
}

export function useChangePassword() {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: (body: Schemas["PasswordChange"]) => call(api.POST("/api/v1/auth/password/change", { body })),
    onSuccess: () => void queries.invalidateQueries({ queryKey: keys.sessions }),
    meta: { showsItself: true },
  });
}

// The order matters: most user agents also contain the names of other browsers.
const BROWSERS: readonly (readonly [string, RegExp])[] = [
  ["Edge", /\bEdg(?:e|A|iOS)?\//],
  ["Opera", /\bOPR\//],
  ["Samsung Internet", /\bSamsungBrowser\//],
  ["Firefox", /\b(?:Firefox|FxiOS)\//],
  ["Chrome", /\b(?:Chrome|CriOS|HeadlessChrome|Chromium)\//],
  ["Safari", /\bSafari\//],
];
const SYSTEMS: readonly (readonly [string, RegExp])[] = [
  ["Android", /\bAndroid\b/],
  ["iPhone", /\biPhone\b/],
  ["iPad", /\biPad\b/],
  ["Windows", /\bWindows\b/],
  ["macOS", /\bMac OS X\b|\bMacintosh\b/],
  ["ChromeOS", /\bCrOS\b/],
  ["Linux", /\bLinux\b|\bX11\b/],
];

function named(text: string, among: readonly (readonly [string, RegExp])[]): string | undefined {
  return among.find(([, sign]) => sign.test(text))?.[0];
}

/** Returns a browser's name and system: `Firefox on Linux`. */
export function browserName(userAgent: string | null): string {
  const browser = named(userAgent ?? "", BROWSERS);
  const system = named(userAgent ?? "", SYSTEMS);
  if (browser === undefined) return system ?? texts.unknownBrowser;
  return system === undefined ? browser : texts.on(browser, system);
}
