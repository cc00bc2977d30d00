# make demo | test | lint | bench | crash: each works alone on a machine with Python 3.11 and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint bench crash clean

demo: $(STAMP)
	$(BIN)/posegaussian demo --output demo-output

test: $(STAMP)
	$(BIN)/python -m pytest

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy storage dags stages/contract.py stages/io.py stages/registry.py

bench: $(STAMP)
	$(BIN)/python -m benchmarks.quality
	$(BIN)/python -m benchmarks.plan_time
	$(BIN)/python -m benchmarks.plan_scale
	$(BIN)/python -m benchmarks.status_time
	$(BIN)/python -m benchmarks.overhead
	$(BIN)/python -m benchmarks.memory
	$(BIN)/python -m benchmarks.metrics_time

# Kills runs at random moments and compares what they leave with an undisturbed one: some minutes, so not part of `test`.
crash: $(STAMP)
	$(BIN)/python -m pytest -m crash -s tests/crash

# torch first and pinned: without the pin a build with several gigabytes of GPU libraries may be chosen.
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed, this is " + sys.version'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $(STAMP)

clean:
	rm -rf $(VENV) demo-output .pytest_cache .ruff_cache .mypy_cache .hypothesis
