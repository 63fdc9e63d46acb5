#!/bin/sh
# Makes the base image that docker/*.Dockerfile name, from Debian's own packages, where it is not to
# be had from a registry.
#
#   tools/base-image.sh STORE
#
# STORE is a folder for images, made when it is missing. Needs root, debootstrap, buildah and
# fuse-overlayfs. Prints the configuration file for CONTAINERS_STORAGE_CONF.
set -eu

store=$1
base=docker.io/library/python:3.11-slim-bookworm

mkdir -p "$store"
store=$(cd "$store" && pwd)
export CONTAINERS_STORAGE_CONF="$store/storage.conf"
cat >"$CONTAINERS_STORAGE_CONF" <<END
[storage]
driver = "overlay"
graphroot = "$store/graph"
runroot = "$store/run"
[storage.options.overlay]
mount_program = "/usr/bin/fuse-overlayfs"
END

if ! buildah inspect --type image "$base" >/dev/null 2>&1; then
    rootfs=$(mktemp -d "$store/rootfs.XXXXXX")
    trap 'rm -rf "$rootfs"' EXIT
    debootstrap --variant=minbase --include=python3,python3-pip,python3-venv,ca-certificates \
        bookworm "$rootfs" >&2
    # As in the image of that name: pip may install, and the interpreter is called python.
    rm -f "$rootfs"/usr/lib/python3*/EXTERNALLY-MANAGED
    ln -s python3 "$rootfs/usr/bin/python"
    rm -rf "$rootfs"/var/cache/apt/archives/*.deb "$rootfs"/var/lib/apt/lists/*
    container=$(buildah from scratch)
    buildah add --quiet "$container" "$rootfs" / >&2
    buildah config --env PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        --cmd python3 "$container" >&2
    buildah commit --quiet --rm "$container" "$base" >&2
fi
echo "$CONTAINERS_STORAGE_CONF"
