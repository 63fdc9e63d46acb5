#!/bin/sh
# Builds an image of docker/ where there is no Docker engine, with buildah.
#
#   tools/image.sh STORE NAME [ARGUMENT...]
#
# builds docker/NAME.Dockerfile as rollcast-NAME:test into STORE, a folder for images; the NAME ray is
# the service's with Ray. ARGUMENTs go to buildah. Needs root and what tools/base-image.sh needs. Prints the configuration file for
# CONTAINERS_STORAGE_CONF.
set -eu

store=$1
name=$2
shift 2
cd "$(dirname "$0")/.."
CONTAINERS_STORAGE_CONF=$(tools/base-image.sh "$store")
export CONTAINERS_STORAGE_CONF
dockerfile=$name
if [ "$name" = ray ]; then
    dockerfile=service
    set -- --build-arg EXTRA=ray "$@"
fi
# What the machine trusts, pip and uv trust inside.
certificates=/etc/ssl/certs/ca-certificates.crt
# Where pip looks for torch, if that is a folder, it looks inside.
if [ -d "${PIP_FIND_LINKS:-}" ]; then
    set -- --volume "$PIP_FIND_LINKS:$PIP_FIND_LINKS:ro" \
        --build-arg "TORCH_INSTALL_ARGS=--find-links $PIP_FIND_LINKS" "$@"
fi
BUILDAH_ISOLATION=chroot buildah build --layers --pull-never --format docker \
    --volume "$certificates:$certificates:ro" --file "docker/$dockerfile.Dockerfile" \
    --tag "rollcast-$name:test" "$@" . >&2
echo "$CONTAINERS_STORAGE_CONF"
