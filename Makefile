# Each target alone, on a fresh machine, sets up what it needs in .venv and does its job.
PYTHON ?= python3
# A build for the CPU is enough and small; take another with `make TORCH=torch==... demo`.
TORCH ?= torch==2.13.0
BIN := .venv/bin
# One worker a processor and one more, since some tests wait for processes, each with one torch thread; a worker that has
# nothing left takes tests over from another.
# A worker's modules of tests follow one another, so that most fixtures of a module are made once.
# The tests start some hundred processes: bytecode is kept, so that not each of them compiles the package anew.
WORKERS := $(shell $(PYTHON) -c "import os; print(min(8, (os.cpu_count() or 1) + 1))")
PYTEST := env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal

.PHONY: demo test test-fast bench docs clean

demo: .venv/demo
	$(BIN)/torchmesh reproduce --out out

test: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(PYTEST)

# For daily work: without the tests marked slow (whole runs of experiments, pages in a browser, the documentation's
# code, many processes, large meshes) and without types.
test-fast: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(PYTEST) -m "not slow"

# Each run is kept as JSON, with groups, versions and commit, in .benchmarks, and compared with the last one.
bench: .venv/test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/benchmarks --benchmark-only --benchmark-autosave \
	  $(if $(wildcard .benchmarks/*/*.json),--benchmark-compare) \
	  --benchmark-columns=min,median,rounds --benchmark-group-by=group --benchmark-sort=name -o addopts=

docs: .venv/docs
	$(BIN)/python -m mkdocs build --strict

.venv/torch:
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet "$(TORCH)"
	touch $@

# The compiled loops are part of an installation: they are built again when their source changes.
BUILD := pyproject.toml setup.py $(wildcard torchmesh/kernels/source/*)

.venv/demo: .venv/torch $(BUILD)
	$(BIN)/python -m pip install --quiet -e '.[plot]'
	touch $@

.venv/docs: .venv/torch $(BUILD)
	$(BIN)/python -m pip install --quiet -e '.[docs]'
	touch $@

# mypy reads the types of torch and of the other libraries once, which takes a minute and a half.
.venv/test: .venv/torch $(BUILD)
	$(BIN)/python -m pip install --quiet -e '.[test]'
	-$(BIN)/mypy > /dev/null
	touch $@

clean:
	rm -rf .venv out site build torchmesh/kernels/_loops.* *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
