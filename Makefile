# make demo · make test · make lint; needs Python >= 3.11 and make, nothing else.

VENV ?= .venv
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
STAMP := $(VENV)/.installed
RUN := PATH="$(abspath $(VENV))/bin:$$PATH"

.PHONY: demo test lint setup
.DEFAULT_GOAL := demo

demo: $(STAMP)
	$(RUN) python run.py sweep=first

test: $(STAMP)
	$(RUN) python -m pytest --numprocesses=logical --maxprocesses=4

lint: $(STAMP)
	$(RUN) ruff check .
	$(RUN) ruff format --check .
	$(RUN) mypy

setup: $(STAMP)

$(STAMP): pyproject.toml
	@test -n "$(PYTHON)" || { echo "error: expected Python >= 3.11, found none; install it or set PYTHON=PATH" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(RUN) python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@
