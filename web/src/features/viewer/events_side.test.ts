import { flushPromises, mount } from "@vue/test-utils";
import { expect, it, vi } from "vitest";
import { computed, ref, shallowRef } from "vue";
