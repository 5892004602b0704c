#!/usr/bin/env bash
# The C++ tests and the quick Python tests under AddressSanitizer and UndefinedBehaviorSanitizer, and both under ThreadSanitizer:
# `make sanitize`, or `sanitize.sh PYTHON [address|thread] [OPTIONS OF PYTEST]`. A test that fails beside it says nothing about
# memory (limits of a process do not hold with a sanitizer's tables): what counts is that nothing was reported.
#
# libgomp is not built for ThreadSanitizer, which then sees races between its threads that are none: a loop has one there
# whatever is asked for, so that the threads of the tests themselves remain.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$(realpath -s "$(command -v "$1")") only=${2:-all}
options=("${@:3}")
export PATH="$(dirname "$python"):$PATH"
cores=$(nproc)  # asked once: it heeds the limits of threads that are set below
generator=(); command -v ninja > /dev/null && generator=(-G Ninja)

configure() { # FOLDER SANITIZERS OPTIONS...
  local folder=$1 sanitizers=$2; shift 2
  cmake -S . -B "$folder" "${generator[@]}" -DGLOBULE_CUDA=OFF -DGLOBULE_LEVELS=v3 -DGLOBULE_SANITIZE="$sanitizers" \
    -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_FLAGS_RELEASE=-O1 "$@" > "$folder.log"
  cmake --build "$folder" --parallel "$cores" >> "$folder.log" || { grep -m 20 error "$folder.log"; exit 1; }
}
cpp_tests() { # FOLDER CONFIG SANITIZERS
  cmake -S tests/cpp -B "$1" "${generator[@]}" -Dglobule_DIR="$2" -DCMAKE_CXX_FLAGS="-fsanitize=$3 -fno-omit-frame-pointer -g1" > "$1.log"
  cmake --build "$1" --parallel "$cores" >> "$1.log" || { grep -m 20 error "$1.log"; exit 1; }
}

python_site() { # FOLDER: the package with what was built there
  rm -rf "$1/site" && mkdir -p "$1/site" && cp -r python/globule "$1/site/" && rm -f "$1"/site/globule/*.so
  cmake --install "$1" --prefix "$1/site" > /dev/null
}
python_tests() { # FOLDER LIBRARIES...
  local folder=$1 preload=() failed=0; shift
  for library; do preload+=("$(gcc -print-file-name="$library")"); done
  GLOBULE_TEST_PATIENCE=900 LD_PRELOAD="${preload[*]}" PYTHONMALLOC=malloc PYTHONPATH=$PWD/$folder/site:${PYTHONPATH:-} \
    "$python" -m pytest -q -p no:cacheprovider -n "$cores" --dist loadfile --max-worker-restart 0 -k "not cuda" tests "${options[@]}" \
    > "$folder.tests.log" 2>&1 || failed=$?
  grep -E "^(FAILED|ERROR)|worker .* crashed" "$folder.tests.log" || true
  tail -n 1 "$folder.tests.log"
  [ "$failed" -le 1 ]  # some failed, but all ran
}
reports() { # NAME: what was reported, which ends this
  local found
  # A process with a limit of its memory reports nothing but that the sanitizer found none.
  mapfile -t found < <(grep -lE "runtime error|ERROR: AddressSanitizer|WARNING: ThreadSanitizer" build/"$1"-report.* 2> /dev/null)
  [ ${#found[@]} -gt 0 ] || { echo "$1: nothing reported"; return 0; }
  echo "$1: ${#found[@]} processes reported:"
  grep -hE "runtime error|ERROR: AddressSanitizer|SUMMARY: ThreadSanitizer" "${found[@]}" | sort | uniq -c | sort -rn | head -n 40
  head -n 40 "${found[0]}"
  exit 1
}

python_options=(-Dnanobind_DIR="$("$python" -m nanobind --cmake_dir)" -DPython_EXECUTABLE="$python")
mkdir -p build
rm -f build/asan-report.* build/tsan-report.*
if [ "$only" != thread ]; then
  echo "address, undefined: building"
  configure build/asan address,undefined "${python_options[@]}"
  python_site build/asan
  cpp_tests build/asan-cpp "$PWD/build/asan/site/globule/cmake" address,undefined
  # Python keeps memory to its end; reports go to files, since pytest holds back what a test that ends the process wrote.
  export ASAN_OPTIONS=detect_leaks=0:log_path=$PWD/build/asan-report UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1:log_path=$PWD/build/asan-report
  build/asan-cpp/cpp_tests
  python_tests build/asan libasan.so libubsan.so
  reports asan
fi
if [ "$only" != address ]; then
  echo "thread: building"
  configure build/tsan thread "${python_options[@]}"
  python_site build/tsan
  cpp_tests build/tsan-cpp "$PWD/build/tsan/site/globule/cmake" thread
  echo "deadlock:mca_btl_tcp" > build/tsan.suppressions  # Open MPI's own, between its peers and its end
  export OMP_THREAD_LIMIT=1
  export TSAN_OPTIONS=report_signal_unsafe=0:log_path=$PWD/build/tsan-report:suppressions=$PWD/build/tsan.suppressions
  build/tsan-cpp/cpp_tests
  python_tests build/tsan libtsan.so
  reports tsan
fi
