# Two commands do everything on a fresh machine with python3 (3.11 or newer), venv and make:
#   make demo    a stiff wall on the virtual bus: energy table, logs, and a picture of it unprotected and guarded
#   make test    every check, in at most five minutes
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= auto
SOURCES := canhaptic tests tools

# The tests start hundreds of processes: none compiles the package anew, even where this variable is set.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test test-all test-campaigns test-socketcan test-wire format bench docs docs-version dist clean

# make test PINNED=1: exactly the versions of constraints.txt (Python 3.11 on Linux), by hash
PINNED ?=
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile  # what is imported is compiled then, a third of it

# One stamp per set of extras: a changed pyproject.toml installs again.
$(VENV)/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit("canhaptic needs Python 3.11 or newer, this is " + sys.version) if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed-%: pyproject.toml | $(VENV)/bin/pip
	@echo "installing what [$*] asks for into $(VENV): a minute or two, once"
	$(if $(PINNED),$(INSTALL) --require-hashes -r constraints.txt)
	$(INSTALL) $(if $(PINNED),--no-deps --no-build-isolation) --editable ".[$*]"
	@touch $@

DEMO := configs/hard/stiff_wall.yaml

demo: $(VENV)/.installed-plot
	@mkdir -p demo_output
	$(BIN)/canhaptic run $(DEMO) --pace free --force --log demo_output/demo.h5 --bus-log demo_output/demo.log
	$(BIN)/canhaptic compare $(DEMO) --algorithms unprotected,guarded --png demo_output/demo.png

# Rewriting every assert of a fresh tree costs each worker 13 s of CPU: what fails runs again with it, and has failed.
FAST := $(BIN)/pytest -q -n $(JOBS) --dist worksteal -m "not slow"

test: $(VENV)/.installed-dev
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/lint-imports
	@echo "mypy works at the same time as the tests; what it finds stands after them"
	@$(BIN)/mypy > $(VENV)/types.txt 2>&1 & types=$$!; \
	$(FAST) --assert=plain || { $(FAST) --last-failed; false; }; tests=$$?; \
	wait $$types; typed=$$?; cat $(VENV)/types.txt; exit $$((tests || typed))

# Tests that need Debian's `chromium` or `tshark` skip, visibly, where those are absent; so does the machine of
# test-socketcan, which is built in one folder and so not by two workers at once.
SLOW := $(BIN)/pytest -q -n $(JOBS) --dist worksteal -m "(slow or hypothesis) and not campaign" --hypothesis-profile=thorough

test-all: test $(VENV)/.installed-report,export,docs,release
	$(BIN)/python tools/record.py --check
	$(SLOW) tests/lab  # apart: numba gives the memory of compiled loops back only when a process ends
	$(SLOW) --ignore tests/lab --ignore tests/socketcan_vm --ignore tests/wire

# What takes hours, a browser, or a machine of its own; each line can be run alone.
test-campaigns: $(VENV)/.installed-dev $(VENV)/.installed-report,export
	$(MAKE) test-socketcan
	$(MAKE) test-wire
	$(BIN)/pytest -q -n 0 -m campaign
	$(BIN)/python -m tools.numba_minors
	$(BIN)/python -m tools.bench.truth
	$(BIN)/python -m tools.bench.truth --faults
	$(BIN)/python -m tools.bench.truth --stops
	$(BIN)/python -m tools.bench.truth --false --runs 2000

# Linux's own CAN stack in a virtual machine; the packages it needs are named in tests/socketcan_vm/README.md.
test-socketcan: $(VENV)/.installed-dev
	$(BIN)/pytest -q -n 0 -m slow tests/socketcan_vm

# Foreign EtherCAT masters on the simulated drives over a veth pair: needs root, pysoem, tshark, and kickcat for one test.
test-wire: $(VENV)/.installed-dev $(VENV)/.installed-ethercat
	$(BIN)/pytest -q -n 0 -m slow tests/wire

format: $(VENV)/.installed-dev
	$(BIN)/ruff format $(SOURCES)
	$(BIN)/ruff check --fix $(SOURCES)

# make bench            every question;  make bench Q=cycle   one; results go to bench_output/, or to OUT=FOLDER
# make bench RECORD=1   replaces the results in docs/results that the pages are made from
# The question `simulation` has peers; one that cannot be installed is a row "peer absent".
bench: $(VENV)/.installed-dev $(VENV)/.installed-report,export
	$(if $(filter-out simulation,$(Q)),,-$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[bench,fast]")
	$(BIN)/python tools/bench/run.py $(Q) $(if $(RECORD),--record,$(if $(OUT),--out $(OUT)))

# The documentation as a site in site/, strict; NO_MKDOCS_2_WARNING silences the theme's notice of its successor.
docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# The same as one more version of a site, committed to the branch gh-pages: make docs-version VERSION=0.3.0
docs-version: $(VENV)/.installed-docs
	PATH="$(CURDIR)/$(BIN):$$PATH" NO_MKDOCS_2_WARNING=1 mike deploy --update-aliases $(VERSION) latest

# sdist and wheel in dist/, the same bytes of the same commit; after make test PINNED=1, whose setuptools it takes
dist:
	$(BIN)/python -m tools.make_dist

clean:
	rm -rf $(VENV) build dist *.egg-info demo_output bench_output site
