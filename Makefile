# make demo | test | lint | bench | bench-quality | bench-sweep | bench-motorcycle | bench-mattes | bench-effects | bench-renderer | bench-refinement | bench-pose | bench-network | bench-network-time | bench-gpu | crash | fuzz | extreme | stability: each works alone on a machine with Python 3.11 and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint bench bench-quality bench-sweep bench-motorcycle bench-mattes bench-effects bench-renderer bench-refinement bench-pose bench-network bench-network-time bench-gpu crash fuzz extreme stability clean

demo: $(STAMP)
	$(BIN)/posegaussian demo --output demo-output

test: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy -p posegaussian.storage -p posegaussian.dags -p posegaussian.stages.contract -m posegaussian.stages.registry

# Simulated people, every kind of depth, the floor's gates: about three quarters of an hour on two cores.
bench-quality: $(STAMP)
	$(BIN)/python -m benchmarks.quality clean
	$(BIN)/python -m benchmarks.quality spoilt

bench: $(STAMP)
	$(BIN)/python -m benchmarks.plan_time
	$(BIN)/python -m benchmarks.plan_scale
	$(BIN)/python -m benchmarks.status_time
	$(BIN)/python -m benchmarks.overhead
	$(BIN)/python -m benchmarks.memory
	$(BIN)/python -m benchmarks.metrics_time
	$(BIN)/python -m benchmarks.renderer

bench-renderer: $(STAMP)
	$(BIN)/python -m benchmarks.renderer

# Needs a CUDA device; any Python with a CUDA build of torch will do as well: python -m benchmarks.gpu_renderer
bench-gpu: $(STAMP)
	$(BIN)/python -m benchmarks.gpu_renderer

# Refinement beside per-scene optimisation from a plain start, on simulated people: about an hour on two cores.
bench-refinement: $(STAMP)
	$(BIN)/python -m benchmarks.refinement

# Joints in space, with every kind of smoothing: ten minutes on two cores; BlazePose's where its models are here.
bench-pose: $(STAMP)
	$(BIN)/python -m benchmarks.pose

# The trained network over the analytic floor, on simulated people.
bench-network: $(STAMP)
	$(BIN)/python -m benchmarks.network

# What the network costs for two views, by module, and plain float32 beside it.
bench-network-time: $(STAMP)
	$(BIN)/python -m benchmarks.network_time

# Ten thousand random scenes of extreme scale, opacity, depth and camera: no number that is drawn of them is other than finite.
extreme: $(STAMP)
	$(BIN)/python -m tests.hard_cases.extreme

# Every hard case in a naive version and in ours: docs/stability.md and docs/stability.png.
stability: $(STAMP)
	$(BIN)/python -m tests.hard_cases.stability

# What the offset sweep costs, by phase, and a hypothesis beside a plain torch version.
bench-sweep: $(STAMP)
	$(BIN)/python -m benchmarks.sweep_time

bench-motorcycle: $(STAMP)
	$(BIN)/python -m benchmarks.motorcycle

# Mattes without given masks: a capture outlined by hand (CAPTURES, default ../shared/captures) and simulated people.
bench-mattes: $(STAMP)
	$(BIN)/python -m benchmarks.mattes simulated
	$(BIN)/python -m benchmarks.mattes balance $(or $(CAPTURES),../shared/captures)/balance
	$(BIN)/python -m benchmarks.mattes given $(or $(CAPTURES),../shared/captures)/balance

# What every effect of the simulator costs, and what leaving it out saves.
bench-effects: $(STAMP)
	$(BIN)/python -m benchmarks.effects_time

# Kills runs at random moments and compares what they leave with an undisturbed one: some minutes, so not part of `test`.
crash: $(STAMP)
	$(BIN)/python -m pytest -m crash -s tests/crash

# 300 spoilt variants of every kind of file that is read: each works or is refused with a sentence. Some minutes on two cores.
fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz

# torch first and pinned: without the pin a build with several gigabytes of GPU libraries may be chosen.
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed, this is " + sys.version'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $(STAMP)

clean:
	rm -rf $(VENV) demo-output .pytest_cache .ruff_cache .mypy_cache .hypothesis
