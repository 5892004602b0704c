#!/usr/bin/env bash
# usage: try_wheel.sh PYTHON WHEEL   installs a wheel into a new virtual environment, with no compiler on the path, and renders the demo.
set -euo pipefail
wheel=$(realpath "$2")
folder=$(mktemp -d)
trap "$(command -v rm) -rf '$folder'" EXIT
"$1" -m venv "$folder/venv"
mkdir "$folder/empty" "$folder/work"
cd "$folder/work"
unset PYTHONPATH CC CXX GLOBULE_SIMD
export PATH="$folder/venv/bin:$folder/empty"
start=$EPOCHREALTIME
pip install -q --disable-pip-version-check --only-binary :all: "$wheel"
for tool in c++ g++ cc gcc clang nvcc; do
  if type "$tool" > /dev/null 2>&1; then echo "expected no compiler on the path, got $tool"; exit 1; fi
done
globule --version
globule demo
python - << 'PY'
import globule, numpy, PIL.Image
image = numpy.asarray(PIL.Image.open("demo/splash.png"))
assert image.std() > 20, "expected a picture"
PY
end=$EPOCHREALTIME
python -c "print(f'installed and drawn in {$end - $start:.1f} s')"
