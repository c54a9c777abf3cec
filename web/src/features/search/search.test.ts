import { flushPromises, mount } from "@vue/test-utils";
import { afterEach, beforeEach, expect, it, test, vi } from "vitest";
import SearchBox from "./SearchBox.vue";
import { QueryClient, VueQueryPlugin } from "@tanstack/vue-query";
import { createMemoryHistory, createRouter } from "vue-router";
import SearchPage from "./SearchPage.vue";
import { downloadScript, markedAt, withTerm } from "./queries";
import { searchCommands } from "@/components/commands";

beforeEach(() => vi.useFakeTimers());
afterEach(() => vi.useRealTimers());

function box(text: string) {
  const wrapper = mount(SearchBox, { props: { modelValue: text, syntaxError: null } });
  const input = wrapper.get<HTMLInputElement>("input");
  const lastQuery = () => wrapper.emitted<[string]>("update:modelValue")?.at(-1)?.[0];
  return { wrapper, input, lastQuery };
}

test("what is typed while the address changes stays", async () => {
  const { wrapper, input, lastQuery } = box("");
  await input.setValue("alp");
  vi.advanceTimersByTime(350);
  expect(lastQuery()).toBe("alp");
  await input.setValue("alps");
  await wrapper.setProps({ modelValue: "alp" }); // only now it has changed
  expect(input.element.value).toBe("alps");
  vi.advanceTimersByTime(350);
  expect(lastQuery()).toBe("alps");
});

test("a text that comes from elsewhere takes the place of what was typed", async () => {
  const { wrapper, input, lastQuery } = box("alps");
  await input.setValue("alps lakes");
  await wrapper.setProps({ modelValue: "alps format:mcap" });
  expect(input.element.value).toBe("alps format:mcap");
  vi.advanceTimersByTime(350);
  expect(lastQuery()).toBeUndefined();
});

test("going back to what was asked before is seen", async () => {
  const { wrapper, input } = box("alps");
  await input.setValue("lakes");
  vi.advanceTimersByTime(350);
  await wrapper.setProps({ modelValue: "lakes" });
  await wrapper.setProps({ modelValue: "alps" });
  expect(input.element.value).toBe("alps");
});

const PAUSE_MS = 350;
vi.setConfig({ testTimeout: 60_000 }); // the first mounting of a whole page takes long on a busy machine
/** Answers of the search by its text; those that are missing are still on their way. */
const answers = new Map<string, { status: number; body: unknown }>();
let waiting: { query: string; resolve: (response: Response) => void }[] = [];

function searchAnswer(query: string, total: number): { status: number; body: unknown } {
  const page = { items: [], next: null, total };
  return { status: 200, body: { query, means: query, is_exact: true, files: page, missions: page, topics: page } };
}

function answered({ status, body }: { status: number; body: unknown }): Response {
  return new Response(JSON.stringify(body), { status, headers: { "content-type": status === 200 ? "application/json" : "application/problem+json" } });
}

function respond(request: Request): Promise<Response> {
  const url = new URL(request.url);
  const query = url.searchParams.get("query") ?? "";
  if (url.pathname.endsWith("/facets")) return Promise.resolve(answered({ status: 200, body: { query, is_exact: true, file_count: 1, facets: [] } }));
  if (!url.pathname.endsWith("/search")) return Promise.resolve(answered({ status: 404, body: {} }));
  const answer = answers.get(query);
  return answer ? Promise.resolve(answered(answer)) : new Promise((resolve) => waiting.push({ query, resolve }));
}

async function page() {
  const router = createRouter({ history: createMemoryHistory(), routes: [{ path: "/:rest(.*)*", name: "search", component: SearchPage }] });
  await router.push("/search?q=alps");
  const client = new QueryClient({ defaultOptions: { queries: { retry: false, staleTime: 30_000 } } });
  const wrapper = mount(SearchPage, {
    global: { plugins: [router, [VueQueryPlugin, { queryClient: client }]], stubs: { DataTable: true, RouterLink: { template: "<a><slot /></a>" } } },
  });
  await settled();
  const results = () => wrapper.find("[data-results]");
  const counts = () => wrapper.findAll("[data-results] nav .count").map((item) => item.text());
  const type = async (text: string) => wrapper.get("input").setValue(text);
  return { wrapper, results, counts, type };
}

async function settled(): Promise<void> {
  await vi.advanceTimersByTimeAsync(PAUSE_MS + 50);
  await flushPromises();
}

beforeEach(() => {
  vi.useFakeTimers();
  vi.stubGlobal("fetch", respond);
  vi.stubGlobal("ResizeObserver", class { observe() {} disconnect() {} });
  answers.clear();
  waiting = [];
  answers.set("alps", searchAnswer("alps", 7));
});
afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

test("results are greyed and uncounted as soon as something else is typed, until its own are there", async () => {
  const { results, counts, type, wrapper } = await page();
  expect(counts()).toEqual(["7", "7", "7"]);
  expect(results().classes()).not.toContain("stale");
  await type("lakes");
  expect(results().classes()).toContain("stale");
  expect(wrapper.get("[data-facet-groups]").classes()).toContain("stale");
  expect(counts()).toEqual([]);
  await settled(); // asked for, not answered
  expect(waiting.map(({ query }) => query)).toEqual(["lakes"]);
  expect(results().classes()).toContain("stale");
  expect(counts()).toEqual([]);
  waiting[0]?.resolve(answered(searchAnswer("lakes", 2)));
  await settled();
  expect(results().classes()).not.toContain("stale");
  expect(results().attributes("data-query")).toBe("lakes");
  expect(counts()).toEqual(["2", "2", "2"]);
});

test("a search that fails shows its failure, and no results of an earlier one", async () => {
  answers.set("lakes", { status: 503, body: { code: "database_unavailable", status: 503, title: "x", detail: "The database is away.", request_id: "r" } });
  const { results, type, wrapper } = await page();
  await type("lakes");
  await settled();
  expect(wrapper.text()).toContain("The database is away.");
  expect(results().exists()).toBe(false);
  await type("alps");
  await settled();
  expect(wrapper.text()).not.toContain("The database is away.");
  expect(results().attributes("data-query")).toBe("alps");
});

it("quotes what a shell would read otherwise", () => {
  expect(searchCommands("alps topic:/imu/*").cli).toBe("klein search 'alps topic:/imu/*'");
  expect(searchCommands("").cli).toBe("klein search ''");
  expect(searchCommands("-label:draft").cli).toBe("klein search -- -label:draft");
});

it("writes a script in which lines of a query stay within their quotes", () => {
  const script = downloadScript('"a\nrm -rf b"', "http://lab:8000", "Fetches.");
  expect(script).toContain("--query '\"a\nrm -rf b\"' --dest");
  expect(script).toContain('KLEINKRAM_URL="${KLEINKRAM_URL:-http://lab:8000}"');
});

it("adds terms as the server reads them", () => {
  expect(withTerm("alps", "topic", "/imu")).toBe("alps topic:/imu");
  expect(withTerm("", "topic", 'a "b"')).toBe('topic:"a \\"b\\""');
});

it("finds the place of what is wrong by characters", () => {
  expect(markedAt("🤖 size:big x", 3, "size:big")).toEqual({ before: "🤖 ", wrong: "size:big", after: " x" });
  expect(markedAt('a "open', 3, '"open')).toEqual({ before: "a ", wrong: '"open', after: "" });
});
