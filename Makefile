# All commands of developers and CI. The README gives the time of each on two cores.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := service training tests benchmarks
VERSION = $(shell sed -n 's/^__version__ = "\(.*\)"/\1/p' service/__init__.py)
lock = $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
	--custom-compile-command 'make lock' $(2) --output-file deploy/locks/$(1).txt

.PHONY: help serve data shapes train test lowest fuzz check format openapi lock image size sbom clean
.DEFAULT_GOAL := help

help: ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

# A stamp per set of dependencies: they are installed again only when pyproject.toml changes. A larger set holds the
# smaller ones and is installed in one step: each step of pip resolves all dependencies anew.
$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed: make PYTHON=python3.11 ...") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv $(VENV)

$(VENV)/serving: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/training: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[training]'
	touch $(VENV)/serving $@

$(VENV)/dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[training,dev]'
	touch $(VENV)/serving $(VENV)/training $@

serve: $(VENV)/serving ## serve models/ on 127.0.0.1:8000 (no torch needed)
	$(BIN)/cazsl serve

data: $(VENV)/training ## simulate the default datasets into data/approach
	$(BIN)/cazsl-train simulate

shapes: $(VENV)/training ## simulate pushes of drawn shapes into data/shapes: ten minutes
	$(BIN)/cazsl-train simulate shapes

MODEL := push-indicator
SHAPED := $(filter push-shape,$(MODEL))
train: $(if $(SHAPED),shapes,data) ## fit MODEL, measure it, fit it again on all objects, publish its next version
	$(if $(filter push-visual,$(MODEL)),$(BIN)/cazsl-train images --camera --views 16)
	$(BIN)/cazsl-train fit $(MODEL)
	$(BIN)/cazsl-train evaluate runs/$(MODEL)
	$(BIN)/cazsl-train fit $(MODEL) --set-up all-$(if $(SHAPED),families,objects) --run runs/$(MODEL)-all
	$(BIN)/cazsl-train publish runs/$(MODEL)-all --measured runs/$(MODEL)

# The tests of a module run in one process, for the fixtures that they share (tests/conftest.py).
test: $(VENV)/dev ## run all tests, on all cores
	$(BIN)/pytest --numprocesses auto --maxprocesses 8 --dist loadscope --no-loadscope-reorder

lowest: $(VENV)/dev ## run all tests with the lowest versions that pyproject.toml allows, in build/lowest
	$(BIN)/uv venv --quiet --clear build/lowest
	$(BIN)/uv pip install --quiet --python build/lowest/bin/python --resolution lowest-direct --editable '.[training,dev]'
	build/lowest/bin/pytest --numprocesses auto --maxprocesses 8 --dist loadscope --no-loadscope-reorder

fuzz: $(VENV)/dev ## send 100,000 generated requests and count the answers by route and status: a minute or two
	CAZSL_FUZZ_REQUESTS=100000 $(BIN)/pytest -s tests/test_fuzz.py

check: $(VENV)/dev ## check format, lint, types, docstrings, imports, OpenAPI, Dockerfile, deploy/; changes no file
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/interrogate --quiet service training tests benchmarks
	$(BIN)/pytest --quiet tests/test_layers.py tests/test_language.py tests/test_openapi.py tests/test_deploy.py
	$(BIN)/hadolint Dockerfile

format: $(VENV)/dev ## repair format and order of imports
	$(BIN)/ruff format $(SOURCES)
	$(BIN)/ruff check --fix $(SOURCES)

openapi: $(VENV)/dev ## renew openapi/openapi.json from the app
	$(BIN)/pytest --quiet tests/test_openapi.py --renew-openapi

lock: $(VENV)/dev ## renew the image's locks from pyproject.toml: versions and digests, of the build backend too
	$(call lock,serving,) pyproject.toml
	$(call lock,s3,--extra s3) pyproject.toml
	$(call lock,all,--extra s3 --extra signing --extra otel) pyproject.toml
	$(BIN)/python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['build-system']['requires'], sep='\n')" \
	| $(call lock,build,) -

image: ## build the image cazsl, with Docker
	docker build --tag cazsl --build-arg VERSION=$(VERSION) --build-arg REVISION=$$(git rev-parse HEAD) .

DU := docker run --rm --user root --entrypoint du cazsl
size: ## print the size of the image cazsl on disk in MB; fails over 350
	@$(DU) --summarize --total --one-file-system --block-size=1MB /opt/cazsl /srv/models / \
	| awk '{ print } $$2 == "total" { all = $$1 } END { exit !all || all > 350 }'

sbom: $(VENV)/dev ## write the contents of the image, as CycloneDX, to build/sbom.json
	rm -rf build/sbom
	$(PYTHON) -m venv --without-pip build/sbom
	$(BIN)/python -m pip --python build/sbom/bin/python install --quiet --require-hashes --requirement deploy/locks/serving.txt
	$(BIN)/python -m pip --python build/sbom/bin/python install --quiet --no-deps .
	$(BIN)/cyclonedx-py environment build/sbom --pyproject pyproject.toml --output-reproducible --output-file build/sbom.json

clean: ## remove the virtual environment and caches; data, runs and models stay
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .hypothesis
