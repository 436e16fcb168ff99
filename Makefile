# gnssins: everything from here. `make help` lists the targets.
# Needs Rust (1.89 or newer, with rustfmt and clippy for `lint`), Python 3.11 or newer, a C linker.
# Every target prepares what it needs: the virtual environment in .venv, the dependencies, the compiled module.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
SHELL := bash
.SHELLFLAGS := -euo pipefail -c

VENV ?= .venv
BIN := $(VENV)/bin
CARGO ?= cargo
# Set to --locked to refuse a Cargo.lock that is out of date (as .ci/run does).
LOCKED ?=
comma := ,
# The first interpreter that is new enough and can make a virtual environment.
PYTHON ?= $(shell for p in python3.11 python3 python; do \
	command -v $$p >/dev/null 2>&1 && \
	$$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && \
	{ echo $$p; break; }; done)

RUST_SOURCES := Cargo.toml Cargo.lock rust/gnssins-py/Cargo.toml $(shell find rust -name '*.rs')
TARGET_DIR := $(or $(CARGO_TARGET_DIR),target)
NO_STD := $(TARGET_DIR)/no_std

# ---------------------------------------------------------------------------- set-up

$(VENV)/.stamp-pip:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer with the venv module was not found." \
	  "Install it, or name it: make PYTHON=/path/to/python3"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	@touch $@

$(VENV)/.stamp-dev: pyproject.toml $(VENV)/.stamp-pip
	$(BIN)/python -m pip install --quiet --group dev
	@touch $@

$(VENV)/.stamp-docs: pyproject.toml $(VENV)/.stamp-pip
	$(BIN)/python -m pip install --quiet --group docs
	@touch $@

$(VENV)/.stamp-core: $(RUST_SOURCES) pyproject.toml $(VENV)/.stamp-dev
	@command -v $(CARGO) >/dev/null || { echo "cargo was not found: install Rust from https://rustup.rs"; exit 1; }
	VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/maturin develop --release $(LOCKED)
	@touch $@

.PHONY: build
build: $(VENV)/.stamp-core  ## build the Rust module and install the package into .venv

# ---------------------------------------------------------------------------- use

.PHONY: demo
demo: build  ## fly the 3000 s demonstration; numbers here, pictures in demo-output/
	$(BIN)/gnssins demo --out demo-output

# ---------------------------------------------------------------------------- proof

.PHONY: test test-rust test-no-std test-py
test: test-rust test-no-std test-py  ## all tests: Rust, no_std link proof, Python

test-rust:  ## Rust unit, integration and documentation tests
	$(CARGO) test $(LOCKED)
	$(CARGO) test $(LOCKED) --features serde,monte-carlo --lib --tests --quiet

# What nothing calls is left out, so that the panic handler is missed by the linker only where a call leads to it.
DROP_UNUSED := $(if $(filter Darwin,$(shell uname)),-Wl$(comma)-dead_strip,-Wl$(comma)--gc-sections)

test-no-std:  ## link and run the hot path without the standard library, without a heap, without a panic
	$(CARGO) build $(LOCKED) --release --manifest-path tests/no_std/Cargo.toml --target-dir $(NO_STD)
	$(CC) -O2 tests/no_std/main.c $(NO_STD)/release/libgnssins_no_std.a $(DROP_UNUSED) -o $(NO_STD)/proof || \
	  { echo "no proof: where the linker asks for gnssins_can_panic, some call of the engine can panic"; exit 1; }
	$(NO_STD)/proof

test-py: build  ## Python tests
	$(BIN)/python -m pytest

.PHONY: lint lint-rust lint-style lint-types format
lint: lint-rust lint-style lint-types  ## formatting, clippy, ruff, mypy, stubtest: warnings are errors

lint-rust:
	@$(CARGO) fmt --version >/dev/null 2>&1 && $(CARGO) clippy --version >/dev/null 2>&1 || \
	  { echo "rustfmt or clippy is missing: rustup component add rustfmt clippy"; exit 1; }
	$(CARGO) fmt --all --check
	$(CARGO) fmt --manifest-path tests/no_std/Cargo.toml --check
	$(CARGO) clippy $(LOCKED) --workspace --all-targets --all-features -- -D warnings
	$(CARGO) clippy $(LOCKED) --manifest-path tests/no_std/Cargo.toml --target-dir $(NO_STD) -- -D warnings

lint-style: $(VENV)/.stamp-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check

lint-types: build
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest gnssins._core

format:  ## rewrite all sources in the house format
	$(CARGO) fmt --all
	$(CARGO) fmt --manifest-path tests/no_std/Cargo.toml
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

# Packages that are compared with have an environment of their own.
BENCH_VENV ?= .venv-bench
COUNTS := $(TARGET_DIR)/counts

$(BENCH_VENV)/.stamp: benches/others.txt $(VENV)/.stamp-pip
	$(BIN)/python -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/python -m pip install --quiet -r $<
	@touch $@

.PHONY: bench bench-counts counts
bench: build counts $(BENCH_VENV)/.stamp  ## speed of the engine and of whole runs, beside others: benches/RESULTS.md
	$(CARGO) bench $(LOCKED)
	$(BIN)/python benches/bench.py --criterion $(TARGET_DIR)/criterion --counts $(COUNTS) \
	  --others $(BENCH_VENV)/bin/python --out benches/RESULTS.md

bench-counts: counts $(VENV)/.stamp-pip  ## instructions of every part of the engine (valgrind)
	$(BIN)/python benches/bench.py --counts $(COUNTS)

counts:
	@$(CARGO) bench $(LOCKED) --bench counts --no-run --message-format json-render-diagnostics \
	  | sed -n 's/.*"executable":"\([^"]*counts-[^"]*\)".*/\1/p' | xargs -I{} cp {} $(COUNTS)

# ---------------------------------------------------------------------------- hand out

.PHONY: docs
docs: build $(VENV)/.stamp-docs  ## HTML documentation in docs/_build/html; warnings are errors
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs docs/_build/html
	@echo "docs/_build/html/index.html"

.PHONY: dist
dist: $(VENV)/.stamp-dev  ## wheel and sdist in dist/, crate checked by cargo package
	$(BIN)/maturin build --release --sdist --out dist $(LOCKED)
	$(CARGO) package $(LOCKED) --package gnssins

.PHONY: clean distclean
clean:  ## remove everything built, keep .venv
	rm -rf target dist demo-output docs/_build python/gnssins/_core*.so python/gnssins/_core*.pyd
	rm -rf .mypy_cache .ruff_cache .pytest_cache .hypothesis
	rm -f $(VENV)/.stamp-core

distclean: clean  ## clean, and remove .venv and .venv-bench
	rm -rf $(VENV) $(BENCH_VENV)

.PHONY: help
help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))
