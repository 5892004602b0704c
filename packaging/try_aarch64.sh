#!/usr/bin/env bash
# usage: try_aarch64.sh [FOLDER]   cross-compiles the C++ libraries for aarch64 and runs the C++ tests under QEMU.
# Debian: sudo apt-get install g++-aarch64-linux-gnu qemu-user doctest-dev cmake ninja-build
# On an aarch64 machine nothing of this is needed: make test.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
folder=$(mkdir -p "${1:-$root/build/aarch64}" && cd "${1:-$root/build/aarch64}" && pwd)
for tool in aarch64-linux-gnu-g++ qemu-aarch64 cmake ninja; do
  command -v "$tool" > /dev/null || { echo "$tool is missing: see the head of $0"; exit 1; }
done
[ -f /usr/include/doctest/doctest.h ] || { echo "doctest.h is missing: sudo apt-get install doctest-dev"; exit 1; }
mkdir -p "$folder/doctest"
cp /usr/include/doctest/doctest.h "$folder/doctest"  # its folder holds headers of this machine's processor, too
settings=(-G Ninja -DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=aarch64 -DCMAKE_CXX_COMPILER=aarch64-linux-gnu-g++)
cmake -S "$root" -B "$folder/build" "${settings[@]}" -DGLOBULE_PYTHON=OFF -DGLOBULE_CUDA=OFF -DCMAKE_INSTALL_PREFIX="$folder/installed"
cmake --build "$folder/build" --target install
cmake -S "$root/tests/cpp" -B "$folder/tests" "${settings[@]}" -DDOCTEST_DIR="$folder/doctest" \
  -Dglobule_DIR="$folder/installed/lib/cmake/globule"
cmake --build "$folder/tests"
OMP_WAIT_POLICY=passive GOMP_SPINCOUNT=400 qemu-aarch64 -L /usr/aarch64-linux-gnu "$folder/tests/cpp_tests"
