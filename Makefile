# Everything runs in a virtual environment of its own, made on first use.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check

.PHONY: demo test test-all budget lint check docs gallery paper gpu dist sbom format clean

demo: $(VENV)/.installed
	$(BIN)/lumitree demo -o demo-output

# At most 5 minutes on 2 idle cores (pytest prints its time).
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 --dist worksteal

# These, and the tests marked `slow`: hours.
test-all: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m ''

# Sizes of packages, tests and pages, and the most that they may have.
budget: $(BIN)/python
	$(BIN)/python tools/budget.py

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tools/check_language.py
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

check: lint test docs

docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build

# Pages of the built-in lamps, which `make docs` then links to: 10 to 20 minutes on 2 CPU cores.
gallery: $(VENV)/.installed
	$(BIN)/python docs/make_gallery.py

# The tables of benchmarks/results/paper.md, as far as they are not measured yet: hours on 2 CPU cores.
paper: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks paper --scale cpu

# What an NVIDIA GPU does, in at most 14 minutes; again to go on (docs/how-to/gpu.md).
MINUTES ?= 14
gpu: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks gpu --minutes $(MINUTES)

# Wheel and source distribution of the last commit, built and checked. docs/releasing.md has the rest.
dist: $(VENV)/.installed-release
	rm -rf dist build/tree
	mkdir -p build/tree
	git archive HEAD | tar --extract --directory build/tree
	$(BIN)/python -m build --outdir dist build/tree
	$(BIN)/python -m twine check --strict dist/*
	LUMITREE_DISTRIBUTIONS=dist $(BIN)/python -m pytest -m '' tests/test_package.py tests/test_version.py

# Software bill of materials (CycloneDX) of an installation with the versions of constraints.txt.
sbom: $(VENV)/.installed-release
	rm -rf build/sbom
	$(BIN)/python -m venv build/sbom
	build/sbom/bin/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt .
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --mc-type library \
	  --output-reproducible --output-file sbom.cdx.json build/sbom/bin/python

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) build demo-output dist docs/_build docs/generated sbom.cdx.json

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "lumitree needs Python 3.11 or newer; found $$($(PYTHON) --version). Set PYTHON=..."; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' || { \
	  echo "Python's venv module is missing: on Debian, apt install python3-venv"; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --constraint constraints.txt --editable '.[denoise]'
	touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --constraint constraints.txt --editable '.[dev,denoise]'
	touch $@ $(VENV)/.installed

$(VENV)/.installed-release: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --constraint constraints.txt --editable '.[release,denoise]'
	touch $@ $(VENV)/.installed $(VENV)/.installed-dev

$(VENV)/.installed-docs: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --constraint constraints.txt --editable '.[docs]'
	touch $@ $(VENV)/.installed
