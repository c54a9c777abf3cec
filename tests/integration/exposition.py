"""Reads and checks metrics in the text format of Prometheus."""

import subprocess

from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

from kleinkram.metric_definitions import DEFINITIONS, MetricDefinition, MetricKind, MetricSource
from tests.requirements import need, path_of


def value(text: str, definition: MetricDefinition, **labels: str) -> float:
    """Return the value of one series, the count of a histogram; 0 if it is not there."""
    return sum(sample.value for sample in samples(text, definition) if labels.items() <= sample.labels.items())


def samples(text: str, definition: MetricDefinition) -> list[Sample]:
    """Return the series of a metric; of a histogram, those of its counts."""
    name = f"{definition.name}_count" if definition.kind is MetricKind.histogram else definition.name
    families = text_string_to_metric_families(text)
    return [sample for family in families for sample in family.samples if sample.name == name]


def assert_defined(text: str, *sources: MetricSource) -> None:
    """Check that all metrics of these sources, and no other, are exported as defined, and that each has counted."""
    families = {family.name: family for family in text_string_to_metric_families(text)}
    expected = {one.name.removesuffix("_total"): one for one in DEFINITIONS if one.source in sources}
    assert {name for name in families if not name.startswith("process_")} == expected.keys()
    for name, definition in expected.items():
        assert families[name].type == definition.kind.value
        assert families[name].documentation == definition.meaning
        series = samples(text, definition)
        assert series, f"{definition.name} has no value"
        for sample in series:
            assert {*sample.labels} == {*definition.labels}
            if definition.values:
                assert sample.labels[definition.labels[-1]] in definition.values, sample
        if definition.kind is not MetricKind.gauge:
            assert sum(sample.value for sample in series) > 0, f"{definition.name} has not counted"


def assert_accepted_by_promtool(text: str) -> None:
    """Check that Prometheus can read the metrics, and that they follow its conventions."""
    need("promtool")
    linted = subprocess.run([path_of("promtool") or "", "check", "metrics"], input=text, capture_output=True, text=True)
    assert (linted.returncode, linted.stdout, linted.stderr) == (0, "", "")
