import js from "@eslint/js";
import vue from "eslint-plugin-vue";
import tseslint from "typescript-eslint";
import vueParser from "vue-eslint-parser";
import { plainNames } from "./scripts/names.mjs";

export default tseslint.config(
  { ignores: ["node_modules/**", "src/api/schema.d.ts", "public/**"] },
  {
    files: ["src/**/*.ts", "src/**/*.vue"],
    extends: [js.configs.recommended, ...tseslint.configs.strictTypeChecked, ...vue.configs["flat/recommended"]],
    languageOptions: {
      parser: vueParser,
      parserOptions: {
        parser: tseslint.parser,
        project: "./tsconfig.lint.json",
        tsconfigRootDir: import.meta.dirname,
        extraFileExtensions: [".vue"],
      },
    },
    plugins: { kleinkram: { rules: { "plain-names": plainNames } } },
    rules: {
      "kleinkram/plain-names": "error",
      "no-duplicate-imports": "error",
      "no-undef": "off", // checked by TypeScript
      "no-console": "error",
      "@typescript-eslint/restrict-template-expressions": ["error", { allowNumber: true }],
      "@typescript-eslint/no-confusing-void-expression": ["error", { ignoreArrowShorthand: true }],
      "@typescript-eslint/consistent-type-imports": "error",
      "vue/no-v-html": "error",
      "vue/no-static-inline-styles": "error", // refused by the content security policy in hoisted markup
      "vue/component-api-style": ["error", ["script-setup"]],
      "vue/block-lang": ["error", { script: { lang: "ts" } }],
      "vue/define-macros-order": "error",
      "vue/no-bare-strings-in-template": ["error", { allowlist: ["·", "/", "–", "—", ":", ",", ".", "(", ")", "×", "+", "#", "%"] }],
      "max-lines": ["error", { max: 250 }],
      // Line breaks in templates are free.
      "vue/max-attributes-per-line": "off",
      "vue/singleline-html-element-content-newline": "off",
      "vue/html-self-closing": "off",
      "vue/html-indent": "off",
      "vue/html-closing-bracket-newline": "off",
      "vue/first-attribute-linebreak": "off",
      "vue/multiline-html-element-content-newline": "off",
    },
  },
  { files: ["src/**/*.ts"], rules: { "max-lines": ["error", { max: 400 }] } },
  { files: ["src/**/*.test.ts", "src/texts/**/*.ts"], rules: { "max-lines": "off" } },
  { files: ["scripts/**/*.mjs"], extends: [js.configs.recommended], languageOptions: { globals: { URL: "readonly" } } },
);
