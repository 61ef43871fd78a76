# The two commands of the README: make demo, make test.
PYTHON ?= python3
VENV ?= .venv
MINUTES ?= 1
BIN := $(VENV)/bin
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check
BYTECODE = $(BIN)/python -W ignore -m compileall -qq -j 0 -x 'site-packages/.*/tests?/'
NATIVE := $(shell find c src/bindings -name '*.c' -o -name '*.h' -o -name '*.cpp')
BUILT_WITH := import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"])
OLD_PYTHON := truestroke needs Python 3.11 or newer; this is %s. Try: make PYTHON=python3.12

.PHONY: help demo test setup bench images web c-test zig fuzz fuzz-again fuzz-kernel fuzz-readers lint types imports analyse docs docs-look reports-look docs-pdf pytest coverage wheel clean
.DEFAULT_GOAL := help

help:  ## this list
	@echo 'truestroke: make a piezo actuator follow a desired motion exactly'
	@echo
	@sed -n 's/^\([a-z-]*\):.*  ## \(.*\)/  make \1 \2/p' Makefile | awk '{ $$2 = sprintf("%-12s", $$2); print "  " $$0 }'

demo: $(VENV)/.package  ## follow the paper's random wave with a simulated stack; writes a page of pictures
	@$(BIN)/truestroke track

# What waits for the disk or the network beside what computes, on two cores; the tests in Python have them for themselves.
test:  ## everything that CI runs
	@$(MAKE) --no-print-directory -j 2 setup analyse
	@$(MAKE) --no-print-directory -j 2 --output-sync=target c-test docs lint types imports fuzz-again wheel zig
	@$(MAKE) --no-print-directory pytest

setup: $(VENV)/.ready  ## the environment that all but the demo use: the demo's, and the tools of developers

# The package, editable, and what it needs. What builds it stays in the environment: in one of pip's own, which is another
# one each time, all would be compiled anew, and not what has changed. Bytecode is made on all cores: where Python writes
# none by itself, every command would begin a second later. A file that does not compile is the business of its package,
# and hardly anything imports the tests of packages, which are a quarter of all. With the pip that Python 3.11 has, 23.2,
# the tools of developers take half as long again.
$(VENV)/.package: pyproject.toml CMakeLists.txt Makefile $(NATIVE)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "$(OLD_PYTHON)" % sys.version.split()[0])'
	@echo 'Setting up $(VENV), once: half a minute where nothing else runs; pip compiles the kernel and fetches what it lacks.'
	@begin=$$(date +%s); $(PYTHON) -m venv $(VENV) && $(PIP) 'pip>=26' && \
	  $(PIP) --no-compile cmake ninja $$($(BIN)/python -c '$(BUILT_WITH)') && \
	  $(PIP) --no-compile --no-deps --no-build-isolation --editable . && \
	  $(PIP) --no-compile truestroke && \
	  { $(BYTECODE) $(VENV)/lib src || true; } && \
	  echo "That took $$(($$(date +%s) - begin)) s."
	@touch $@

# What tests and tools need beside it; the package itself is there already. Bytecode is made here, on all cores: some of
# these packages have warnings for the compiler, which a test would take for errors. qudi comes without the packages that
# it asks for: notebooks, a browser, and an older nidaqmx, 1 GB that no test uses.
$(VENV)/.ready: $(VENV)/.package
	@echo 'Adding the tools of tests and developers to $(VENV), once: a minute where nothing else runs. One of them is not open:'
	@echo "PIPython, the client of Physik Instrumente, under PI's licence; the tests of its driver use it."
	@begin=$$(date +%s); $(PIP) --no-compile 'truestroke[dev]' && \
	  $(PIP) --no-compile --no-deps qudi-core==1.7.0 qudi-iqo-modules==1.0.0 && \
	  { $(BYTECODE) $(VENV)/lib || true; } && \
	  echo "That took $$(($$(date +%s) - begin)) s."
	@touch $@

