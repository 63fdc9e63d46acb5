#!/bin/sh
# Creates or updates the virtual environment .venv/NAME from uv.lock.
#
#   tools/environment.sh NAME
#
# NAME is one of the environments in the case statement below, or "uv" for uv alone. The script does
# nothing when the environment is up to date. Environment variables:
#
#   PYTHON              interpreter; default: python3.11, otherwise python3
#   PYTHON_3_13         required: fail if there is no Python 3.13 for service-3.13
#   SIMULATION          auto: install the service without PyBullet where PyBullet has no wheel
#   TORCH_INSTALL_ARGS  additional pip arguments for torch, such as the index of the CPU builds
#
# uv installs every package except torch. The CPU build of torch and the CUDA build have the same
# version, and the files in uv.lock are those of the CUDA build (3 GB). pip installs torch instead:
# its configuration or TORCH_INSTALL_ARGS leads to the CPU build. uv does not read pip's configuration.
set -eu

name=$1
cd "$(dirname "$0")/.."
environment=.venv/$name
key_file=$environment/.made-from
log=.venv/$name.log
uv=.venv/uv/bin/uv
torch=

say() { printf 'rollcast: %s\n' "$*"; }

fail() {
    say "$@" >&2
    exit 1
}

version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || echo none; }

is_supported() {
    version=$(version_of "$1")
    case $version in 3.11 | 3.12 | 3.13 | 3.14) ;; *) return 1 ;; esac
}

find_python() {
    if [ -n "${PYTHON:-}" ]; then
        is_supported "$PYTHON" && return
        fail "Python 3.11 to 3.14 is needed; PYTHON=$PYTHON is $version."
    fi
    for PYTHON in python3.11 python3; do
        is_supported "$PYTHON" && return
    done
    fail "Python 3.11 to 3.14 is needed; python3 is $version." \
        "Name another one: make PYTHON=/path/to/python3.11 ..."
}

# Python 3.13 from the path, from pyenv, or downloaded by uv.
find_python_3_13() {
    for PYTHON in python3.13 "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.13.*/bin/python3.13; do
        version=$(version_of "$PYTHON")
        [ "$version" = 3.13 ] && return
    done
    version=3.13
    "$uv" python install --quiet --no-bin 3.13 2>/dev/null &&
        PYTHON=$("$uv" python find --no-project --system 3.13) && return
    [ "${PYTHON_3_13:-}" != required ] ||
        fail "Python 3.13 is not installed and cannot be downloaded, and PYTHON_3_13=required"
    say "Python 3.13 is not installed and cannot be downloaded; its tests are skipped"
    exit 0
}

run_logged() {
    "$@" >>"$log" 2>&1 || {
        tail -n 20 "$log" >&2
        fail "could not create $environment; the lines above are the end of $log."
    }
}

# Allows one installation at a time in a checkout.
lock_folder() {
    mkdir -p .venv
    if command -v flock >/dev/null 2>&1; then
        exec 9>.venv/.lock
        flock 9
    fi
}

install_uv() {
    cmp -s tools/uv.txt .venv/uv/.made-from && return
    "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null ||
        fail "$PYTHON cannot make virtual environments; on Debian: apt-get install python3-venv"
    rm -rf .venv/uv
    run_logged "$PYTHON" -m venv .venv/uv
    run_logged .venv/uv/bin/python -m pip install --no-input --require-hashes -r tools/uv.txt
    cp tools/uv.txt .venv/uv/.made-from
}

# Prints the index that uv or pip is configured with, if it is not the public one of uv.lock.
configured_index() {
    printf '%s' "${UV_DEFAULT_INDEX:-${UV_INDEX_URL:-${PIP_INDEX_URL:-$(
        .venv/uv/bin/python -m pip config get global.index-url 2>/dev/null
    )}}}"
}

# install_locked OPTION...: installs the selected extras and groups, checks hashes, and removes every
# other package. The addresses in uv.lock are the public index's, so another index needs an export.
install_locked() {
    index=$(configured_index)
    if [ -z "$index" ]; then
        UV_PROJECT_ENVIRONMENT=$environment run_logged "$uv" sync --frozen --no-install-project \
            --no-install-package torch --python "$PYTHON" "$@"
        return
    fi
    run_logged "$uv" export --frozen --quiet --no-emit-project --no-emit-package torch \
        --output-file "$environment.txt" "$@"
    run_logged "$uv" venv --no-project --clear --python "$PYTHON" "$environment"
    run_logged "$uv" pip sync --python "$environment/bin/python" --require-hashes \
        --default-index "$index" "$environment.txt"
}

install_torch() {
    # shellcheck disable=SC2086 # several arguments are meant to be several
    run_logged .venv/uv/bin/python -m pip --python "$environment/bin/python" install --no-input \
        --no-deps ${TORCH_INSTALL_ARGS:-} "$(grep -o 'torch==[0-9.]*' pyproject.toml)"
}

export PIP_DISABLE_PIP_VERSION_CHECK=1 UV_NO_PROGRESS=1 UV_SYSTEM_CERTS=1
lock_folder
log=.venv/uv.log
: >"$log"
find_python
install_uv
[ "$name" != uv ] || exit 0
log=.venv/$name.log

case $name in
service) # the server process
    set -- --extra service
    [ "${SIMULATION:-}" = auto ] && [ "$version" != 3.11 ] || set -- "$@" --extra simulation
    ;;
service-3.13) # the server process on a Python without a PyBullet wheel
    find_python_3_13
    set -- --extra service
    ;;
service-test) # tests that must pass without torch
    set -- --extra service --extra simulation --group test
    ;;
test) # all other tests, lint, training
    set -- --extra dataframe --extra ray --extra ray-training --extra service --extra training \
        --group bench --group lint --group test
    torch=yes
    ;;
peers) # clients and serving frameworks of other projects
    set -- --group peers
    ;;
tools) # benchmarks, documentation, browser and image tests, fuzzing, SBOM
    set -- --extra dataframe --extra service --extra simulation --extra video \
        --group bench --group browser --group docs --group fuzz --group image --group mutation \
        --group supply --group test
    ;;
*)
    fail "unknown environment $name; expected service, service-3.13, service-test, test, peers or" \
        "tools"
    ;;
esac

key=$(
    {
        "$PYTHON" -c 'import sys; print(sys.version_info[:2], sys.base_prefix)'
        pwd
        printf '%s\n' "$*"
        cat uv.lock
    } | "$PYTHON" -c 'import hashlib, sys; print(hashlib.sha256(sys.stdin.buffer.read()).hexdigest())'
)
if [ -x "$environment/bin/python" ] && [ "$(cat "$key_file" 2>/dev/null)" = "$key" ]; then
    exit 0
fi

case "$version $*" in
3.11* | *"--group peers"*) ;;
*simulation* | *training*)
    say "PyBullet has no wheel for Python $version and is compiled, which requires g++ and many minutes."
    ;;
*)
    say "PyBullet has no wheel for Python $version and is not installed in $environment: the service" \
        "forecasts but does not simulate. SIMULATION=yes compiles it, which requires g++."
    ;;
esac
say "creating $environment, which takes about a minute (log: $log) ..."
started=$(date +%s)
: >"$log"
rm -f "$key_file"
install_locked "$@"
[ -z "$torch" ] || install_torch
run_logged "$uv" pip check --python "$environment/bin/python"
printf '%s\n' "$key" >"$key_file"
say "$environment is ready after $(($(date +%s) - started)) s" \
    "($(du -sh "$environment" | cut -f 1))"
