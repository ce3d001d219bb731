# make all: everything from installation to results/report/index.html. make help lists the targets.

PYTHON ?= python3.11
CORES ?= $(shell [ "$$(env -u OMP_NUM_THREADS nproc 2>/dev/null)" = 1 ] && echo 1 || echo 2)
VENV := .venv
BIN := $(VENV)/bin
# pytest-xdist runs CORES processes, so that each gets one thread.
SINGLE := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
PYTEST := $(SINGLE) $(BIN)/python -m pytest -n $(CORES)

.PHONY: help setup setup-cluster all taste test test-all lint format results benchmark captures \
	convergence shipped-instrument clean

help:
	@echo 'make setup      virtual environment in $(VENV), with the pinned packages'
	@echo 'make taste      measure a film of dragged cloth that comes with the project; open taste.html'
	@echo 'make all        the whole chain at the scale of config.yaml, on CORES=$(CORES) cores'
	@echo 'make test       lint and the quick tests (make test TESTS=tests/physics for a subset)'
	@echo 'make test-all   lint and all tests'
	@echo 'make lint       ruff, snakefmt and mypy, check only'
	@echo 'make format     apply ruff and snakefmt; regenerate the JSON schema'
	@echo 'make results    write docs/results.md and the card of the instrument from published files'
	@echo 'make benchmark-NAME  run benchmarks/NAME.py (make benchmark: the cost of simulations)'
	@echo 'make captures   ingest films, score them, add them to the report; surrogates by default'
	@echo 'make convergence  repeat the study of time step and mesh (hours), publish the result'
	@echo 'make shipped-instrument  copy the published instrument into the package'
	@echo 'make setup-cluster  Slurm for Snakemake, into $(VENV)'
	@echo 'make clean      remove caches and results, keep results/published and $(VENV)'

setup:
	@envs/setup.sh $(PYTHON) $(VENV)

setup-cluster: setup
	$(BIN)/pip install --quiet --no-deps -r envs/cluster.txt

all: setup
	$(BIN)/snakemake --cores $(CORES) all

taste: setup
	$(BIN)/slipstitch measure --example --out taste.html

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile rules
	$(BIN)/mypy

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/snakefmt Snakefile rules
	$(BIN)/slipstitch schema > workflow/schemas/config.schema.json

test: lint
	$(PYTEST) $(TESTS)

test-all: lint
	$(PYTEST) -m 'slow or not slow' --durations 20 $(TESTS)

results: setup
	$(BIN)/python benchmarks/results_page.py

# SolverVBD, to compare with, needs nothing that is not pinned already.
benchmark: setup
	$(BIN)/pip install --quiet --no-deps newton==1.8.0
	$(SINGLE) $(BIN)/python benchmarks/solver_cost.py

benchmark-%: setup
	$(SINGLE) $(BIN)/python benchmarks/$*.py $(OPTIONS)

captures: setup
	$(BIN)/snakemake --cores $(CORES) captures
	$(BIN)/snakemake --cores $(CORES) report

convergence: setup
	$(BIN)/snakemake --cores $(CORES) convergence
	$(BIN)/slipstitch convergence publish

shipped-instrument: setup
	cp results/published/instrument/models/by_simulation/instrument/ensemble/instrument.safetensors \
	   results/published/instrument/models/by_simulation/instrument/ensemble/instrument.json \
	   results/published/instrument/config.json src/slipstitch/film/measure/shipped/
	cd src/slipstitch/film/measure/shipped && \
		sha256sum config.json instrument.json instrument.safetensors > SHA256SUMS
	$(BIN)/python benchmarks/results_page.py

clean:
	find results -mindepth 1 -maxdepth 1 ! -name published -exec rm -rf {} + 2>/dev/null || true
	rm -rf .snakemake .pytest_cache .ruff_cache .mypy_cache .hypothesis build dist
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
