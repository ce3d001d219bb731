# make all: everything from installation to results/report/index.html. make help lists the targets.

PYTHON ?= python3.11
CORES ?= 2
VENV := .venv
BIN := $(VENV)/bin
# pytest-xdist runs CORES processes, so that each gets one thread.
SINGLE := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: help setup setup-cluster all test lint format benchmark benchmark-criticise benchmark-departures benchmark-audit \
	benchmark-batch \
	benchmark-composition benchmark-estimate benchmark-render benchmark-kills benchmark-fuzz \
	benchmark-scale captures convergence criticise-measured shipped-instrument figures clean

help:
	@echo 'make setup      virtual environment in $(VENV), with the pinned packages'
	@echo 'make setup-cluster  Slurm for Snakemake, into $(VENV) (docs/cluster.md)'
	@echo 'make all        the whole chain at the scale of config.yaml, on CORES=$(CORES) cores'
	@echo 'make test       lint and tests (make test TESTS=tests/physics for a subset)'
	@echo 'make lint       ruff, snakefmt and mypy, check only'
	@echo 'make format     apply ruff and snakefmt; regenerate the JSON schema'
	@echo 'make benchmark  cost of simulations, compared with SolverVBD'
	@echo 'make benchmark-criticise  how many of 300 hidden effects are found, missed or misnamed'
	@echo 'make benchmark-departures  the same on a second bench, half of the cases with faulty instruments'
	@echo 'make captures   ingest videos, score them, add them to the report; surrogates by default, about 3 CPU h'
	@echo 'make convergence  repeat the study of time step and mesh (hours), publish to results/published'
	@echo 'make benchmark-audit  duration and findings of an audit of a 1 GB release'
	@echo 'make benchmark-batch  batched simulations, on the CPU and on CUDA if available'
	@echo 'make benchmark-composition  composed against direct images, every floor and viewpoint'
	@echo 'make benchmark-render  cost of images, at 112 and 224 pixels'
	@echo 'make benchmark-estimate  estimated cost of paper.yaml against a measured part of it'
	@echo 'make benchmark-kills  kill -9 at 100 random moments of the smoke chain (most of an hour)'
	@echo 'make benchmark-fuzz  10 000 invalid inputs for the readers (minutes)'
	@echo 'make benchmark-scale  job graphs of 10^3 and 10^4 jobs; model of 10^4 and 10^6 simulations'
	@echo 'make criticise-measured  regenerate the pages of the measured cases in docs/measured'
	@echo 'make shipped-instrument  copy the published instrument into the package, write its card'
	@echo 'make figures    write the figures of README and docs that come from published files again'
	@echo 'make clean      remove caches and results, keep results/published and $(VENV)'

setup:
	@envs/setup.sh $(PYTHON) $(VENV)

setup-cluster: setup
	$(BIN)/pip install --quiet --no-deps -r envs/cluster.txt

all: setup
	$(BIN)/snakemake --cores $(CORES) all

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
	$(SINGLE) $(BIN)/python -m pytest -n $(CORES) --dist loadgroup $(TESTS)

benchmark: setup
	$(BIN)/pip install --quiet --no-deps newton==1.8.0
	$(SINGLE) $(BIN)/python benchmarks/solver_cost.py

benchmark-criticise: setup
	$(SINGLE) $(BIN)/python benchmarks/criticise.py --cases 300

benchmark-departures: setup
	$(SINGLE) $(BIN)/python benchmarks/criticise_departures.py --cases 300 --processes $(CORES)

captures: setup
	$(BIN)/snakemake --cores $(CORES) captures
	$(BIN)/snakemake --cores $(CORES) report

convergence: setup
	$(BIN)/snakemake --cores $(CORES) convergence
	$(BIN)/slipstitch convergence publish

benchmark-audit: setup
	$(SINGLE) $(BIN)/python benchmarks/audit.py --size-gb 1 --jobs $(CORES)

benchmark-batch: setup
	$(SINGLE) $(BIN)/python benchmarks/batch.py

benchmark-composition: setup
	mkdir -p results/benchmarks
	$(SINGLE) $(BIN)/python benchmarks/composition.py --results results/benchmarks/composition.jsonl

benchmark-render: setup
	$(SINGLE) $(BIN)/python benchmarks/render.py
	$(SINGLE) $(BIN)/python benchmarks/render.py --pixels 224 --images 480

benchmark-estimate: setup
	$(SINGLE) $(BIN)/python benchmarks/estimate.py

benchmark-kills: setup
	$(SINGLE) $(BIN)/python benchmarks/kills.py --kills 100

benchmark-fuzz: setup
	$(SINGLE) $(BIN)/python benchmarks/fuzz.py --inputs 10000

benchmark-scale: setup
	$(BIN)/python benchmarks/dag.py --out results/published/scale/dag.json
	$(BIN)/python benchmarks/scale.py

shipped-instrument: setup
	cp results/published/instrument/models/by_simulation/instrument/ensemble/instrument.safetensors \
	   results/published/instrument/models/by_simulation/instrument/ensemble/instrument.json \
	   results/published/instrument/config.json src/slipstitch/film/measure/shipped/
	cd src/slipstitch/film/measure/shipped && \
		sha256sum config.json instrument.json instrument.safetensors > SHA256SUMS
	$(BIN)/python benchmarks/figures.py

criticise-measured: setup
	for case in paper_on_paper block_on_wood_board block_on_other_board; do \
		$(SINGLE) $(BIN)/slipstitch criticise data/cases/$$case \
			--out results/criticise/$$case/verdict.json --report docs/measured/$$case.md || exit; \
	done

figures: setup
	$(BIN)/python benchmarks/figures.py

clean:
	find results -mindepth 1 -maxdepth 1 ! -name published -exec rm -rf {} + 2>/dev/null || true
	rm -rf .snakemake .pytest_cache .ruff_cache .mypy_cache .hypothesis build dist
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
