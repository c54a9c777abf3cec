import { VueQueryPlugin } from "@tanstack/vue-query";
import { Quasar } from "quasar";
import icons from "quasar/icon-set/svg-mdi-v7.js";
import { createApp } from "vue";
import "quasar/dist/quasar.css";
import "@/css/tokens.css";
import "@/css/base.css";
import "@/css/quasar.css";
import App from "./App.vue";
import { createQueries } from "@/api/queries";
import { openRouter } from "@/router";

const queries = createQueries();
createApp(App)
  .use(VueQueryPlugin, { queryClient: queries })
  .use(Quasar, { iconSet: icons })
  .use(openRouter(queries))
  .mount("#app");
