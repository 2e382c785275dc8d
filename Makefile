# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later

VENV := .venv
BIN := $(CURDIR)/$(VENV)/bin
COMPLEX := .venv-complex
COMPLEX_BIN := $(CURDIR)/$(COMPLEX)/bin
MPIRUN ?= $(BIN)/mpirun
PYTEST_ARGS ?=
DEMO_ARGS ?=

# Demos and tests that start a process of their own find the environment's programs
export PATH := $(BIN):$(PATH)

# MPICH polls for messages and gives its core to nobody. With more ranks than cores every message
# then waits for the scheduler: 3 ranks on 2 cores took 75 s for what 2 ranks do in 4.5 s. With
# this it sleeps for a moment after 8 polls in vain: 11 s, and still 4.6 s for 2 ranks. (Neither
# MPIR_CVAR_POLLS_BEFORE_YIELD nor MPIR_CVAR_ENABLE_HEAVY_YIELD helps: they yield, they don't sleep.)
export MPIR_CVAR_CH4_PROGRESS_THROTTLE := 1
export MPIR_CVAR_CH4_PROGRESS_THROTTLE_NO_PROGRESS_COUNT := 8

# Open MPI counts cores and refuses root; MPICH knows neither option
mpi_options = $(shell $(MPIRUN) --version 2>/dev/null | grep -q 'Open MPI' && \
	echo --oversubscribe $$([ "$$(id -u)" != 0 ] || echo --allow-run-as-root))

.NOTPARALLEL:
.DELETE_ON_ERROR:
.PHONY: help env demo test test-all forget lint types test-serial test-mpi-2 test-mpi-3 \
	test-mpi-4 test-blas env-complex test-complex test-container sanitize docs package clean

help:
	@echo "make demo      set up and run demos/pressurised_cylinder.py (DEMO_ARGS=...)"
	@echo "make test      set up, check style and types, run all tests but the slow ones on"
	@echo "               1, 2 and 3 ranks (PYTEST_ARGS=...)"
	@echo "make test-all  the same with the slow ones, the serial ones with BLAS for other processors,"
	@echo "               and some with complex scalars"
	@echo "make docs      set up and build the site, docs/_build/html/index.html, and check its links"
	@echo "make package   build sdist and wheel, install the wheel in a new environment and try it;"
	@echo "               build the conda package and run its tests"
	@echo "make env       set up alone: everything goes into $(VENV)"
	@echo "make test-container  build the Dockerfile and run its tests, on one rank and on two, with docker,"
	@echo "               podman or buildah, whichever is there"
	@echo "make sanitize  run the tests that reach the C with gcc's checks of addresses and undefined"
	@echo "               behaviour compiled in"
	@echo "make clean     remove $(VENV) and what was built (not results/)"
	@echo "Parts of test: lint, types, test-serial, test-mpi-2, test-mpi-3, test-mpi-4;"
	@echo "of test-all: test-blas, test-complex (sets up $(COMPLEX), which holds DOLFINx's complex build)."
	@echo "PYTHON=... names the Python (>= 3.12) to set up with, MPIRUN=... the mpirun to test with."

env: $(VENV)/installed

# An empty environment. DOLFINx compiles forms at run time, with the C compiler that Python was made
# with unless CC is set
define set_up
	@$(1)/bin/python -c '' 2>/dev/null || { \
		python=$$(.ci/find_python) && echo "Setting up $(1) with $$python" && \
		$$python -m venv --clear $(1); }
	@cc=$${CC:-$$($(1)/bin/python -c 'import sysconfig; print(sysconfig.get_config_var("CC"))')}; \
		echo '#include <stdlib.h>' | $$cc -x c -fsyntax-only - 2>/dev/null || \
		{ echo "No C compiler ($$cc): apt-get install gcc libc6-dev (or set CC)" >&2; exit 1; }
endef

$(VENV)/installed: pyproject.toml
	$(call set_up,$(VENV))
	@echo "Installing what pyproject.toml names (some minutes, 2 GB)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@.ci/system_libraries $(BIN)/python
	@touch $@

env-complex: $(COMPLEX)/installed

