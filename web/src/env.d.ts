// Only for eslint, which does not read .vue files as types; vue-tsc reads the files themselves.
declare module "*.vue" {
  import type { DefineComponent } from "vue";

  const component: DefineComponent;
  export default component;
}
