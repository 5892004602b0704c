#!/usr/bin/env bash
# usage: release_check.sh PYTHON   the end of `make release-check`, with what it made: the GPU tests, and the quick tests on each
# Python from 3.10 to 3.13. What this machine lacks is named at the end, and fails.
set -euo pipefail
cd "$(dirname "$0")/.."
missing=()
if nvidia-smi > /dev/null 2>&1; then "$1" -m pytest -q -m gpu --matrix tests; else missing+=("a GPU"); fi
for version in 3.10 3.11 3.12 3.13; do
  if ! command -v "python$version" > /dev/null; then
    missing+=("python$version")
    continue
  fi
  folder=build/release-$version
  echo "python$version: building, then the quick tests"
  rm -rf "$folder" && "python$version" -m venv "$folder"
  GLOBULE_CUDA=OFF "$folder/bin/python" -m pip install -q --config-settings=build-dir="build/release-{wheel_tag}" ".[test]"
  "$folder/bin/python" -m pytest -q -n 2 --dist loadfile tests
done
if [ ${#missing[@]} -gt 0 ]; then
  printf 'not checked, since it is not on this machine: %s\n' "${missing[@]}"
  exit 1
fi
