#!/usr/bin/env bash
# usage: check_cuda.sh [--passed]   checks the CUDA sources on a machine without a GPU: nvcc parses them, and compiles them where
# the device code, its headers or CMake's files are others than those that were compiled when all tests passed last.
# --passed: notes that they did. The note is a hash in a folder of the user's cache, so that any clone finds it.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v nvcc > /dev/null || { echo "CUDA: nvcc is not installed, so not checked"; exit 0; }
if nvidia-smi > /dev/null 2>&1; then exit 0; fi  # the build compiled them

sources=$(find src include cmake CMakeLists.txt -type f ! -path 'src/api/*' ! -name 'cpu*.cpp' | LC_ALL=C sort)
hash=$({ nvcc --version; cat $sources; } | sha256sum | cut -c 1-32)
note=${XDG_CACHE_HOME:-${HOME:-/nonexistent}/.cache}/globule/cuda-passed/$hash
done=build/cuda-checked/$hash
if [ "${1:-}" = --passed ]; then
  mkdir -p "$(dirname "$note")" && touch "$note" || echo "CUDA: not noted that all tests passed"
  exit 0
fi
[ -e "$done" ] && exit 0
mkdir -p build/cuda-checked
if [ -e "$note" ]; then
  options=(-fdevice-syntax-only) what=parsed
else
  options=(--Ofast-compile max) what=compiled
fi
echo "CUDA: the sources are being $what"
flags=(-std=c++20 -arch=compute_75 -ptx --expt-relaxed-constexpr -Werror=cross-execution-space-call -Xcompiler=-Wno-psabi,-fopenmp
  -Isrc -Iinclude)
printf '%s\n' src/backends/*.cu | xargs -P "$(nproc)" -I{} nvcc "${flags[@]}" "${options[@]}" -o /dev/null {}
touch "$done"
