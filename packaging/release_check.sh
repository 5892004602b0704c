#!/usr/bin/env bash
# usage: release_check.sh [--before]   the end of `make release-check`: the quick tests on each Python from 3.10 to 3.13.
# What this machine lacks is named before (--before) and at the end, which then fails.
set -euo pipefail
cd "$(dirname "$0")/.."
versions=(3.10 3.11 3.12 3.13) missing=()
nvidia-smi > /dev/null 2>&1 || missing+=("a GPU")
for version in "${versions[@]}"; do command -v "python$version" > /dev/null || missing+=("python$version"); done
if [ "${1:-}" = --before ]; then
  [ ${#missing[@]} -eq 0 ] || printf 'will not be checked, since it is not on this machine: %s\n' "${missing[@]}"
  exit 0
fi
for version in "${versions[@]}"; do
  command -v "python$version" > /dev/null || continue
  folder=build/release-$version
  echo "python$version: building, then the quick tests"
  rm -rf "$folder" && "python$version" -m venv "$folder"
  GLOBULE_CUDA=OFF "$folder/bin/python" -m pip install -q --config-settings=build-dir="build/release-{wheel_tag}" ".[test]"
  "$folder/bin/python" -m pytest -q -n 2 --dist loadfile --max-worker-restart 0 tests
done
[ ${#missing[@]} -eq 0 ] || { printf 'not checked, since it is not on this machine: %s\n' "${missing[@]}"; exit 1; }
