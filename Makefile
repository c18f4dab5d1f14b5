# The whole house from one file. `make help` lists the targets.
PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.ready
#: What runs the service alone: a quarter of what the tests need.
SERVES := $(VENV)/.serves
SHELL  := bash
.SHELLFLAGS := -o pipefail -c
# A second Python, for `make test-python` alone.
OTHER      ?= python3.13
OTHER_VENV := .venv-other

# Three on two cores: tests wait for the processes that they start. A worker that a hanging test ended is not started
# anew: it would only hang at the same test.
WORKERS := -n 3 --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# The tests start some two hundred processes: each finds the modules compiled, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help

help:            ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 18

setup: $(STAMP)  ## virtual environment with the locked versions

$(STAMP): requirements/dev.lock pyproject.toml
	$(call install,$<)
	@touch $(STAMP) $(SERVES)

# Where the tests' environment is, nothing is to be done: it serves, too.
$(SERVES): requirements/serve.lock pyproject.toml
	$(call install,$<)
	@touch $(SERVES)

# The packages of a lock file and the product itself, into $(VENV), with a line that counts.
define install
	@command -v $(PYTHON) >/dev/null || { echo "Python 3.11 is needed; '$(PYTHON)' was not found. Set PYTHON=/path/to/python3.11."; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --progress-bar off --no-deps --require-hashes -r $(1) | awk -v n=$$(grep -c == $(1)) \
		'/^Collecting/ {printf "\rSetting up $(VENV): %d of %d packages fetched", ++i, n; fflush()} \
		/^Installing/ {printf "; installing them"; fflush()} END {print ""}'
	@$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
endef

# Programs that tests use and pip does not bring, with the packages of Debian that do; Firefox is for `make test-all`.
TOOLS := chromium-headless-shell:chromium-headless-shell caddy:caddy mosquitto:mosquitto promtool:prometheus
test-all: TOOLS += firefox-esr:firefox-esr

tools:           ## what tests need of Debian: a browser, a broker, a proxy, promtool (installs what is missing, as root)
	@packages=; for tool in $(TOOLS); do command -v $${tool%%:*} >/dev/null || packages="$$packages $${tool##*:}"; done; \
	if [ -z "$$packages" ]; then exit 0; fi; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get -qq update && \
		DEBIAN_FRONTEND=noninteractive apt-get -qq install --yes --no-install-recommends $$packages >/dev/null; \
	then exit 0; else echo "Not installed:$$packages. Tests of pages need chromium; those of Firefox, a broker, a proxy and rules are left out without the others."; fi

demo: $(SERVES)  ## replay the bundled sessions through the live service; prints trend and alarms
	$(BIN)/preload demo

static: setup    ## lint, types, import contracts, and the docs as a site
	$(BIN)/python -m ruff check .
	$(BIN)/python -m mypy
	$(BIN)/lint-imports
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

test: setup tools       ## static checks, and tests of every kind of behaviour, side by side
	@$(MAKE) --no-print-directory -j2 static tests-of-every-kind

tests-of-every-kind: setup
	$(BIN)/python -m pytest $(WORKERS) -m "not release"

test-all: static tools  ## static checks and every test, as before a release
	$(BIN)/python -m pytest $(WORKERS)

coverage: setup  ## every test with coverage measured and printed (takes twice the time of `make test-all`)
	$(BIN)/python -m pytest $(WORKERS) --cov --cov-report=term

test-python:     ## the tests of `make test` on another Python: make test-python OTHER=python3.13
	@$(OTHER) --version >/dev/null 2>&1 || { echo "'$(OTHER)' does not run. Set OTHER=/path/to/python3.13."; exit 1; }
	$(OTHER) -m venv $(OTHER_VENV)
	$(OTHER_VENV)/bin/python -m pip install --quiet --no-deps --require-hashes -r requirements/dev.lock
	$(OTHER_VENV)/bin/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	$(OTHER_VENV)/bin/python -m pytest $(WORKERS) -m "not release"

check: test      ## the same as `make test`

serve: $(SERVES) ## the service on this machine (loopback, SQLite under ./var)
	$(BIN)/preload serve

docs: setup      ## the pages of docs/ as a site, in build/site (needs no network)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

bench: setup     ## speed against peers, kills by the hundred, growth, a plant of axes, hostile senders
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.kills --kills 200
	$(BIN)/python -m benchmarks.several_services kills --kills 120
	$(BIN)/python -m benchmarks.arrival_orders --orders 200
	$(BIN)/python -m benchmarks.history growth
	$(BIN)/python -m benchmarks.many_axes --axes 1000 --days 30
	$(BIN)/python -m benchmarks.pages
	$(BIN)/python -m benchmarks.hostile_bodies --mib 63
	$(BIN)/python -m benchmarks.hostile_connections --rounds 5

replay-data: setup  ## write replay_data/ again from the independent plant
	$(BIN)/python -m tests.hidden_effects.write_example
	$(BIN)/python -m tests.plant.write_replay_data

plots: setup     ## draw docs/figures again
	$(BIN)/python -m benchmarks.plots

pictures: setup  ## take docs/pictures again, from the pages of the trial (needs chromium)
	$(BIN)/python -m benchmarks.pictures

LOCK := $(BIN)/uv pip compile --quiet --generate-hashes --no-header --python-version 3.11

lock:            ## resolve the three lock files again from pyproject.toml
	$(LOCK) --all-extras -o requirements/dev.lock pyproject.toml
	$(LOCK) --extra tdms --extra uff --extra xlsx --extra mqtt --extra build -c requirements/dev.lock -o requirements/serve.lock pyproject.toml
	$(LOCK) --extra formats --extra postgres --extra mqtt --extra opcua --extra s3 --extra batch --extra build -c requirements/dev.lock -o requirements/runtime.lock pyproject.toml

clean:           ## remove the virtual environment and caches
	rm -rf $(VENV) $(OTHER_VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

.PHONY: help setup tools demo static test tests-of-every-kind test-all coverage test-python check serve docs bench replay-data plots pictures lock clean
