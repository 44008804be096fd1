# Everything runs in .venv, made from requirements.lock. Another interpreter: make PYTHON=python3.12 ...
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
LOCKER := $(VENV)/.locker
# Test files that run side by side.
JOBS ?= 2

.DEFAULT_GOAL := help
.PHONY: help demo docs gallery notebooks pictures tutorial test test-all test-variations lint format lock clean

help:
	@echo "make demo      record presses in which something is concealed, find out what, and write a report"
	@echo "make test      all tests but those marked slow (13 to 30 minutes on 2 cores, as busy as they are)"
	@echo "make test-all  those too"
	@echo "make test-variations  tests of the physics as other processors compute: other vector widths, round-off, factorisation"
	@echo "make docs      documentation as a site in out/site, links checked; needs no network"
	@echo "make gallery   what each effect does to readings, as pictures for the documentation"
	@echo "make tutorial  follow the tutorial of the nodes, and draw its pictures"
	@echo "make notebooks  run the notebooks of examples/ and store what they put out"
	@echo "make pictures  pictures of the documentation, from what make demo has written; needs Chromium and chromedriver"
	@echo "make lint      style and types"
	@echo "make format    put the code into the style that lint asks for"
	@echo "make lock      resolve requirements.lock again from pyproject.toml"
	@echo "make clean     remove what was made, .venv included"

demo: $(READY)
	$(BIN)/python -m sysid.demo

test: $(READY)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder -m "not slow"

test-all: $(READY)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

test-variations: $(READY)
	$(BIN)/python tests/support/variations.py

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "Open out/site/index.html"

gallery: $(READY)
	$(BIN)/python docs/site/gallery.py

tutorial: $(READY)
	$(BIN)/python docs/site/from_nodes.py

notebooks: $(READY)
	$(BIN)/python docs/site/notebooks.py

pictures: $(READY)
	$(BIN)/python docs/site/pictures.py

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(READY): requirements.lock pyproject.toml setup.py
	@$(PYTHON) -c "import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))" 2>/dev/null || { \
		echo "Python 3.10 to 3.13 is needed, and '$(PYTHON)' is not that:" \
			"name one with 'make PYTHON=python3.12 ...'." >&2; exit 1; }
	@$(PYTHON) -c "import venv, ensurepip" 2>/dev/null || { \
		echo "$(PYTHON) has no venv module: install it (Debian, Ubuntu: apt-get install python3-venv)." >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

lock: $(LOCKER)
	$(LOCKER)/bin/uv pip compile pyproject.toml --extra ros --extra dev --extra docs --universal --python-version 3.10 \
		--no-annotate --no-header --quiet --upgrade --generate-hashes --no-strip-extras --output-file .requirements.new
	{ echo "# Exact versions and hashes for Python 3.10 to 3.13, resolved from pyproject.toml with: make lock"; \
		cat .requirements.new; } > requirements.lock
	@rm .requirements.new

$(LOCKER): | $(READY)
	$(PYTHON) -m venv $@
	$@/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.5"

clean:
	rm -rf $(VENV) build install log out *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
