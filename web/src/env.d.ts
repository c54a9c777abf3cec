// For eslint alone, which does not read .vue files as types; vue-tsc takes the files themselves.
declare module "*.vue" {
  import type { DefineComponent } from "vue";

  const component: DefineComponent;
  export default component;
}
