# make demo   follow the paper's random wave with a simulated stack, write the page
# make test   everything that CI runs
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
NATIVE := $(shell find c src/bindings -name '*.c' -o -name '*.h' -o -name '*.cpp')

.PHONY: demo test setup c-test lint types imports pytest wheel clean

demo: setup
	$(BIN)/truestroke track

test: setup lint types imports c-test pytest wheel

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml CMakeLists.txt $(NATIVE)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "truestroke needs Python 3.11 or newer; this is %s. Try: make PYTHON=python3.12" % sys.version.split()[0])'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

imports: setup
	$(BIN)/lint-imports

c-test:
	$(MAKE) -C c test

pytest: setup
	$(BIN)/python -m pytest -n 2 --cov --cov-report=term

wheel: setup
	$(BIN)/python tests/wheel.py

clean:
	rm -rf $(VENV) build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .coverage
	$(MAKE) -C c clean
