# Everything here works in an environment of its own, made on first use in .venv.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Two workers finish the tests sooner than one even on two cores; more than eight only wait for each other.
WORKERS ?= auto
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --maxprocesses 8

.PHONY: help install demo test slow bench bench-docs lint format clean

help:
	@echo "make demo     a bunny of tetrahedra falls, bounces and settles; leaves a picture in out/"
	@echo "make test     the tests, some minutes"
	@echo "make slow     the long tests, which CI runs once"
	@echo "make bench    Ebb against C++, Numba, Taichi, Quadrants and Warp, some minutes; BENCH=--help lists options"
	@echo "make lint     ruff and pyright"
	@echo "make format   formats the code"
	@echo "make clean    removes the environment and what was made"

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	@$(PYTHON) -c 'import ensurepip, sys; assert sys.version_info >= (3, 11)' 2>/dev/null || \
	  { echo "This needs Python 3.11 or newer with venv: apt-get install python3-venv, or make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[dev]"
	@touch $@

demo: install
	@mkdir -p out
	$(BIN)/python examples/spring_mass.py --mesh bunny --save out/bunny.png
	@echo "The picture: $(CURDIR)/out/bunny.png"

test: install
	$(PYTEST) -m "not slow"

slow: install
	$(PYTEST) -m slow

# The peers have an environment of their own: they may want other versions of what Ebb needs.
PEERS := $(VENV)-bench

bench: install $(PEERS)/.installed
	$(BIN)/python -m benchmarks.run --python $(PEERS)/bin/python $(BENCH)

# Keeps the results in benchmarks/results and writes docs/benchmarks.md.
bench-docs: override BENCH += --write-docs
bench-docs: bench

$(PEERS)/.installed: pyproject.toml
	$(BIN)/python -m benchmarks.install $(PEERS)
	@touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) $(PEERS) build dist out .pytest_cache .ruff_cache .hypothesis
