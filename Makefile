# Every target makes the virtual environment it needs: a clone, Python 3.11 and make are enough.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
OUT    ?= out

.PHONY: help run test check format bench growth fixtures clean

help:  ## Show the targets
	@sed -n 's/^\([a-z]*\):.*## /\1	/p' $(MAKEFILE_LIST) | expand -t 12

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

run: $(READY)  ## Extract the cages of the walking figure, and report on them
	@mkdir -p $(OUT)
	$(BIN)/cageik extract data_fixtures/walker/frames/*.obj --cage data_fixtures/walker/cage.obj \
		--output $(OUT)/walker.h5 --overwrite
	$(BIN)/cageik report $(OUT)/walker.h5 --json $(OUT)/report.json --csv $(OUT)/frames.csv --overwrite

test: $(READY)  ## Run the tests, with the coverage of the package
	$(BIN)/python -m pytest --cov --cov-report=term-missing:skip-covered --cov-fail-under=95

check: $(READY)  ## Format, lint, types, and the order of imports
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest tests/test_imports.py

format: $(READY)  ## Format the code and sort the imports
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(READY)  ## Measure speed against yardsticks, as ratios
	$(BIN)/python -m pytest tests/benchmarks -m bench -s

growth: $(READY)  ## Measure how a bind grows with cage and model (takes minutes)
	@mkdir -p $(OUT)
	$(BIN)/python -m tests.benchmarks.growth $(OUT)/growth.png

fixtures: $(READY)  ## Make data_fixtures again, byte for byte, and the pictures
	$(BIN)/python data_fixtures/make_fixtures.py
	$(BIN)/python data_fixtures/make_picture.py

clean:  ## Remove what was built and written here
	rm -rf $(VENV) $(OUT) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .coverage .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
