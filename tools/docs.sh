#!/bin/sh
# Builds the documents, checks every link and executes the notebook.
set -eu

bin=.venv/tools/bin
"$bin/python" -m sphinx --quiet --fail-on-warning --keep-going -d build/doctrees docs build/docs
"$bin/lychee" --offline --include-fragments=full --no-progress 'build/docs/**/*.html'
"$bin/python" -m docs.notebook --check
