# Each target alone, on a fresh machine, sets up what it needs in .venv and does its job.
PYTHON ?= python3
# A build for the CPU is enough and small; take another with `make TORCH=torch==... demo`.
TORCH ?= torch==2.13.0
BIN := .venv/bin

.PHONY: demo test bench docs clean

demo: .venv/demo
	$(BIN)/torchmesh reproduce --out out

test: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest

bench: .venv/test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/benchmarks --benchmark-only --benchmark-columns=min,median,rounds --benchmark-sort=name -o addopts=

docs: .venv/docs
	$(BIN)/python -m mkdocs build --strict

.venv/torch:
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet "$(TORCH)"
	touch $@

.venv/demo: .venv/torch pyproject.toml
	$(BIN)/python -m pip install --quiet -e '.[plot]'
	touch $@

.venv/docs: .venv/torch pyproject.toml
	$(BIN)/python -m pip install --quiet -e '.[docs]'
	touch $@

.venv/test: .venv/torch pyproject.toml
	$(BIN)/python -m pip install --quiet -e '.[test]'
	touch $@

clean:
	rm -rf .venv out site build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
