# armcell: set up, run and test with nothing but Python 3.11-3.13 (with venv) and make.
#   make demo                  make test PYTHON=/path/to/python3.12

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test check prepare wheel fuzz bench bench-campaign bench-planning bench-kernel bench-planners bench-constraints bench-wires bench-dual bench-grasp test-long test-interop test-realtime lint format clean FORCE

VENV := .venv
BIN  := $(VENV)/bin
PY   := $(BIN)/python
# Processes that run tests: two per core, since half of a test's time is waiting for an arm or a program. Each
# further process costs 30 CPU-s for collection and kernels; the quick tests rarely wait.
CORES := $(shell getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2)
JOBS ?= $(shell echo $$((2 * $(CORES))))
# Workers take neighboring tests, which share fixtures, and steal from each other at the end.
PYTEST = $(PY) -m pytest -n $(JOBS) --dist worksteal
TESTS := not interop and not realtime and not long
# PYTHON= names the interpreter to use; without it the first usable one of these is taken.
CANDIDATES := $(if $(PYTHON),$(PYTHON),python3.13 python3.12 python3.11 python3)

# A sourced ROS workspace puts packages of another Python on the path: keep them out.
unexport PYTHONPATH PYTHONHOME
# Without bytecode files each of the hundreds of programs that tests start compiles 400 sources (0.3 s).
unexport PYTHONDONTWRITEBYTECODE
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Python compiles the modules that it imports; if pip compiles all modules, installation takes twice as long.
PIP_INSTALL := $(PY) -m pip install --no-compile

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

# What the interop tests talk to, as Debian has it. ROS lives under /usr and is used through /usr/bin/python3.
ROS := python3-rospy python3-rosmaster python3-rostopic python3-rosservice python3-rosparam python3-rosnode \
       python3-rosmsg python3-roslaunch python3-actionlib python3-tf2-ros rosout topic-tools \
       python3-std-srvs python3-sensor-msgs python3-trajectory-msgs python3-shape-msgs python3-visualization-msgs \
       rviz xvfb
ROS_THERE := /usr/bin/python3 -c 'import rospy, rosmaster, rostopic, rosservice, rosnode, rosmsg, actionlib, tf2_ros, \
               std_srvs.srv, sensor_msgs.msg, trajectory_msgs.msg, shape_msgs.msg, visualization_msgs.msg' \
             && test -x /usr/bin/rviz -a -x /usr/bin/Xvfb
FASTDDS := libfastrtps-dev g++
FASTDDS_THERE := test -e /usr/include/fastdds/dds/domain/DomainParticipant.hpp && command -v g++
MONO := mono-mcs mono-runtime
MONO_THERE := command -v mcs && command -v mono
SDFORMAT := g++ pkg-config libsdformat-dev
SDFORMAT_THERE := command -v g++ && pkg-config --exists sdformat12
CHROMIUM := chromium
CHROMIUM_THERE := command -v chromium || command -v chromium-browser || command -v google-chrome || command -v google-chrome-stable

# $(call debian,name,VARIABLE): install $(VARIABLE) unless $(VARIABLE_THERE); where that cannot be, say so and go on.
debian = { $($(2)_THERE); } >/dev/null 2>&1 || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
  && echo "Installing $(1) ..." && apt-get update -q && apt-get install -qy --no-install-recommends $($(2)); } \
  || echo "$(1) cannot be installed from here; its tests are skipped. Hint: apt-get install $($(2))"

demo: $(VENV)/.stamp-run ## set up, then run the Panda pick and place
	$(BIN)/armcell run panda_pick

test: $(VENV)/.stamp ## set up, then lint and run all tests but the long, interop and real-time ones
	@$(MAKE) --no-print-directory -j2 lint prepare
	$(PYTEST) --durations=25 -m "$(TESTS)" || { \
	  echo "Running the failed tests again, one at a time: on a busy machine, time limits can be missed."; \
	  $(PY) -m pytest --last-failed --last-failed-no-failures none -m "$(TESTS)"; }

