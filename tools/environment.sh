#!/bin/sh
# Makes the virtual environment .venv/NAME hold exactly requirements/NAME.txt.
#
#   tools/environment.sh NAME [--torch]
#
# Does nothing when the environment is up to date. PYTHON names the interpreter to use, and
# TORCH_INSTALL_ARGS may give pip further arguments for torch (an index with the wanted build).
set -eu

name=$1
with_torch=${2:-}
cd "$(dirname "$0")/.."
lock=requirements/$name.txt
environment=.venv/$name
key_file=$environment/.made-from
log=.venv/$name.log

fail() {
    printf 'rollcast: %s\n' "$*" >&2
    exit 1
}

is_new_enough() {
    command -v "$1" >/dev/null 2>&1 &&
        "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

find_python() {
    if [ -n "${PYTHON:-}" ]; then
        is_new_enough "$PYTHON" && return
        fail "Python 3.11 or newer is needed; PYTHON=$PYTHON is $(version_of "$PYTHON")."
    fi
    for PYTHON in python3.11 python3; do
        is_new_enough "$PYTHON" && return
    done
    fail "Python 3.11 or newer is needed; python3 is $(version_of python3)." \
        "Name another one: make PYTHON=/path/to/python3.11 ..."
}

version_of() {
    command -v "$1" >/dev/null 2>&1 || { echo "not there"; return; }
    "$1" --version 2>&1 | head -n 1
}

run_logged() {
    "$@" >>"$log" 2>&1 || {
        tail -n 20 "$log" >&2
        fail "could not make $environment; the lines above are the end of $log."
    }
}

find_python
[ -f "$lock" ] || fail "$lock is missing; make lock compiles it."

key=$(
    {
        "$PYTHON" -c 'import sys; print(sys.version_info[:2], sys.base_prefix)'
        pwd
        cat "$lock"
        [ -z "$with_torch" ] || cat requirements/constraints-torch.txt
    } | "$PYTHON" -c 'import hashlib, sys; print(hashlib.sha256(sys.stdin.buffer.read()).hexdigest())'
)

mkdir -p .venv
if command -v flock >/dev/null 2>&1; then
    exec 9>".venv/$name.lock"
    flock 9 # a second make in the same checkout waits here
fi

if [ -x "$environment/bin/python" ] && [ "$(cat "$key_file" 2>/dev/null)" = "$key" ]; then
    exit 0
fi

"$PYTHON" -c 'import ensurepip, venv' 2>/dev/null ||
    fail "$PYTHON cannot make virtual environments; on Debian: apt-get install python3-venv"

"$PYTHON" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || printf '%s\n' \
    "rollcast: $PYTHON is not 3.11, so PyBullet has to be compiled: this needs g++ and many minutes."
printf 'rollcast: making %s, once, in one to five minutes (log: %s) ...\n' "$environment" "$log"
started=$(date +%s)
rm -rf "$environment"
: >"$log"
run_logged "$PYTHON" -m venv "$environment"
export PIP_DISABLE_PIP_VERSION_CHECK=1
run_logged "$environment/bin/python" -m pip install --no-input --require-hashes -r "$lock"
if [ -n "$with_torch" ]; then
    # shellcheck disable=SC2086 # several arguments are meant to be several
    run_logged "$environment/bin/python" -m pip install --no-input \
        -c requirements/constraints-torch.txt ${TORCH_INSTALL_ARGS:-} torch
fi
run_logged "$environment/bin/python" -m pip check
printf '%s\n' "$key" >"$key_file"
printf 'rollcast: %s is ready after %d s (%s)\n' \
    "$environment" "$(($(date +%s) - started))" "$(du -sh "$environment" | cut -f 1)"
