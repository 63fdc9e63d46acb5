#!/bin/sh
# Builds the wheels of the package and of the models into a folder.
#
#   tools/wheels.sh [FOLDER]     default: build/wheels
#
# They are built from copies, since a build leaves files beside its sources.
set -eu
cd "$(dirname "$0")/.."
to=${1:-build/wheels}
mkdir -p "$to"
to=$(cd "$to" && pwd)
sources=$(mktemp -d)
trap 'rm -rf "$sources"' EXIT
mkdir "$sources/rollcast" "$sources/models"
cp -r LICENSE README.md pyproject.toml rollcast service "$sources/rollcast"
cp -r models/. LICENSE "$sources/models"
for one in rollcast models; do
    .venv/uv/bin/uv build --quiet --wheel --out-dir "$to" "$sources/$one"
done
