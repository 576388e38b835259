# Everything lives in .venv: the packages of constraints.txt and the project itself.
# Another Python: make PYTHON=python3.12 install
PYTHON ?= python3
PIP_FLAGS ?=
PYTEST_FLAGS ?=
BIN := .venv/bin
INSTALLED := .venv/.installed
RUN := runs/paper-0

# Python keeps what it has compiled, also where the environment (a container's, often) says otherwise: without this,
# every process compiles a thousand modules anew, 3 s of CPU.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install paper test fuzz long storm lives browser check golden docs notebooks

install: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed, this is " + sys.version.split()[0] + ": make PYTHON=python3.12 install")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --no-compile $(PIP_FLAGS) -c constraints.txt -e '.[dev]'
	@touch $@

# run once; a run that was stopped goes on where it stopped
paper: install
	@if [ ! -e $(RUN)/config.toml ]; then $(BIN)/ecology run paper --out $(RUN); \
	elif [ ! -e $(RUN)/summary.json ] || grep -q '"stopped_at"' $(RUN)/summary.json; then \
	$(BIN)/ecology run --resume $(RUN); fi
	@[ -e $(RUN)/evaluation.json ] || $(BIN)/ecology evaluate $(RUN)
	@echo "The results lie in $(RUN): summary.json, evaluation.json and figures/."
	@echo "Watch the life with: $(BIN)/ecology view $(RUN)"

test: install
	$(BIN)/pytest -n auto --dist loadfile $(PYTEST_FLAGS)

# bad input, 6,000 cases of it; some ten minutes
fuzz: install
	ECOLOGY_FUZZ=1000 $(BIN)/pytest $(PYTEST_FLAGS) tests/test_fuzz.py

# a recorded life of a million ticks: memory, names, accounts; half an hour to an hour
long: install
	ECOLOGY_LONG=1000000 $(BIN)/pytest $(PYTEST_FLAGS) -s tests/test_long_life.py

# runs killed 200 times at random moments over four scenarios, all of which must end as if nothing had happened
storm: install
	cd tests && ../$(BIN)/python crash_storm.py 200 ../runs/storm

# long lives, lived as other processors would, against the digests in the repository; about half an hour
lives: install
	$(BIN)/python tests/same_life.py --long

# what every world does, written anew where it has changed: look at the difference before it is kept
golden: install
	$(BIN)/pytest tests/test_golden.py --golden

check: install
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	rm -rf build/typed && mkdir -p build/typed/ecology
	ln -s $(CURDIR)/ecology/* $(CURDIR)/agents $(CURDIR)/scenarios build/typed/ecology/
	$(BIN)/mypy
	$(BIN)/python docs/generate.py --check
	$(SPHINX) --fresh-env --fail-on-warning

# the site, in build/docs; generated tables are written first
SPHINX := $(BIN)/sphinx-build --quiet docs build/docs
docs: install
	$(BIN)/python docs/generate.py
	$(SPHINX)
	@echo "The site is in build/docs: open build/docs/index.html."

# executes the notebooks and keeps their output
notebooks: install
	$(BIN)/python -m pip install --quiet $(PIP_FLAGS) -c constraints.txt -e '.[notebooks]'
	$(BIN)/python docs/execute.py

# the page of a served run, touched by a real browser; needs a Chromium; some minutes
browser: install
	$(BIN)/python -m pip install --quiet $(PIP_FLAGS) playwright
	ECOLOGY_BROWSER=$(or $(PICTURES),1) $(BIN)/pytest -n 0 $(PYTEST_FLAGS) tests/test_browser.py
