# `make demo` and `make test` each set up everything they need in .venv; PYTHON=python3.13 chooses the Python of a new one.
# The other checks have environments of their own, below .venvs; docs/supply.md says what they are for.
PYTHON ?= python3
BIN := .venv/bin
BUILD := .venvs/build/bin
WHEEL := .venvs/wheel/bin
LOWEST := .venvs/lowest
AUDIT := .venvs/audit/bin

.PHONY: demo test lint types unit fuzz slow soak licences test-wheel test-lowest audit clean

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
	$(BIN)/python -m pytest --numprocesses logical --dist worksteal --max-worker-restart 0

# damaged and hostile input for every reader of files and messages, and property tests on other inputs than `make test`
# has: 280,000 inputs, some minutes
fuzz: .venv/installed
	$(BIN)/python -m pytest --hypothesis-profile search -m hypothesis
	$(BIN)/python -m tests.helpers.fuzz 2>/dev/null

# what takes a minute and rarely breaks: everything compiled anew, workers of Ray that are killed
slow: .venv/installed
	$(BIN)/python -m pytest -m slow

# 50,000 frames through the whole pipeline, half an hour and more
soak: .venv/installed
	$(BIN)/python -m tests.helpers.soak --size 320x240

# licences of all that an installation needs
licences: .venv/installed
	$(BIN)/python -m tests.helpers.licences

# what users get: the wheel, installed into an empty environment, does the main job in an empty folder
test-wheel:
	rm -rf dist
	$(PYTHON) -m venv --clear .venvs/build
	$(BUILD)/python -m pip install --quiet build
	$(BUILD)/python -m build --outdir dist .
	$(BUILD)/python tests/helpers/wheel.py dist
	$(PYTHON) -m venv --clear .venvs/wheel
	$(WHEEL)/python -m pip install --quiet --constraint constraints.txt dist/*.whl
	rm -rf .venvs/empty && mkdir .venvs/empty
	cd .venvs/empty && ../wheel/bin/airline-frontend --headless --save demo.rrd --out tracks.mcap --max-frames 20
	cd .venvs/empty && ../wheel/bin/python -m viz.snapshot demo.rrd demo.jpg --plain

# the lowest versions that pyproject.toml allows, but for torch: its older builds bring gigabytes of CUDA
test-lowest:
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet uv
	grep '^torch==' constraints.txt > $(LOWEST)/torch.txt
	$(LOWEST)/bin/uv pip compile --quiet --no-header --no-annotate --resolution lowest-direct --extra dev \
		--override $(LOWEST)/torch.txt --output-file $(LOWEST)/all.txt pyproject.toml
	grep -v -E '^(nvidia|cuda|triton|torch)' $(LOWEST)/all.txt > $(LOWEST)/requirements.txt
	$(LOWEST)/bin/python -m pip install --quiet --requirement $(LOWEST)/torch.txt
	$(LOWEST)/bin/python -m pip install --quiet --requirement $(LOWEST)/requirements.txt
	$(LOWEST)/bin/python -m pip install --quiet --no-deps --editable .
	$(LOWEST)/bin/python -m pytest --numprocesses logical --dist worksteal \
		-W ignore::DeprecationWarning $(TESTS)

# known faults of the versions in constraints.txt; fails, too, where the list of faults cannot be asked
audit:
	$(PYTHON) -m venv --clear .venvs/audit
	$(AUDIT)/python -m pip install --quiet pip-audit
	$(AUDIT)/pip-audit --strict --no-deps --disable-pip --requirement constraints.txt

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	$(BIN)/python -m frontend.warm_up >/dev/null
	touch $@

clean:
	rm -rf .venv .venvs build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
