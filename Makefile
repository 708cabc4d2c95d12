# make demo · make test · make system · make versions · make lint · make docs · make results; needs Python >= 3.11 and make, nothing else.

VENV ?= .venv
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
STAMP := $(VENV)/.installed
RUN := PATH="$(abspath $(VENV))/bin:$$PATH"

.PHONY: demo test system versions lint docs results setup lock audit
.DEFAULT_GOAL := demo

demo: $(STAMP)
	$(RUN) python run.py sweep=first

SUITE := python -m pytest --numprocesses=logical --maxprocesses=4 --dist=worksteal

test: $(STAMP)
	$(RUN) $(SUITE)

# the suite with the oldest and the newest supported versions of all dependencies
versions:
	for versions in lowest-direct highest; do \
		$(PYTHON) -m venv .venv-$$versions && . .venv-$$versions/bin/activate && pip install --quiet uv && \
		uv pip install --quiet --resolution $$versions -e '.[dev]' && $(SUITE) || exit 1; done

# half an hour or more on two cores; kills processes, so nothing runs beside it
system: $(STAMP)
	$(RUN) python -m pytest -m slow

# all studies behind the documentation: days; DATA is the folder of the scenes
results: $(STAMP)
	@test -n "$(DATA)" || { echo "error: expected the folder of the scenes; make results DATA=DIR" >&2; exit 2; }
	$(RUN) python benchmarks/results.py run "$(DATA)"
	$(RUN) python benchmarks/results.py keep
	$(RUN) python benchmarks/results.py pages

lint: $(STAMP)
	$(RUN) ruff check .
	$(RUN) ruff format --check .
	$(RUN) mypy

docs: $(STAMP)
	$(RUN) python -c 'import mkdocs, material, mkdocstrings, latex2mathml' 2>/dev/null || \
		$(RUN) python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	$(RUN) python -m mkdocs build --strict
	@echo "documentation: site/index.html"

setup: $(STAMP)

# what comes with torch's build on the index; a machine has its own
OWN := torch triton cuda-bindings cuda-pathfinder cuda-toolkit $(addprefix nvidia-,cublas cuda-cupti cuda-nvrtc \
	cuda-runtime cudnn-cu13 cufft cufile curand cusolver cusparse cusparselt-cu13 nccl-cu13 nvjitlink nvshmem-cu13 nvtx)

lock:
	head -3 requirements-ci.txt > requirements-ci.new
	uv pip compile pyproject.toml --extra dev --generate-hashes --python-version 3.11 --no-annotate --no-header \
		$(addprefix --no-emit-package ,$(OWN)) >> requirements-ci.new
	mv requirements-ci.new requirements-ci.txt

audit:
	pip-audit --disable-pip --require-hashes -r requirements-ci.txt

$(STAMP): pyproject.toml
	@test -n "$(PYTHON)" || { echo "error: expected Python >= 3.11, found none; install it or set PYTHON=PATH" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(RUN) python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@
