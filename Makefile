# `make` alone lists what there is. Each target makes what it needs.
#   PYTHON=python3.12   the Python to use (3.11 or later)
#   VENV=.venv          where its environment is made; it is made again when PYTHON changes
#   ARGS=...            more arguments for pytest or the demo, e.g. make test ARGS='-k solver -x'
PYTHON ?= python3
VENV ?= .venv
DEMO := $(VENV)-demo
OLDEST := $(VENV)-oldest
COLCON := $(VENV)-colcon
ARGS ?=
LIVE_SECONDS ?=

# One more than there are cores, as tests of nodes wait; more than four only fight for the DDS.
WORKERS := $(shell n=$$(getconf _NPROCESSORS_ONLN); [ $$n -lt 4 ] && echo $$((n + 1)) || echo 4)
PYTEST_FLAGS := -n $(WORKERS) --dist worksteal
BENCHES := $(wildcard $(addprefix bench/,solver.py replay.py latency.py fusion_latency.py fusion_step.py tracker.py tracker_live.py centerline.py))

# A sourced ROS, or the environment of another Python, must not leak into ours.
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH
endif
# Images of containers often forbid to keep compiled bytes: every process would compile all libraries.
unexport PYTHONDONTWRITEBYTECODE
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH PYTHONHOME _ROS_WHEELS_BOOTSTRAP_COMPLETE

VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
# Bytes of Python are compiled where they are imported: a third of the time of installing.
PIP := -m pip --disable-pip-version-check install --no-compile
# The clone itself on the path: in the folder above it, it would be taken for a package otherwise.
EDITABLE := --config-settings editable_mode=compat

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

.PHONY: help
help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

.PHONY: setup
setup: $(VENV)/kernels ## for contributors: .venv with all that running, testing and ROS need
	@$(VENV)/bin/pneunet --version
	@$(VENV)/bin/python -c 'import rclpy' 2>/dev/null && echo 'ROS 2: rclpy is there' || echo 'ROS 2: not here, tests of the nodes are skipped'
	@echo 'next: make quick (tests of a minute), make check (style, types, rooms), make help (all targets)'

.PHONY: demo
demo: $(DEMO)/run ## the first minute: the arm of the paper, replayed; sets up what it needs
	@PYTHONPATH=. $(DEMO)/bin/python -m pneunet_ros.cli demo --overwrite $(ARGS)

.PHONY: install
install: $(VENV)/run ## .venv with the command pneunet, for recordings and films, without ROS
	@echo 'next: source $(VENV)/bin/activate, then pneunet --help'

.PHONY: live
live: $(VENV)/all ## the whole stack without hardware, until Ctrl-C or for LIVE_SECONDS=20
	LIVE_SECONDS=$(LIVE_SECONDS) $(VENV)/bin/python examples/live.py $(ARGS)

.PHONY: quick
quick: $(VENV)/kernels ## the tests of a minute: no processes, no films, no diagnoses
	$(VENV)/bin/python -m pytest $(PYTEST_FLAGS) -m 'not slow and not ros and not lengthy' test $(ARGS)

.PHONY: test
test: $(VENV)/kernels ## the tests, without the slow ones; sets up what they need
	$(VENV)/bin/python -m pytest $(PYTEST_FLAGS) $(ARGS)

.PHONY: test-all
test-all: $(VENV)/kernels ## all tests
	$(VENV)/bin/python -m pytest $(PYTEST_FLAGS) -m '' $(ARGS)

.PHONY: test-oldest
test-oldest: $(OLDEST)/all ## the tests on the libraries of Ubuntu 24.04
	$(OLDEST)/bin/python -m pytest $(PYTEST_FLAGS) $(ARGS)

.PHONY: bench
bench: $(VENV)/all ## how fast and how exact it is here: solver, replay, tracker, nodes
	@set -e; for bench in $(BENCHES); do echo "== $$bench"; $(VENV)/bin/python $$bench; done

