# make setup | make page | make test | make test-docs | make docs | make results | make fuzz | make campaign | make demo | make demo-hand. Everything lives in .venv; nothing is installed elsewhere.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
STAMP := .venv/.installed
LIGHT := .venv/.installed-demo

# One thread a process: more of them on a busy machine are slower, not faster.
export OMP_NUM_THREADS := 1
# Bytecode is kept: the tests start many processes.
unexport PYTHONDONTWRITEBYTECODE

WEB := hrl_comfort/studio/web
PAGE := $(WEB)/dist/page.js

.PHONY: setup page test pytest test-docs docs results lint style types fuzz campaign demo demo-hand clean

setup: $(STAMP)

# The demo takes the studio, in which its report says to watch it, and no tool of the tests.
$(STAMP): EXTRAS := test,dev
$(LIGHT): EXTRAS := studio
$(STAMP) $(LIGHT): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable ".[$(EXTRAS)]"
	touch $@

# The program of the page that `hrl-comfort studio export=` writes; needs Node.
page: $(PAGE)

$(PAGE): $(WEB)/package-lock.json $(WEB)/build.mjs $(wildcard $(WEB)/src/*.js $(WEB)/licenses/*)
	cd $(WEB) && npm ci --no-fund --no-audit --loglevel=error && node build.mjs

lint: style types

style: setup
	$(BIN)/ruff check .
	$(BIN)/lint-imports

types: setup
	$(BIN)/mypy

# Where the page cannot be built, its tests are skipped. Types are checked beside the tests. COVERAGE=1 traces the
# package, which takes half as long again, and fails below 90 %.
test: style
	-$(MAKE) page
	$(MAKE) -j 2 types pytest

pytest: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal $(if $(filter 1,$(COVERAGE)),--cov --cov-report=term --cov-fail-under=90)

# Every command of docs/*.md and every example, with small budgets. Some minutes.
test-docs: setup
	$(BIN)/python -m pytest -n 2 -m docs tests/test_readme.py

# Published results and whether they are current; NAME=comfort makes one anew.
results: setup
	$(BIN)/hrl-comfort results $(if $(NAME),remake=$(NAME))

# The site, which opens from disk: build/docs/site/index.html. Its links, search and player are checked in a browser.
docs: setup page
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	$(BIN)/python docs/site/reference.py
	$(BIN)/python docs/site/build.py
	$(BIN)/python -m pytest -m site tests/test_site.py

# Contacts beside every motion and policy, until stopped; goes on where it was.
campaign: setup
	nice -n 19 $(BIN)/python -m tests.safety.campaign runs/safety_campaign.csv 30000 $(RECORDINGS)

# 10,000 generated inputs, drawn anew each time: what is said, files, streams, states. Some minutes.
# 2,000 damaged artefacts and 300 hostile command lines, each in a process of its own. An hour.
fuzz: setup
	HRL_COMFORT_INPUTS=$(or $(INPUTS),11000) $(BIN)/python -m pytest -q tests/*/test_generated_*.py
	$(BIN)/python -m tests.adversary 2000 300

demo: $(or $(wildcard $(STAMP)),$(LIGHT))
	$(BIN)/hrl-comfort train hierarchy experiment=demo output=runs/demo

# A third of the steps of experiment=grasp, in one cell.
demo-hand: $(or $(wildcard $(STAMP)),$(LIGHT))
	$(BIN)/hrl-comfort train hierarchy experiment=grasp cell=grasp agent.policy_steps=100000 agent.batch_size=128 \
	    hierarchy.budget_fractions='{pick: 0.9, place: 1.1, return: 0.3, cycle: 2.3}' \
	    hierarchy.terminal_states_episodes=300 hierarchy.jobs=2 hierarchy.episodes=60 output=runs/demo_hand

clean:
	rm -rf $(WEB)/dist $(WEB)/node_modules .venv build dist *.egg-info .coverage .coverage.* .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
