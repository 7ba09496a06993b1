# Everything works in a fresh clone: each target makes .venv and installs what it needs, once.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# setuptools explains at length what an editable installation is.
PIP_INSTALL := PYTHONWARNINGS='ignore:Editable installation' $(BIN)/python -m pip install --quiet

# What gets a processor only when nobody else wants it: what runs in real time beside it does not notice.
# Linux shares processors among sessions first (autogroups), and each program that a test starts has its own.
ifneq (,$(shell command -v chrt))
IDLE := setsid sh -c '{ echo 10 >/proc/self/autogroup; } 2>/dev/null; exec chrt --idle 0 "$$@"' sh
else
IDLE := nice -n 19
endif

# A sourced ROS workspace or a user's site-packages must not leak in.
unexport PYTHONPATH PYTHONHOME PIP_USER PIP_TARGET PIP_PREFIX
# Each drone is a process: without byte code each of them compiles all modules anew.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONNOUSERSITE := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# The lowest versions that pyproject.toml allows are in an environment of their own, with the tools of these tests.
# They need Python 3.11 or 3.12: some have no wheel for 3.13. The packages of the dashboard are new ones in any case.
LOWEST := .venv-lowest
LOWEST_EXTRAS := foxglove,gym,mocap,mujoco,ros2,tables
LOWEST_TOOLS := hypothesis mcap-ros2-support pytest pytest-asyncio pytest-timeout pytest-xdist pyusb rosbags
# A few tests of each room that uses a package.
LOWEST_TESTS := $(addprefix tests/unit/,numerics control filters bus optimization/problems optimization/assignment \
	routing/distributed planning/drawing/test_svg.py recording/mcap recording/test_recorder.py \
	recording/test_video.py radio/link radio/virtual cli/setup/test_import_swarm.py cli/recordings cli/test_main.py \
	simulation/mujoco api/test_env.py api/test_table.py) $(addprefix tests/system/,test_zenoh_link.py test_security.py \
	test_missions.py test_virtual_time.py)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help compile demo test lowest check reference docs bench paper campaign clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "  PYTHON=python3.13 chooses the interpreter of $(VENV) (3.11 to 3.14); now: $(PYTHON)"

compile: $(VENV)/.installed  ## compile all laws, once: a minute or two
	@$(BIN)/crazychoir compile

demo: $(VENV)/.installed  ## six drones in six processes plan and fly pickups and deliveries; 20 % of messages lost
	@mkdir -p out
	$(BIN)/crazychoir run pickup_delivery --processes 6 --loss 0.2 --seed 1 --picture out/routes.png

test: $(VENV)/.installed-test compile  ## all tests but the campaigns, with ruff, mypy and the import contract
	@mkdir -p out
	@echo "What runs in real time is shown here; what only computes runs beside it, and is shown afterwards."
	@$(IDLE) $(BIN)/python -m pytest -n auto --dist loadfile -m "not (slow or real_time)" \
		-o cache_dir=.pytest_cache/computing --durations=40 >out/computing.txt 2>&1 & beside=$$!; trap 'kill $$beside; exit 130' INT TERM; \
	$(BIN)/python -m pytest -v --durations=12 -m "real_time and not slow"; real_time=$$?; \
	wait $$beside; computing=$$?; cat out/computing.txt; exit $$((real_time | computing))

lowest: $(LOWEST)/.installed  ## a choice of the tests with the lowest versions that pyproject.toml allows
	$(LOWEST)/bin/python -m pytest -n auto --dist loadfile -W default -m "not (slow or real_time)" $(LOWEST_TESTS)
	$(LOWEST)/bin/python -m pytest -W default -m "real_time and not slow" $(LOWEST_TESTS)

check: $(VENV)/.installed-test  ## ruff, its layout, mypy --strict and the import contract alone: seconds
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

reference: $(VENV)/.installed-test  ## write the generated tables of the READMEs: keys, commands, topics, safety
	cd tests && ../$(BIN)/python -m reference

docs: $(VENV)/.installed-docs  ## the documentation as a site: out/docs/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(VENV)/.installed-bench compile  ## measure, beside CycloneDDS and MPI
	$(BIN)/crazychoir bench all

paper: $(VENV)/.installed-bench compile  ## tables and pictures of the routing's benchmarks, into out/paper: an hour
	$(BIN)/crazychoir bench paper --out out/paper

campaign: $(VENV)/.installed-test compile  ## ten thousand seeds of faults in virtual time, then the long tests
	cd tests && ../$(BIN)/python -m campaign 0-9999
	cd tests && ../$(BIN)/python -m campaign 0-9999 --world sim://motors
	$(BIN)/python -m pytest -m slow

clean:  ## remove the environment and all caches; out/ stays
	rm -rf $(VENV) $(LOWEST) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find agents crazychoir deploy docs tests -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' || \
		{ echo "$$($(PYTHON) --version 2>&1) ($(PYTHON)): allowed: Python 3.11 to 3.14. Try: make PYTHON=python3.13"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@$(PIP_INSTALL) --upgrade pip
	@touch $@

$(VENV)/.installed: pyproject.toml $(VENV)/.created
	@echo "Installing crazychoir into $(VENV) (the first time it takes a minute or two)"
	@$(PIP_INSTALL) --editable .
	@touch $@

$(VENV)/.installed-%: pyproject.toml $(VENV)/.created
	@echo "Installing crazychoir and its dependency group $* into $(VENV) (the first time it takes a minute or two)"
	@$(PIP_INSTALL) 'pip>=25.1'  # the first one with --group
	@$(PIP_INSTALL) --editable . --group $*
	@touch $@ $(VENV)/.installed

$(LOWEST)/.installed: pyproject.toml tests/lowest_versions.py
	@echo "Installing crazychoir and the lowest versions of its packages into $(LOWEST)"
	@$(PYTHON) -m venv --clear $(LOWEST)
	@$(LOWEST)/bin/python tests/lowest_versions.py >$(LOWEST)/constraints.txt
	@PYTHONWARNINGS='ignore:Editable installation' $(LOWEST)/bin/python -m pip install --quiet \
		--constraint $(LOWEST)/constraints.txt --editable '.[$(LOWEST_EXTRAS)]' $(LOWEST_TOOLS)
	@touch $@
