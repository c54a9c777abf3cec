// The queries of logs and traces in deploy/observability, by the grammars that Grafana's editors use. No server of
// either runs here. It is in this folder because npm installs the grammars here.
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { parser as logql } from "@grafana/lezer-logql";
import { parser as traceql } from "@grafana/lezer-traceql";
import { describe, expect, it } from "vitest";

interface Panel {
  title: string;
  datasource?: { type: string };
  targets?: { expr?: string; query?: string }[];
  fieldConfig?: { defaults?: { links?: { url: string }[] } };
}

interface Pane {
  datasource: string;
  queries: { expr?: string; query?: string }[];
}

const grafana = join(import.meta.dirname, "../../../deploy/observability/grafana");
const files = readdirSync(join(grafana, "dashboards")).filter((name) => name.endsWith(".json"));
const panels = files.flatMap((name) => {
  const document = JSON.parse(readFileSync(join(grafana, "dashboards", name), "utf8")) as { panels: Panel[] };
  return document.panels;
});
const panes = panels
  .flatMap((panel) => panel.fieldConfig?.defaults?.links ?? [])
  .flatMap((link) => {
    const encoded = /panes=([^&]*)/.exec(link.url)?.[1] ?? "";
    return Object.values(JSON.parse(decodeURIComponent(encoded)) as Record<string, Pane>);
  });
const sources = readFileSync(join(grafana, "provisioning/datasources/kleinkram.yaml"), "utf8");

function queriesOf(type: string): string[] {
  const shown = panels.filter((panel) => panel.datasource?.type === type).flatMap((panel) => panel.targets ?? []);
  const linked = panes.filter((pane) => pane.datasource === `\${${type}}`).flatMap((pane) => pane.queries);
  const provisioned = type === "loki" ? [...sources.matchAll(/(?:url|query): '(\{.*)'/g)].map((match) => match[1] ?? "") : [];
  return [...[...shown, ...linked].map((target) => target.expr ?? target.query ?? ""), ...provisioned].map((query) =>
    query.replaceAll(/\$+\{[\w.]+\}/g, "x"),
  );
}

function errorsOf(grammar: typeof logql, query: string): string[] {
  const errors: string[] = [];
  grammar.parse(query).iterate({
    enter: (node) => {
      if (node.type.isError) errors.push(`${query} at ${node.from}`);
    },
  });
  return errors;
}

describe.each([
  { language: "LogQL", type: "loki", grammar: logql },
  { language: "TraceQL", type: "tempo", grammar: traceql },
])("$language", ({ type, grammar }) => {
  it("is what every query is written in", () => {
    const queries = queriesOf(type);
    expect(queries.length).toBeGreaterThan(4);
    expect(queries.flatMap((query) => errorsOf(grammar, query))).toEqual([]);
  });

  it("does not allow an unclosed selector", () => {
    expect(errorsOf(grammar, '{ resource.service.name = "x"')).not.toEqual([]);
  });
});
