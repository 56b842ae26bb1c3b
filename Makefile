# `make demo` and `make test` each set up everything they need in .venv.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test lint types unit fuzz soak clean

# the built-in clip through the whole pipeline into a recording
demo: .venv/installed
	$(BIN)/python -m frontend.run --headless --save demo.rrd
	@echo "open it with: $(BIN)/rerun demo.rrd"

# all checks
test: lint types unit

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/installed
	$(BIN)/mypy

unit: .venv/installed
	$(BIN)/python -m pytest

# damaged and hostile input for every reader of files and messages: 280,000 inputs, some minutes
fuzz: .venv/installed
	$(BIN)/python -m tests.fuzz 2>/dev/null

# 50,000 frames through the whole pipeline, half an hour and more
soak: .venv/installed
	$(BIN)/python -m frontend.soak --size 320x240

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

clean:
	rm -rf .venv build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
