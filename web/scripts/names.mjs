// The ESLint rule `kleinkram/plain-names`: identifiers and file names use the terms of docs/architecture.md, "Vocabulary".
import { basename } from "node:path";

const BANNED = new Set([
  "anew", "asked", "asking", "asks", "beat", "beats", "breath", "came", "deed", "doer", "doom", "doomed", "door", "doors", "few", "given", "heard",
  "held", "hold", "judge", "judged", "keeping", "kept", "lapse", "lapsed", "lapses", "leaving", "letgo", "look", "looked", "mended", "obey", "obeyed",
  "odd", "oddities", "oddity", "patience", "proven", "said", "somebody", "standing", "tell", "there", "told", "trouble", "troubles", "twin", "twins",
  "ward", "warden", "wardens", "whoever",
]);
/** Not as the whole name of a variable. */
const VAGUE = new Set(["each", "found", "goOn", "ground", "letGo", "stuff", "these", "thing", "things", "those", "wanted", "whom"]);

/** @param {string} name */
function bannedWord(name) {
  const words = name.match(/[A-Z]+(?![a-z])|[A-Z]?[a-z]+/g) ?? [];
  return words.map((word) => word.toLowerCase()).find((word) => BANNED.has(word));
}

/**
 * Whether a node names a property of a value that may be declared elsewhere, such as an answer of the API.
 *
 * @param {any} node
 */
function isProperty(node) {
  const { parent } = node;
  if (parent.type === "MemberExpression") return parent.property === node && !parent.computed;
  return parent.type === "Property" && parent.key === node && !parent.shorthand;
}

/** @type {import("eslint").Rule.RuleModule} */
export const plainNames = {
  meta: { type: "problem", schema: [], messages: { banned: "“{{word}}” in “{{name}}”: use the term of the field." } },
  create(context) {
    /** @param {any} node @param {string} name @param {string | undefined} word */
    function report(node, name, word) {
      if (word !== undefined) context.report({ node, messageId: "banned", data: { name, word } });
    }
    /** @type {import("eslint").Rule.RuleListener} */
    const check = {
      Identifier(node) {
        if (!isProperty(node)) report(node, node.name, VAGUE.has(node.name) ? node.name : bannedWord(node.name));
      },
    };
    /** @type {import("eslint").Rule.RuleListener} */
    const script = {
      ...check,
      Program(node) {
        const name = basename(context.filename).replace(/\..*$/, "");
        report(node, name, bannedWord(name));
      },
    };
    const { defineTemplateBodyVisitor } = context.sourceCode.parserServices;
    return defineTemplateBodyVisitor?.(check, script) ?? script;
  },
};
