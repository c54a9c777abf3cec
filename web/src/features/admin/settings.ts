// Settings as they are shown and found.
import type { Setting } from "./queries";
import { texts as all } from "@/texts/admin";

const texts = all.settings;

/** Returns what a setting is set to, in words; a secret only whether it is set. */
export function valueOf(setting: Setting): string {
  if (setting.is_secret) return setting.is_set ? texts.secret : texts.noSecret;
  const value: unknown = setting.value;
  if (value === null || value === undefined || value === "") return texts.empty;
  if (typeof value === "string") return value;
  return Array.isArray(value) && value.length === 0 ? texts.empty : JSON.stringify(value);
}

/** Returns the settings whose names hold what was typed, in any spelling of words: `trash days`, `TRASH_DAYS`. */
export function matching(settings: readonly Setting[], typed: string, isOnlySet: boolean): readonly Setting[] {
  const words = typed.toLowerCase().split(/[\s_]+/).filter((word) => word !== "");
  return settings.filter((setting) => (!isOnlySet || setting.is_set) && words.every((word) => setting.name.toLowerCase().includes(word)));
}
