# Two commands matter: make demo, make test. Both set up .venv from pinned packages first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-for-the-demo
DOCS_STAMP := $(VENV)/.installed-for-the-docs
# uv, where it is there, installs the same in less time.
UV := $(shell command -v uv 2>/dev/null)
INSTALL := $(if $(UV),$(UV) pip install --python $(BIN)/python,$(BIN)/python -m pip install --disable-pip-version-check)
# Python compiles what it loads, a quarter of it, instead of pip all that was installed, for half a minute. uv does the same.
PLAIN := $(if $(UV),,--no-compile)
# How many cases tests count: quick for a newcomer, ci as .ci/run has them, full with make test-full.
export FK_LEVEL ?= quick
# Dozens of processes load the same files: what Python has compiled of them is kept, whatever a machine's settings say.
unexport PYTHONDONTWRITEBYTECODE
# Where nothing can be kept in the home folder pip would fail as soon as it has to build a wheel.
ifneq ($(shell mkdir -p "$${XDG_CACHE_HOME:-$$HOME/.cache}" 2>/dev/null && echo kept),kept)
export PIP_NO_CACHE_DIR := 1
endif
# Tests side by side; how many processes tests/conftest.py says. A file's tests stay together and share what they built.
SPREAD := -n logical --dist loadfile --no-loadscope-reorder --durations 25 --durations-min 3

.PHONY: demo test test-full bench extra docs docs-check lint types check venv clean

demo: $(DEMO_STAMP)
	$(BIN)/frogkick demo --out demo

test: $(STAMP)
	$(BIN)/python -m pytest $(SPREAD) -m "not extra"

test-full: $(STAMP)
	FK_LEVEL=full $(BIN)/python -m pytest $(SPREAD)

# What simulating costs and starting a command, about a minute. PyElastica is compared with where it can be fetched.
bench: $(STAMP)
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check pyelastica==1.0.0
	PYTHONPATH=. $(BIN)/python -m tests.bench.rods
	PYTHONPATH=. $(BIN)/python -m tests.bench.startup

# Needs tools that are no wheels (ARM gcc, QEMU, cppcheck, gcc, clang); says which are not there.
extra: $(STAMP)
	$(BIN)/python -m pytest $(SPREAD) -m extra

# The documentation, into build/docs: a broken link is an error. What its code blocks do is checked apart, in docs-check.
docs: $(DOCS_STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict -f host/docs/mkdocs.yml
	@echo "open build/docs/index.html"

# The code blocks of the documentation run, each page's in a folder of its own: minutes.
docs-check: $(STAMP)
	$(BIN)/python host/docs/run_blocks.py

check: test extra docs docs-check lint types

lint: $(STAMP)
	$(BIN)/ruff check host codegen tests firmware
	$(BIN)/ruff format --check host codegen tests firmware

types: $(STAMP)
	$(BIN)/mypy host/frogkick host/studies/frogkick_studies codegen/frogkick_codegen

venv: $(STAMP)

define NEW_VENV
@$(PYTHON) -c 'import sys; v = sys.version_info; v >= (3, 11) or sys.exit("frogkick needs Python 3.11 or newer, this is %d.%d: set PYTHON=python3.11" % v[:2])'
$(PYTHON) -m venv $(VENV)
endef

$(STAMP): pyproject.toml requirements.lock
	$(NEW_VENV)
	@echo "installing $$(grep -c '==' requirements.lock) packages into $(VENV), once: what was tried together (requirements.lock)"
	$(INSTALL) $(PLAIN) -r requirements.lock
	$(INSTALL) $(PLAIN) --no-deps --no-build-isolation -e .
	@touch $(STAMP) $(DEMO_STAMP)

# Half of them: without what only tests, cameras on tags of another family, clusters and probes need.
$(DEMO_STAMP): pyproject.toml requirements.lock
	$(NEW_VENV)
	@echo "installing what the demo needs into $(VENV), once: versions as in requirements.lock"
	$(INSTALL) -c requirements.lock setuptools
	$(INSTALL) $(PLAIN) -c requirements.lock --no-build-isolation -e '.[firmware]'
	@touch $(DEMO_STAMP)

$(DOCS_STAMP): $(STAMP) host/docs/requirements.lock
	$(INSTALL) -r requirements.lock -r host/docs/requirements.lock
	@touch $(DOCS_STAMP)

clean:
	rm -rf $(VENV) build demo out
