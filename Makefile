# Every target works alone on a machine with Python 3.11 and make; `make help` prints them.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
CAPTURES ?= ../shared/captures
# `make gpu`: a Python of yours with a CUDA build of torch, into which nothing is installed; and minutes of training.
GPU_PYTHON ?=
MINUTES ?= 10

.PHONY: help demo test lint bench gpu crash fuzz extreme stability mutations clean

help: ## Print every target with what it does.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "%-20s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(STAMP) ## Film a simulated person and reconstruct that person, into demo-output/.
	$(BIN)/posegaussian demo --output demo-output

# Hundreds of processes import the package: bytecode is kept even where the environment asks for none.
test: $(STAMP) ## Run the tests, two processes at once.
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --dist worksteal

lint: $(STAMP) ## Check style and types.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -p posegaussian -p benchmarks

# A benchmark is a line below: RUNS holds its modules of benchmarks/, each in quotes with its arguments.
MEASURE = set -e; for run in $(RUNS); do $(BIN)/python -m benchmarks.$$run; done

bench: RUNS = pipeline.plan_time pipeline.plan_scale pipeline.status_time pipeline.overhead pipeline.memory quality.metrics_time renderer.cpu_speed
bench: $(STAMP) ## Measure planning, status, overhead, memory, metrics and renderer.
	$(MEASURE)

bench-%: $(STAMP)
	$(if $(RUNS),$(MEASURE),$(error No benchmark is called $@; `make help` prints them))

bench-effects: RUNS = simulator.effects_time ## What every effect of the simulator costs, and what leaving it out saves.
bench-faults: RUNS = frames.faults ## What it costs when pictures, masks or cameras are not as they should be: half an hour.
bench-first-run: RUNS = pipeline.first_run ## What two workers compile on a first run, each on its own and waiting for one another.
bench-frame: RUNS = pipeline.frame_time ## Where the seconds of a frame go, stage by stage: eight views of 512 and 1024 px, one thread.
bench-mattes: RUNS = "frames.mattes simulated" "frames.mattes balance $(CAPTURES)/balance" "frames.mattes given $(CAPTURES)/balance" "frames.mattes desk $(CAPTURES)/desk" ## Mattes without given masks, of simulated people and of two captures outlined by hand (CAPTURES=FOLDER).
bench-motorcycle: RUNS = depth.motorcycle ## The offset sweep on a measured stereo pair, beside OpenCV.
bench-network: RUNS = network.gain ## The trained network over the analytic floor, on simulated people.
bench-network-time: RUNS = network.speed ## What the network costs for two views, by module, beside plain float32.
bench-picture: RUNS = pipeline.picture_time ## What a picture takes in the rendering stage, eight views of 512 px, one thread.
bench-night: RUNS = pipeline.night ## Frames an hour over 200 frames, 8 and 16 cameras of 512 px and 1080p, one worker and two: a day on two cores.
bench-pose: RUNS = pose.simulated ## Joints in space with every kind of smoothing: ten minutes on two cores.
bench-quality: RUNS = "quality.views clean --frames 3" "quality.views spoilt" ## Simulated people, every kind of depth, the floor's gates: about an hour and a half on two cores.
bench-refinement: RUNS = refinement.gain ## Refinement beside per-scene 3D Gaussian splatting: about an hour on two cores.
bench-regret: RUNS = quality.regret ## What the decisions about effects cost, scene by scene.
bench-renderer: RUNS = renderer.cpu_speed ## The renderer beside plain torch, on one thread.
bench-sweep: RUNS = depth.sweep_time ## What the offset sweep costs, by phase, and a hypothesis beside a plain torch version.

# In .venv, as all else is, Triton is installed, so that without a GPU its interpreter runs the kernels.
gpu: $(if $(GPU_PYTHON),,$(VENV)/.triton) ## The first thing to run where a GPU is at hand (GPU_PYTHON=PATH MINUTES=10): its tests, every figure, training; one table.
	$(or $(GPU_PYTHON),$(BIN)/python) -m benchmarks.gpu.table --minutes $(MINUTES)

crash: $(STAMP) ## Kill runs at random moments and compare what they leave with an undisturbed one: some minutes.
	$(BIN)/python -m pytest -m crash -s tests/crash

fuzz: $(STAMP) ## Spoil every kind of file that is read in 300 ways; each works or is refused with a sentence: about half an hour.
	$(BIN)/python -m tests.fuzz

extreme: $(STAMP) ## Draw ten thousand random scenes of extreme scale, opacity, depth and camera: every number must be finite.
	$(BIN)/python -m tests.hard_cases.extreme

stability: $(STAMP) ## Draw every hard case in a naive version and in ours: docs/measurements/stability.md and docs/measurements/stability.png.
	$(BIN)/python -m tests.hard_cases.stability

mutations: $(STAMP) ## Break what every hard case guards, a line at a time: each case must fail.
	$(BIN)/python -m tests.mutations

# torch first and pinned: without the pin a build with several gigabytes of GPU libraries may be chosen.
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed, this is " + sys.version'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $(STAMP)

$(VENV)/.triton: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[gpu]'
	touch $(VENV)/.triton

clean: ## Remove the virtual environment, the demo's output and caches.
	rm -rf $(VENV) demo-output .pytest_cache .ruff_cache .mypy_cache .hypothesis