$(COMPLEX)/installed: pyproject.toml
	$(call set_up,$(COMPLEX))
	@echo "Installing DOLFINx with complex scalars (340 MB)"
	@$(COMPLEX_BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile \
		--editable '.[dev-complex]'
	@touch $@

# The site's programs go into the same environment. Its pictures are made by the pages' own Python
$(VENV)/docs: $(VENV)/installed
	@echo "Installing what builds the site (60 MB)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

docs: $(VENV)/docs
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs docs/_build/html
	$(BIN)/python docs/_ext/links.py docs/_build/html
	@echo "The site: docs/_build/html/index.html"

# The wheel is made from the sdist, and installed with PyPI's DOLFINx in an environment of its own.
# rattler-build builds the conda package, with stand-ins for conda-forge's packages
package: env
	rm -rf build/package
	$(BIN)/python -m build --outdir build/package/dist
	$(BIN)/python -m venv build/package/venv
	build/package/venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile \
		"hypergap-dolfinx[dolfinx] @ file://$$(echo $(CURDIR)/build/package/dist/*.whl)"
	cd build/package && PATH=$(CURDIR)/build/package/venv/bin:$$PATH \
		venv/bin/python $(CURDIR)/conda/try_installed.py
	build/package/venv/bin/python -m pip install --quiet --disable-pip-version-check \
		py-rattler-build==0.73.0
	build/package/venv/bin/python .ci/recipe $(CURDIR)/$(VENV)

demo: env
	$(BIN)/python demos/pressurised_cylinder.py $(DEMO_ARGS)

parts := lint types test-serial test-mpi-2 test-mpi-3 test-mpi-4

# Each run of pytest adds a line
export TESTS_RAN := $(CURDIR)/build/tests-ran.txt
define tell
@echo
@echo "Tests that ran:"
@cat $(TESTS_RAN)
endef

test: forget $(parts)
	$(tell)

test-all: PYTEST_ARGS += -m ''
test-all: forget $(parts) test-blas test-complex
	$(tell)

forget:
	@mkdir -p $(dir $(TESTS_RAN))
	@rm -f $(TESTS_RAN)

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: env
	$(BIN)/mypy

# Tests and package are compiled to bytecode once, not by each of a dozen processes: 6 s each, where
# a machine asks Python to keep none
test-serial test-mpi-2 test-mpi-3 test-mpi-4 test-blas test-complex: \
	export PYTHONDONTWRITEBYTECODE :=

# One thread a rank: the meshes are small, and ranks times threads would be more than the cores
test-serial test-mpi-2 test-mpi-3 test-mpi-4 test-blas test-complex: export OMP_NUM_THREADS := 1

# A worker a core; more than four would wait for one another's kernels
workers = $(if $(shell $(BIN)/python -c 'import xdist; print(1)' 2>/dev/null), \
	-n auto --maxprocesses 4 --dist worksteal)

test-serial: env
	$(BIN)/python -m pytest $(workers) $(PYTEST_ARGS)

test-blas: env
	.ci/blas $(BIN)/python -m pytest $(workers) $(PYTEST_ARGS) -m 'not slow'

test-mpi-2 test-mpi-3: test-mpi-%: env
	$(MPIRUN) $(mpi_options) -n $* $(BIN)/python -m pytest -p no:cacheprovider $(PYTEST_ARGS)

# On four ranks what shows whether their number matters
test-mpi-4: env
	$(MPIRUN) $(mpi_options) -n 4 $(BIN)/python -m pytest -p no:cacheprovider $(PYTEST_ARGS) \
		tests/doors/test_ranks.py

# With complex scalars what computes with them: some files serial, fewer on two ranks. It has programs
# and libraries of its own
complex_tests := $(addprefix tests/,solvers/test_wave.py solvers/test_problem.py \
	mortar/test_constraint.py mortar/test_adjust.py)
test-complex: export PATH := $(COMPLEX_BIN):$(PATH)
test-complex: env-complex
	$(COMPLEX_BIN)/python -m pytest -W error::numpy.exceptions.ComplexWarning $(PYTEST_ARGS) \
		$(complex_tests) 'tests/doors/test_demos.py::test_demo[wave]'
	$(COMPLEX_BIN)/mpirun -n 2 $(COMPLEX_BIN)/python -m pytest -p no:cacheprovider $(PYTEST_ARGS) \
		tests/solvers/test_wave.py tests/solvers/test_problem.py

# Nothing here that builds a container: said, and no failure
test-container:
	@.ci/container || { status=$$?; [ $$status = 75 ] && echo "make: test-container was SKIPPED"; }

# The libraries have another name with these flags: the cache keeps both
SANITIZE := -g1 -fsanitize=address,undefined -fno-sanitize-recover=undefined
sanitized_tests := tests/core/test_compiled.py $(addprefix tests/surface/test_,moving.py surface.py) \
	$(addprefix tests/gap_mesh/test_,front.py slab.py) tests/contact_geometry
sanitize: export OMP_NUM_THREADS := 1
sanitize: export HYPERGAP_CFLAGS := $(SANITIZE)
sanitize: export ASAN_OPTIONS := detect_leaks=0
sanitize: env
	LD_PRELOAD=$$($${CC:-cc} -print-file-name=libasan.so) \
		$(BIN)/python -m pytest -p no:cacheprovider $(PYTEST_ARGS) $(sanitized_tests)

clean:
	rm -rf $(VENV) $(COMPLEX) build dist *.egg-info .*_cache .hypothesis \
		docs/_build docs/gallery docs/gallery.md docs/pictures
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
