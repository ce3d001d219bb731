#!/bin/sh
# Creates the virtual environment: envs/setup.sh PYTHON FOLDER. Does nothing if it is up to date.
set -eu
python=$1
venv=$2
cd "$(dirname "$0")/.."

digest=$(cat envs/requirements.lock pyproject.toml | sha256sum | cut -d' ' -f1)
stamp=$venv/.slipstitch-setup
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$digest" ]; then
    exit 0
fi

if ! command -v "$python" >/dev/null; then
    echo "make setup: $python not found: install Python 3.11 or set PYTHON=..." >&2
    exit 1
fi
if ! "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'; then
    echo "make setup: $python is not Python 3.11, which bpy requires; set PYTHON=..." >&2
    exit 1
fi

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
# pip compiles modules one by one; here on all cores. Some are for other Pythons: no failure.
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile \
    -r envs/requirements.lock
"$venv/bin/python" -m compileall -q -q -j 0 -x '/tests?/' "$venv/lib" || true
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --no-deps --no-build-isolation -e .

# System libraries for Blender: installed if possible, otherwise listed.
missing() { ldd "$venv"/lib/python3.11/site-packages/bpy/*.so | grep 'not found' || true; }
if [ -n "$(missing)" ]; then
    packages=$(grep -v '^#' envs/system-packages.txt | tr '\n' ' ')
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        # shellcheck disable=SC2086
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
            apt-get install -y -qq --no-install-recommends $packages; } >/dev/null
    fi
    if [ -n "$(missing)" ]; then
        echo "make setup: system libraries for Blender are missing: sudo apt-get install $packages" >&2
        exit 1
    fi
fi
echo "$digest" >"$stamp"
