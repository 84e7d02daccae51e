# Every target sets up what it needs first; where that is done already, it starts at once.
#   make demo ARGS="--rig emulated"      make test ARGS="tests/hub -x"

PYTHON ?= python3
VENV ?= .venv
ARGS ?=
MATRIX ?= 3.10-newest 3.11-newest 3.12-oldest 3.14-newest

# What each takes: tests/workers.py.
WORKERS = -n auto

SETUP = $(PYTHON) bootstrap.py --venv $(VENV)

# The tracker as machine code is tried in a copy of the tree, and in an environment of its own.
COMPILED = $(PYTHON) $(CURDIR)/bootstrap.py --venv .venv-compiled --extras ros,test,compiled,dev --

# The matrices here are small: more threads only take the processors from the real-time nodes.
export OMP_NUM_THREADS = 1
export OPENBLAS_NUM_THREADS = 1

# Tests and demos start many processes from this tree: they share what Python has compiled.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-all verify lint firmware mutants docs dist compiled test-compiled test-matrix clean distclean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s  %s\n", $$1, $$2 }' Makefile

setup: ## make the environment in .venv with ROS 2, the camera and the serial port
	@$(SETUP)

demo: ## the whole experiment without hardware (ARGS: see `beam demo --help`)
	@$(SETUP) -- beam demo $(ARGS)

test: ## the quick tests of all rooms (ARGS: for pytest)
	@$(SETUP) --extras ros,test -- python -m pytest $(WORKERS) $(ARGS)

test-all: ## all tests: also long fits, real processes and nodes, firmware, the compiled tracker (ARGS: for pytest)
	@$(SETUP) --extras ros,test -- python -m pytest --all $(WORKERS) $(ARGS)
	@if command -v $(CC) >/dev/null; then $(MAKE) --no-print-directory test-compiled ARGS=; \
	else echo "== the compiled tracker: left out, no C compiler on this machine"; fi

verify: ## the figures of the documentation at full length, which takes hours
	@$(SETUP) --extras ros,test,browser -- python -m pytest --verify $(ARGS)

lint: ## style, types, and which room imports which
	@$(SETUP) --extras ros,test,dev -- ruff check .
	@$(SETUP) --extras ros,test,dev -- ruff format --check .
	@$(SETUP) --extras ros,test,dev -- mypy
	@$(SETUP) --extras ros,test,dev -- lint-imports --no-cache --no-logo
	@$(SETUP) --extras ros,test,dev -- python .ci/rooms.py

firmware: ## the firmware for all that this machine has compilers for, checked (see docs/firmware.md)
	@$(MAKE) -C firmware

mutants: ## seeded mutations of the code against its tests (ARGS="--count 200 --seed 1 --workers 2")
	@$(SETUP) --extras ros,test,dev -- python -m tests.mutants $(ARGS)

docs: ## the pages of docs/ and the API reference as HTML, into build/docs (warnings are errors)
	@$(SETUP) --extras rig,docs -- python -m sphinx -W --keep-going -q -E -b html docs build/docs
	@echo "build/docs/index.html"

dist: ## archive and wheel into dist/, checked, with a list of components and checksums
	@rm -rf dist
	@$(SETUP) --extras ros,test,dev -- python -m build -o dist
	@$(SETUP) --extras ros,test,dev -- python -m twine check --strict dist/*
	@$(SETUP) --extras ros,test,dev -- check-manifest
	@$(SETUP) --extras ros,test,dev -- python .ci/release.py seal dist

compiled: ## a copy of the tree with the tracker as machine code, in build/compiled (needs a C compiler)
	@rm -rf build/compiled && mkdir -p build/compiled
	@tar -c --exclude='./.*' --exclude=./build --exclude=./dist --exclude=./runs . | tar -x -C build/compiled
	@cd build/compiled && $(COMPILED) env BEAM_COMPILE=1 python setup.py -q build_ext --inplace

test-compiled: compiled ## the tracker's tests on that machine code (ARGS: for pytest)
	@cd build/compiled && $(COMPILED) env PYTHONPATH=. python -m pytest $(WORKERS) \
		tests/beam_ros/vision/tracking tests/packaging/test_machine_code.py $(ARGS)

test-matrix: ## the tests on several Pythons, newest and oldest requirements (MATRIX="3.12-oldest ...")
	@failed=; tried=; for cell in $(MATRIX); do \
		python=$${cell%-*}; constraint=.ci/$${cell#*-}.txt; \
		if ! $(PYTHON) bootstrap.py --python $$python --print-python >/dev/null; then \
			echo "== $$cell: left out, no Python $$python on this machine"; continue; \
		fi; \
		echo "== $$cell"; tried="$$tried $$cell"; \
		$(PYTHON) bootstrap.py --venv .venv-$$cell --python $$python --extras ros,test --constraint $$constraint \
			-- python -m pytest $(WORKERS) $(ARGS) || failed="$$failed $$cell"; \
	done; \
	if [ -n "$$failed" ]; then echo "== failed:$$failed"; exit 1; fi; \
	if [ -z "$$tried" ]; then echo "== none of $(MATRIX) could be tried; expected one Python of 3.10 to 3.14"; exit 2; fi; \
	echo "== passed:$$tried"

clean: ## remove what builds, tests and linters left; the environment and your runs stay
	rm -rf build dist firmware/build docs/api install log *.egg-info .mutants .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name .venv -prune -o -name '.venv-*' -prune -o -name __pycache__ -type d -exec rm -rf {} +

distclean: clean ## also remove the environments
	rm -rf .venv .venv-*
