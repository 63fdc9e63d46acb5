#!/bin/sh
# Tests the client, the service, video and tracking with the lowest versions that pyproject.toml allows.
#
#   tools/lowest.sh [ARGUMENT OF pytest...]
#
# They are installed into build/lowest. What tests with is newer than what is tested, and changes none
# of its versions.
set -eu

cd "$(dirname "$0")/.."
tools/environment.sh uv
uv=.venv/uv/bin/uv
python=${PYTHON:-python3.11}
index=${UV_DEFAULT_INDEX:-$(.venv/uv/bin/python -m pip config get global.index-url 2>/dev/null || true)}
export UV_SYSTEM_CERTS=1 UV_NO_PROGRESS=1
mkdir -p build
"$uv" pip compile --quiet --resolution lowest-direct --python "$python" --output-file build/lowest.txt \
    ${index:+--default-index "$index"} \
    --extra dataframe --extra datasets --extra service --extra simulation --extra track pyproject.toml
"$uv" venv --quiet --no-project --clear --python "$python" build/lowest
"$uv" pip install --quiet --python build/lowest/bin/python ${index:+--default-index "$index"} \
    --requirements build/lowest.txt --constraints build/lowest.txt \
    beartype hypothesis inline-snapshot markdown-it-py psutil pytest pyyaml ruff schemathesis unasync
[ $# -gt 0 ] || set -- tests/contract tests/service tests/rollcast --ignore=tests/rollcast/simulation
exec build/lowest/bin/python -m pytest -q "$@"
