# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0

DISTRO ?= jazzy
PYTHON ?= python3
VENV ?= $(if $(filter jazzy,$(DISTRO)),.venv,.venv-$(DISTRO))
BIN := $(VENV)/bin
SYSTEM ?= aircraft
# OpenBLAS picks a kernel for the processor; each rounds matrix products in its own way.
KERNEL ?= $(shell grep -qw avx512f /proc/cpuinfo && echo Haswell || echo Nehalem)
SOLVER := $(addsuffix .py,$(addprefix test/,book/test_closed_forms \
	$(addprefix core/,riccati/test_fixed_horizon \
	solver/proofs/test_singular_expressions solver/test_rounding solver/improve/test_kink_mesh \
	riccati/test_care lqr/test_dlqr lqr/test_margins lqr/test_sampled solver/improve/test_arc_iteration \
	solver/starts/test_final_time_windows solver/test_linear_quadratic tasks/test_minimize \
	solver/exact/test_time_optimal solver/nlp/test_interior_point)))

# What depends on the ROS 2 distribution: the three nodes, parameter files, the profile of Fast DDS.
SMOKE := $(addprefix test/,nodes/test_loop_over_dds.py nodes/test_server_requests.py \
	nodes/test_parameter_files.py ros/test_middleware.py)

# Tests with nodes wait half of their time: three workers keep two cores at work. Each takes the
# next tests of the order that test/conftest.py gives. Tests that share a loop and a browser go to
# one worker. Of several threads of BLAS each would wait in a busy loop for the others.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
PYTEST := $(ONE_THREAD) $(BIN)/pytest
TESTS := $(PYTEST) -n 3 --dist loadgroup --no-loadscope-reorder
PIP := $(BIN)/python -m pip --disable-pip-version-check
# What takes minutes shows what it does, and for how long.
SHOWN := $(BIN)/python requirements/progress.py
TESTED := $(addprefix requirements/,run.txt test.txt notebooks.txt)
REQUIRED := $(addprefix requirements/,$(DISTRO).txt ros.txt web.txt) $(TESTED)
# Other Python files are no prerequisite: the installation is editable, a change is seen at once.
SOURCES := setup.py pyproject.toml package.xml CMakeLists.txt requirements/build_backend.py \
	obc_ros/__init__.py cmake resource \
	$(wildcard cmake/* resource/*) $(foreach folder,msg srv action config launch foxglove rviz,\
	$(wildcard $(folder) $(folder)/*))

# A sourced ROS 2 or another environment must not leak into this one.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
unexport ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION _ROS_WHEELS_BOOTSTRAP_COMPLETE VIRTUAL_ENV
# Without files of compiled modules, each process compiles what has changed since the set-up, and
# pytest rewrites every test again: half of the time of its collection.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup develop demo view check quick test smoke pure kernel lint house bench gallery \
	picture docs clean
.DELETE_ON_ERROR:

help: ## say what there is to make
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 14
	@echo 'DISTRO=jazzy|kilted VENV=$(VENV) PYTHON=$(PYTHON); ARGS=... goes to demo, test, bench and gallery'

setup: $(VENV)/.obc_ros ## everything into the environment, from pinned packages

develop: setup $(VENV)/.develop ## the set-up, colcon and the commit hooks

demo: setup ## the set-up, then the loop in flight (SYSTEM=aircraft|vehicle|mpc|lqg)
	$(BIN)/obc demo $(SYSTEM) $(ARGS)

view: setup ## the set-up, then the loop and its live page in a browser (SYSTEM=aircraft|vehicle)
	$(BIN)/obc view --scenario $(SYSTEM) $(ARGS)

check: ## in 90 s: lint, house, every quick test, one loop over DDS
	@$(MAKE) --no-print-directory -j 2 quick lint house

quick: setup
	$(PYTEST) -n 2 --dist load --maxschedchunk 1 -m check $(ARGS)

test: setup ## the set-up and every test, three at a time
	$(TESTS) $(ARGS)

smoke: setup ## the three nodes, for another distribution (DISTRO=kilted)
	$(TESTS) $(ARGS) $(SMOKE)

pure: .venv-pure/.requirements ## the wheel without ROS 2 in .venv-pure, and the quick tests that need none
	@echo 'obc_ros: the pure wheel into .venv-pure'
	@OBC_ROS_PURE=1 .venv-pure/bin/python -m pip --disable-pip-version-check install -qq \
		--no-deps --no-build-isolation --force-reinstall .
	$(ONE_THREAD) .venv-pure/bin/pytest -n 2 --dist load --maxschedchunk 1 -m '(check or notebook) and not nodes' $(ARGS)

kernel: setup ## the solver's tests with another kernel of OpenBLAS (KERNEL=Haswell|Nehalem|...)
	OPENBLAS_CORETYPE=$(KERNEL) $(PYTEST) -n 2 --dist load --maxschedchunk 1 -m 'not nodes' $(ARGS) $(SOLVER)

lint: setup ## ruff, and mypy --strict on obc_ros
	$(BIN)/ruff check .
	$(BIN)/mypy

house: ## the folders, the imports between them, and the rules they break
	@$(PYTHON) docs/house.py

bench: setup ## the benchmarks, and which results in docs/ are older than their code
	$(BIN)/obc bench $(ARGS)

gallery: setup ## run the gallery and keep its pages in docs/gallery (ARGS='example-2.5' for one entry)
	$(BIN)/python docs/keep_gallery.py $(ARGS)

picture: setup ## fly the aircraft, and draw the pictures of the README
	$(BIN)/obc demo aircraft
	$(BIN)/python docs/moving_picture.py out/aircraft docs/flight.gif
	$(BIN)/python docs/example_figure.py
	$(BIN)/python docs/badges.py
	$(BIN)/python docs/view_pictures.py

docs: setup .venv-docs/.requirements ## the documentation, in out/docs
	@$(BIN)/python docs/run_notebooks.py
	@.venv-docs/bin/sphinx-build -aE -W --keep-going -q -d out/doctrees docs out/docs
	@echo 'obc_ros: out/docs/index.html'

clean: ## remove what was built and installed
	rm -rf .venv .venv-docs .venv-kilted .venv-pure build install log *.egg-info .hypothesis .mypy_cache \
		.pytest_cache .ruff_cache

# An environment that was interrupted while it was made has no pip: it is made anew.
$(VENV)/.environment:
	@echo 'obc_ros: virtual environment $(VENV)'
	@$(BIN)/python -m pip --version > /dev/null 2>&1 || \
		$(PYTHON) -m venv $(if $(wildcard $(VENV)/pyvenv.cfg),--clear) $(VENV)
	@touch $@

$(VENV)/.requirements: $(REQUIRED) | $(VENV)/.environment
	@$(SHOWN) 'ROS 2 $(DISTRO) and pinned packages into $(VENV) (a minute or two)' \
		$(PIP) install --progress-bar off $(addprefix -r ,$(REQUIRED))
	@touch $@

.venv-pure/.requirements: $(TESTED)
	@$(PYTHON) -m venv --clear .venv-pure
	@$(PYTHON) requirements/progress.py 'pinned packages into .venv-pure (a minute or two)' \
		.venv-pure/bin/python -m pip --disable-pip-version-check install --progress-bar off \
		$(addprefix -r ,$^)
	@touch $@

.venv-docs/.requirements: requirements/docs.txt
	@echo 'obc_ros: Sphinx into .venv-docs'
	@$(PYTHON) -m venv --clear .venv-docs
	@.venv-docs/bin/python -m pip --disable-pip-version-check -qq install -r $<
	@touch $@

$(VENV)/.obc_ros: $(VENV)/.requirements $(SOURCES)
	@$(SHOWN) 'messages, services, action (a minute at first)' \
		$(PIP) install --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m compileall -q obc_ros  # pip compiles what it copies; commands start faster
	@touch $@

$(VENV)/.develop: $(VENV)/.obc_ros requirements/develop.txt
	@$(PIP) -qq install -r requirements/develop.txt -r requirements/run.txt
	@$(BIN)/pre-commit install
	@touch $@
