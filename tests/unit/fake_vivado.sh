#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Stands in for Vivado: keeps the steps' books, makes outputs, fails where CM_FAIL says so.
# CM_CALLS: a file that gets one line per call. CM_FAIL: the step that fails, CM_HANG: that never ends; both after
# the first of its outputs. CM_VERSION: what -version says.
case "$*" in
*-version*)
    echo "Vivado v${CM_VERSION:-2023.2} (64-bit)"
    exit 0
    ;;
esac
while [ $# -gt 0 ]; do
    case "$1" in
    -log) log=$2 ;;
    -source) script=$2 ;;
    esac
    shift
done
[ -e "$script" ] || exit 3
step=${script#tcl/step_}
step=${step%.tcl}
echo "$step" >> "$CM_CALLS"
outputs() {
    awk -v step="$step" '
        /"name":/ { split($0, part, "\""); now = part[4] }
        /"outputs": \[$/ { inside = 1; next }
        /\]/ { inside = 0 }
        inside && now == step { split($0, part, "\""); print part[2] }
    ' steps.json
}
write() {
    while read -r output; do
        mkdir -p "$(dirname "$output")"
        echo "$step" > "$output"
    done
}
if [ "$CM_FAIL" = "$step" ]; then
    outputs | head -n 1 | write
    printf "INFO: begins\nERROR: [Place 30-99] Placer failed with error: 'too small'\nINFO: ends\n" > "$log"
    exit 1
fi
if [ "$CM_HANG" = "$step" ]; then
    outputs | head -n 1 | write
    echo $$ > "$CM_CALLS.pid"
    exec sleep 100
fi
echo "INFO: all is well" > "$log"
outputs | write
