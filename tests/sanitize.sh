#!/usr/bin/env bash
# The C++ tests and a part of the Python tests under AddressSanitizer and UndefinedBehaviorSanitizer, and the C++ tests of
# threads under ThreadSanitizer: `make sanitize`, or `sanitize.sh PYTHON [address|thread]`.
#
# libgomp is not built for ThreadSanitizer, which then sees races between its threads that are none: OMP_NUM_THREADS=1 there,
# so that the threads of the tests themselves remain.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$(realpath -s "$1") only=${2:-all}
export PATH="$(dirname "$python"):$PATH"
generator=(); command -v ninja > /dev/null && generator=(-G Ninja)

configure() { # FOLDER SANITIZERS OPTIONS...
  local folder=$1 sanitizers=$2; shift 2
  cmake -S . -B "$folder" "${generator[@]}" -DGLOBULE_CUDA=OFF -DGLOBULE_LEVELS=v3 -DGLOBULE_SANITIZE="$sanitizers" \
    -DCMAKE_BUILD_TYPE=Release "$@" > "$folder.log"
  cmake --build "$folder" --parallel "$(nproc)" >> "$folder.log" || { grep -m 20 error "$folder.log"; exit 1; }
}
cpp_tests() { # FOLDER CONFIG SANITIZERS
  cmake -S tests/cpp -B "$1" "${generator[@]}" -Dglobule_DIR="$2" -DCMAKE_CXX_FLAGS="-fsanitize=$3 -fno-omit-frame-pointer -g1" > "$1.log"
  cmake --build "$1" --parallel "$(nproc)" >> "$1.log" || { grep -m 20 error "$1.log"; exit 1; }
}

mkdir -p build
if [ "$only" != thread ]; then
  echo "address, undefined: building"
  configure build/asan address,undefined -Dnanobind_DIR="$("$python" -m nanobind --cmake_dir)" -DPython_EXECUTABLE="$python"
  rm -rf build/asan/site && mkdir -p build/asan/site && cp -r python/globule build/asan/site/ && rm -f build/asan/site/globule/*.so
  cmake --install build/asan --prefix build/asan/site > /dev/null
  cpp_tests build/asan-cpp "$PWD/build/asan/site/globule/cmake" address,undefined
  # Python keeps memory to its end; reports go to files, since pytest holds back what a test that ends the process wrote.
  export ASAN_OPTIONS=detect_leaks=0:log_path=$PWD/build/asan-report UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1:log_path=$PWD/build/asan-report
  rm -f build/asan-report.*
  trap 'head -n 30 build/asan-report.* 2> /dev/null || true' EXIT
  build/asan-cpp/cpp_tests
  GLOBULE_TEST_PATIENCE=900 LD_PRELOAD="$(gcc -print-file-name=libasan.so) $(gcc -print-file-name=libubsan.so)" PYTHONPATH=build/asan/site PYTHONMALLOC=malloc \
    "$python" -m pytest -q -x -p no:cacheprovider -k "not cuda and not interpreter_is_free and not is_exact" tests/test_interrupts.py tests/test_concurrency.py \
    tests/test_device_arrays.py tests/test_octree.py tests/test_field.py tests/test_anisotropy.py tests/test_light_cuts.py \
    tests/test_sim_fluid.py tests/test_sim_tissue_cut.py tests/test_thesis.py tests/test_live.py
fi
if [ "$only" != address ]; then
  echo "thread: building"
  configure build/tsan thread -DGLOBULE_PYTHON=OFF
  cmake --install build/tsan --prefix build/tsan/prefix > /dev/null
  cpp_tests build/tsan-cpp "$PWD/build/tsan/prefix/lib/cmake/globule" thread
  OMP_NUM_THREADS=1 TSAN_OPTIONS=halt_on_error=1 build/tsan-cpp/cpp_tests
fi
