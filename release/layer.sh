#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# The source archive into the layer, which fetches nothing, and the layer with it into build/release.
#
#   release/layer.sh PYTHON
set -eu
cd "$(dirname "$0")/.."
python=$1
files=yocto/meta-cm/recipes-cm/fpga-cm/files
version=$("$python" -c 'from cm._version import __version__; print(__version__)')
: "${SOURCE_DATE_EPOCH:=$(git log -1 --format=%ct 2>/dev/null || echo 1577836800)}"
export SOURCE_DATE_EPOCH

rm -f "$files"/fpga_cm-*.tar.gz
log=$(mktemp)
trap 'rm -f "$log"' EXIT
PYTHONPATH=release "$python" -c "import backend; backend.build_sdist('$files')" >"$log" 2>&1 || {
	cat "$log"
	exit 1
}
mkdir -p build/release
tar -C yocto --sort=name --mtime="@$SOURCE_DATE_EPOCH" --owner=0 --group=0 --numeric-owner --mode=u+w,go-w,a+rX \
	-cf - meta-cm | gzip -9n >"build/release/meta-cm-$version.tar.gz"
echo "$files/fpga_cm-$version.tar.gz"
echo "build/release/meta-cm-$version.tar.gz"
