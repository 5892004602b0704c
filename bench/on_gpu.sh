#!/usr/bin/env bash
# Builds on a machine with a GPU and no network (nanobind, cmake and ninja installed), into python/.
set -euo pipefail
cd "$(dirname "$0")/.."
cmake -S . -B build/gpu -G Ninja -DCMAKE_CUDA_FLAGS=--split-compile=0 -DGLOBULE_CUDA=ON -DGLOBULE_LEVELS="${GLOBULE_LEVELS:-v4}" -Dnanobind_DIR="$(python3 -m nanobind --cmake_dir)" > build-gpu.log 2>&1 \
  && cmake --build build/gpu >> build-gpu.log 2>&1 || { tail -40 build-gpu.log; exit 1; }
cmake --install build/gpu --prefix python > /dev/null
grep "globule: CUDA" build-gpu.log
