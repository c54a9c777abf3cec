import { createApp } from "vue";
import "@/css/tokens.css";
import App from "./App.vue";

createApp(App).mount("#app");
