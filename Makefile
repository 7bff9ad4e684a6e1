# make test        lint, spelling, types, fast tests    make reproduce   the main job: figures and report under runs/
# make test-slow   the slow tests                       make smoke       every experiment and notebook in brief
# make test-peers  the tests beside PyTorch             make test-all    all four kinds of tests, as CI runs them
# make docs        the site: spelling, links, API        make docs-all    the same with the notebooks executed
# make bench       speed against peers                    make format      rewrite the code in our format
# make clean       remove the environment and the caches
# Needs Python >= 3.11 with venv; name another interpreter with PYTHON=...

VENV    ?= .venv
WORKERS ?= 2

RECENT := import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))
# python3 may be older than what stands beside it: take the first that will do.
ifndef PYTHON
PYTHON := $(shell for p in python3 python3.12 python3.11 python3.13 python; do \
	$$p -c '$(RECENT)' >/dev/null 2>&1 && { echo $$p; break; }; done)
endif

BIN   := $(VENV)/bin
SPEC  := pyproject.toml constraints.txt
PIP   := $(BIN)/python -m pip --disable-pip-version-check

.PHONY: test test-slow test-peers test-all smoke reproduce docs docs-all bench format clean
.DELETE_ON_ERROR:

test: $(VENV)/.stamp-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/mypy sonarjax
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m "not slow"

test-peers: $(VENV)/.stamp-all
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -k pytorchs tests/segment

test-slow: $(VENV)/.stamp-all
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m slow -k "not pytorchs"

test-all: test test-slow test-peers smoke

smoke: $(VENV)/.stamp-smoke
	$(BIN)/python -m experiments --smoke --workers $(WORKERS)
	$(BIN)/python -m notebooks.run

reproduce: $(VENV)/.stamp-base
	$(BIN)/python -m experiments.reproduce_paper
	$(BIN)/python -m experiments.paper_scenes
	$(BIN)/python -m paper_figs --all --out runs/figures --report "$(CURDIR)/runs/report.html"

docs: $(VENV)/.stamp-docs
	$(BIN)/codespell
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going -b html -c docs . docs/_build/html
	$(BIN)/python docs/check_links.py docs/_build/html

docs-all: $(VENV)/.stamp-docs $(VENV)/.stamp-smoke
	$(BIN)/python -m notebooks.run
	SONARJAX_NOTEBOOKS=runs/notebooks $(MAKE) docs

bench: $(VENV)/.stamp-bench
	$(BIN)/python -m experiments.bench_all

format: $(VENV)/.stamp-test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) build dist docs/_build docs/api *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

# One environment; each stamp says which extra of it is installed, and is older than the files that decide what.
$(VENV)/.stamp-base: EXTRA :=
$(VENV)/.stamp-test: EXTRA := [test]
$(VENV)/.stamp-smoke: EXTRA := [test,notebooks]
$(VENV)/.stamp-all: EXTRA := [test,notebooks,peers]
$(VENV)/.stamp-bench: EXTRA := [bench]
$(VENV)/.stamp-docs: EXTRA := [docs]

$(VENV)/.stamp-base $(VENV)/.stamp-test $(VENV)/.stamp-smoke $(VENV)/.stamp-all $(VENV)/.stamp-bench $(VENV)/.stamp-docs: $(SPEC)
	@$(or $(PYTHON),false) -c '$(RECENT)' 2>/dev/null || \
		{ echo "sonarjax needs Python 3.11 or newer with venv and pip: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PIP) --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@echo "Installing sonarjax$(EXTRA) into $(VENV) (once, a few minutes)"
	@$(PIP) install --quiet --constraint constraints.txt --editable ".$(EXTRA)"
	@touch $@