.PHONY: soak
soak: $(VENV)/all ## both nodes under faults of all kinds; ARGS='--minutes 5' for a short one
	$(VENV)/bin/python acceptance/soak.py $(ARGS)

.PHONY: check
check: $(VENV)/all ## format, lint, types, rooms, numbers that decide
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(VENV)/bin/python acceptance/deciding_numbers.py

.PHONY: format
format: $(VENV)/all ## put the code into shape
	$(VENV)/bin/ruff format .
	$(VENV)/bin/ruff check --fix .

.PHONY: colcon
colcon: $(COLCON)/all ## build as on a robot, with colcon from PyPI: install/local_setup.bash
	AMENT_PREFIX_PATH=$(abspath $(COLCON)) $(COLCON)/bin/python -m colcon build --base-paths .
	bash -c 'source install/local_setup.bash && install/pneunet_ros/lib/pneunet_ros/pneunet --version'
	test -x install/pneunet_ros/lib/pneunet_ros/estimator
	test -x install/pneunet_ros/lib/pneunet_ros/tracker
	test -x install/pneunet_ros/lib/pneunet_ros/fusion
	test -x install/pneunet_ros/lib/pneunet_ros/virtual_arm
	test -x install/pneunet_ros/lib/pneunet_ros/pneunet_stack

.PHONY: docs
docs: $(VENV)/all ## the pages as a site: build/docs/index.html
	$(VENV)/bin/python -m sphinx -W --keep-going -q docs build/docs

.PHONY: clean
clean: ## remove all that was made here
	rm -rf $(VENV) $(DEMO) $(OLDEST) $(COLCON) build install log dist demo *.egg-info docs/generated docs/index.md .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find pneunet_ros test bench acceptance examples launch -name __pycache__ -prune -exec rm -rf {} +

# One environment for one version of Python.
%/python-$(VERSION):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed: make PYTHON=python3.12 ...")'
	@rm -rf $*
	@$(PYTHON) -m venv $*
	@touch $@

# What the demo needs and no more: the list READINGS of setup.py, and the clone as it is.
$(DEMO)/run: $(DEMO)/python-$(VERSION) setup.py
	@echo 'setting up $(DEMO), once: the libraries that the demo needs, less than a minute'
	@$(DEMO)/bin/python $(PIP) $$(sed -n "/^READINGS = /,/^]/s/^ *'\(.*\)',/\1/p" setup.py)
	@touch $@

$(VENV)/run: $(VENV)/python-$(VERSION) setup.py
	@echo 'setting up $(VENV), once: pneunet_ros and the libraries it needs, about a minute'
	@$(VENV)/bin/python $(PIP) $(EDITABLE) -e .
	@touch $@

$(VENV)/all: $(VENV)/python-$(VERSION) setup.py
	@echo 'setting up $(VENV), once: pneunet_ros, ROS 2 and the tools for testing, some minutes'
	@$(VENV)/bin/python $(PIP) $(EDITABLE) -e '.[dev,ros]'
	@touch $(VENV)/run $@

# The kernels, once, before several test processes want them; seconds where they are compiled.
.PHONY: $(VENV)/kernels
$(VENV)/kernels: $(VENV)/all
	@$(VENV)/bin/python -m pneunet_ros.cli compile

# Nothing is compiled, so that no compiler is needed; empy is plain Python and has no wheel.
$(OLDEST)/all: $(OLDEST)/python-$(VERSION) setup.py test/constraints-oldest.txt
	$(OLDEST)/bin/python $(PIP) --only-binary :all: --no-binary empy \
		--constraint test/constraints-oldest.txt -e '.[dev,ros]'
	@touch $@

# All that the package needs and not the package itself: that is what colcon installs.
$(COLCON)/all: $(COLCON)/python-$(VERSION) setup.py
	$(COLCON)/bin/python $(PIP) colcon-common-extensions -e '.[ros]'
	$(COLCON)/bin/python -m pip --quiet uninstall --yes pneunet_ros
	@touch $@