check: JOBS = $(CORES)
check: prepare ## set up, then run the quick tests
	$(PYTEST) -m "not slow and $(TESTS)"

prepare: $(VENV)/.stamp ## set up, then compile the kernels and fit the covers that tests use
	$(PY) -m tests.prepare

wheel: $(VENV)/.stamp ## set up, then build a wheel in dist/ with compiled kernels for common processors (KEEP=1: keep those for other Pythons)
	$(PY) -m tools.build_wheel $(if $(KEEP),--keep)

fuzz: $(VENV)/.stamp ## set up, then throw damaged input at every parser and a million damaged frames at the wires (INPUTS=, FRAMES=, SEED=)
	$(PY) -m tests.fuzz $(if $(INPUTS),--inputs $(INPUTS)) $(if $(FRAMES),--frames $(FRAMES)) $(if $(SEED),--seed $(SEED))

bench-wires: $(VENV)/.stamp ## set up, then measure latency and losses of the ROS-TCP wire (13 minutes; SECONDS_=600)
	$(PY) benchmarks/wires.py --seconds $(or $(SECONDS_),600)

test-interop: $(VENV)/.stamp ## set up, then test against ROS 1, Fast DDS, Mono, libsdformat, Chromium (from Debian, installed where possible), Franka's clients and Ray
	@$(call debian,Debian's ROS 1,ROS)
	@$(call debian,Fast DDS,FASTDDS)
	@$(call debian,Mono,MONO)
	@$(call debian,Gazebo's SDF parser,SDFORMAT)
	@$(call debian,Chromium,CHROMIUM)
	@$(PIP_INSTALL) -q -r requirements-interop.txt || echo "Franka's clients cannot be installed from here; their tests are skipped"
	$(PY) -m pytest -m interop -rs

test-long: prepare ## set up, then run the expensive tests and the further seeds and cases of others (40 minutes)
	$(PYTEST) -m "long and not interop and not realtime"

test-realtime: $(VENV)/.stamp ## set up, then test emulated arms and wires that must run on time; nothing else should run meanwhile
	$(PY) -m pytest -m realtime

lint: $(VENV)/.stamp ## style, types and the layers of the packages
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

format: $(VENV)/.stamp ## let ruff put the source in order
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench-planners: $(VENV)/.stamp ## set up, then measure every planner on a handful of problems (5 minutes)
	$(PY) -m benchmarks.planners $(BENCH)

bench-kernel: $(VENV)/.stamp ## set up, then look at what the kernel calls free with exact meshes (15 minutes)
	$(PY) -m benchmarks.kernel_truth

bench-planning: $(VENV)/.stamp-bench ## set up, then measure planning beside others (15 minutes); MBM=/path names the problems
	$(PY) -m benchmarks.planning $(BENCH)

bench-constraints: $(VENV)/.stamp ## set up, then measure planning with path constraints (RUNS=50)
	$(PY) -m benchmarks.constraints --runs $(or $(RUNS),50)

bench-campaign: $(VENV)/.stamp ## set up, then measure campaigns: rate, engine, Ray, kills, memory (RUNS=100, KILLS=20)
	$(PY) -m benchmarks.campaign --trials $(or $(RUNS),100) --kills $(or $(KILLS),20) $(if $(JSON),--json $(JSON))

bench: $(VENV)/.stamp-bench ## set up, then run all benchmarks (hours) and write docs/benchmarks.md; ONLY="campaign wires", SIZE=quick
	$(PY) -m benchmarks $(if $(ONLY),--only $(ONLY)) $(if $(filter quick,$(SIZE)),--quick)

bench-dual: $(VENV)/.stamp ## set up, then measure two UR10: planning, proofs, tasks in physics (RUNS=100, an hour)
	$(BIN)/armcell bench dual
	$(PY) -m benchmarks.two_arms --runs $(or $(RUNS),100)

bench-grasp: $(VENV)/.stamp ## set up, then pick 67 objects with two robots, also at wrong poses, look for them, clear bins, compare P(success) with picks, measure solid regions, creep, drift (RUNS=10, POSES=3, hours)
	$(PY) -m benchmarks.grasping --poses $(or $(POSES),3); grasped=$$?; \
	$(PY) -m benchmarks.grasping --poses 1 --errors 3 5 7 10 up5 down5 --draws 2; wrong=$$?; \
	$(PY) -m benchmarks.grasp_probability --factors 5 8 --count 12; panda=$$?; \
	$(PY) -m benchmarks.grasp_probability --robot ur10_gripper --factors 5 8 --count 12; ur10=$$?; \
	$(PY) -m benchmarks.solid_regions; solid=$$?; \
	$(PY) -m benchmarks.mesh_poses; seen=$$?; \
	$(PY) -m benchmarks.bins --half "held out"; bins=$$?; \
	$(PY) -m benchmarks.holding --runs $(or $(RUNS),10) && exit $$((grasped | wrong | panda | ur10 | solid | seen | bins))

clean: ## remove the environment, builds and caches (runs/ stays)
	rm -rf $(VENV) build dist site .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name .git -prune -o -type d -name __pycache__ -prune -exec rm -rf {} +

# ---- set-up: stamps, so that it happens once and again when the pins change -----------------------

# The development set: what test, check, lint and format need.
$(VENV)/.stamp: $(VENV)/.stamp-run requirements.txt requirements-dev.txt pyproject.toml
	@echo "Installing the development set (once) ..."
	$(PIP_INSTALL) -q -r requirements-dev.txt
	@touch $@

# What the benchmarks compare with.
$(VENV)/.stamp-bench: $(VENV)/.stamp requirements-bench.txt
	@echo "Installing the planners to compare with (once) ..."
	$(PIP_INSTALL) -q -r requirements-bench.txt
	@touch $@

# The run-time set: what demo needs.
$(VENV)/.stamp-run: $(VENV)/.python requirements.txt pyproject.toml
	@echo "Installing armcell and what it needs into $(VENV) (once; some minutes, about 1.5 GB on disk) ..."
	$(PIP_INSTALL) -r requirements.txt
	$(PIP_INSTALL) -q --no-deps --no-build-isolation -e .
	@touch $@

# Leaves 0 if this Python can serve, else says why not. Must run on any old Python.
USABLE := import sys; v = sys.version_info[:2]; sys.exit( \
  "is Python %d.%d; 3.11, 3.12 or 3.13 is needed" % v if not (3, 11) <= v <= (3, 13) else \
  None if __import__("importlib.util").util.find_spec("ensurepip") else \
  "is Python %d.%d but cannot create environments; hint: apt install python%d.%d-venv" % (v + v))
IDENTITY := import sys; print(sys.version.split()[0], sys.base_prefix)

# The environment itself; .python holds who made it. With PYTHON= given it is made anew if that one differs.
$(VENV)/.python: $(if $(PYTHON),FORCE)
	@tried=""; \
	for py in $(CANDIDATES); do \
	  if ! command -v "$$py" >/dev/null 2>&1; then why="not found"; \
	  elif ! why=$$("$$py" -c '$(USABLE)' 2>&1); then why=$$(printf '%s\n' "$$why" | head -n 1); \
	  elif id=$$("$$py" -c '$(IDENTITY)') && [ -f $@ ] && [ "$$id" = "$$(cat $@)" ]; then exit 0; \
	  elif echo "Creating $(VENV) with $$py ($$id)" && "$$py" -m venv --clear $(VENV); then \
	    echo "$$id" > $@; exit 0; \
	  else why="could not create $(VENV), see above"; fi; \
	  tried="$$tried  $$py: $$why\n"; \
	done; \
	echo "No usable Python. armcell needs Python 3.11, 3.12 or 3.13 that can create environments." >&2; \
	printf '%b' "$$tried" >&2; \
	echo "Hint: on Debian or Ubuntu 'sudo apt install python3 python3-venv'; elsewhere install Python 3.13." >&2; \
	echo "Or name one: make PYTHON=/path/to/python3.13 <target>" >&2; \
	exit 1