bench: setup  ## what a step costs here, beside what others offer
	@$(BIN)/python -m benchmarks.bench

images: setup  ## make the pictures of the README again, into docs/images
	@mkdir -p build/images
	@$(BIN)/truestroke track --output build/images/track --plots build/images
	@$(BIN)/truestroke compare --output build/images/compare --plots build/images
	@cp build/images/loop-*.png build/images/errors-*.png docs/images/

web: setup  ## the module of the browser and the playground, into build/web
	@$(BIN)/python web/build.py build/web
	@echo 'build/web/playground.html'

lint: setup  ## ruff, and the workflows of GitHub
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/zizmor --quiet --offline --config .github/zizmor.yml .github/workflows

types: setup  ## mypy
	$(BIN)/mypy

imports: setup  ## packages import one way only
	$(BIN)/lint-imports

# Pages that have not changed are not read again; `make clean` removes all of them.
docs: setup  ## the site of the documentation: build/site/html/index.html
	@$(BIN)/python -m docs.site.stage build/site/source
	@$(BIN)/python -m sphinx -q -W --keep-going -a -j 2 -c docs/site -d build/site/doctrees build/site/source build/site/html
	@$(BIN)/python web/build.py build/site/web && cp build/site/web/playground.html build/site/html/
	@$(BIN)/python -m docs.site.check build/site/html

docs-look: docs  ## open every page of the site in Chromium: three widths, light, dark, printed; minutes
	@$(BIN)/python -m docs.site.look build/site/html

reports-look:  ## the same for a page of each kind that the commands write; minutes
	@$(BIN)/python -m docs.site.reports build/reports
	@$(BIN)/python -m docs.site.look build/reports

docs-pdf: docs  ## the site as one document: build/site/truestroke.pdf
	@$(BIN)/python -m sphinx -q -b singlehtml -c docs/site -d build/site/doctrees build/site/source build/site/single
	@$(BIN)/python -m docs.site.look --pdf build/site/truestroke.pdf build/site/single/index.html

# Its variants are those of the package, which `setup` has compiled, where CMake has left them.
c-test: setup  ## the kernel by itself, with sanitisers
	$(MAKE) -C c test BUILT="$$(ls -t $(CURDIR)/build/*/lib_kernel_c.a 2>/dev/null | head -1 | xargs -r dirname)"

# Where there is nothing to read it with, or another version of cppcheck, a test in Python says so.
analyse:  ## the kernel as cppcheck with its MISRA addon and clang's analyser read it
	@! { command -v clang && command -v cppcheck && grep -qi "$$(cppcheck --version) " docs/misra.md; } >/dev/null || \
	  $(MAKE) -C c analyse REALS=double

zig: setup  ## the kernel's tests built for Windows, macOS and aarch64, run under wine and qemu
	$(MAKE) -C c zig ZIG='$(abspath $(BIN))/python -m ziglang'

fuzz: fuzz-kernel fuzz-readers  ## any input for a minute; for hours: make fuzz SECONDS=36000

fuzz-again: setup c-test  ## the same input each time, as CI runs it
	$(MAKE) -C c fuzz SEED=1 SECONDS=20
	$(BIN)/python benchmarks/fuzz_readers.py --cases 4000

fuzz-kernel:
	$(MAKE) -C c fuzz

fuzz-readers: setup
	$(BIN)/python benchmarks/fuzz_readers.py --minutes $(MINUTES)

# Four processes on two cores, for many tests wait for a clock; each with one thread of linear algebra.
pytest: setup  ## tests in Python
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 4 --no-loadscope-reorder --durations=10

coverage: setup  ## the same, with the lines that none of them runs; takes longer
	$(BIN)/python -m pytest -n 2 --no-loadscope-reorder --cov --cov-report=term

wheel: setup  ## a wheel, installed by itself
	$(BIN)/python tests/wheel.py

clean:  ## remove all that these made
	rm -rf $(VENV) build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .coverage
	$(MAKE) -C c clean
