# Two commands do everything on a fresh machine: `make study` and `make test`.
PYTHON ?= python3
VENV ?= .venv
CONFIG ?= configs/quick.yaml
RUN := $(VENV)/bin/python

.PHONY: study test quicktest lint figures pictures pages benchmarks clean

study: $(VENV)/.study
	$(RUN) -m study.run all --config $(CONFIG)

# All tests, in as many processes as there are cores but at most 4. One thread a process.
test: $(VENV)/.test
	OMP_NUM_THREADS=1 $(RUN) -m pytest -n auto --maxprocesses 4 --dist worksteal

# The tests of every package but the slow ones: under 90 seconds on two cores. One thread a process.
quicktest: $(VENV)/.test
	OMP_NUM_THREADS=1 $(RUN) -m pytest -n auto -m 'not slow and not viewer and not browser'

lint: $(VENV)/.test
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

figures: $(VENV)/.study
	$(RUN) -m study.run figures --config $(CONFIG)

# The pictures of recordings on the pages, from the committed results.
pictures: $(VENV)/.study
	$(RUN) -m study.recording.pictures --results results/paper

# The tables in the README files, from the committed numbers.
pages: $(VENV)/.study
	$(RUN) -m paper_figs.pages

# About 15 minutes on two cores with nothing else running; then the tables in their page.
benchmarks: $(VENV)/.test
	$(RUN) -m tests.benchmarks
	$(RUN) -m paper_figs.pages

# The environment is set up again when its requirements change.
$(VENV)/.study: pyproject.toml constraints.txt
	test -x $(RUN) || $(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

$(VENV)/.test: $(VENV)/.study
	$(RUN) -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	touch $@

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache
