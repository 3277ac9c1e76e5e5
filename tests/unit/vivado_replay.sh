#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Vivado's command line in front of the replay (tests/tcl). CM_REPLAY: its folder, CM_KNOWN: the known commands,
# CM_SEEN: a file that gets a line for each script, with the folder that it ran in.
case "$*" in
*-version*)
    echo "Vivado v2023.2 (64-bit)"
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
echo "$PWD $script" >> "$CM_SEEN"
exec tclsh "$CM_REPLAY/replay.tcl" "$CM_KNOWN" "$CM_SEEN.record" "$script" > "$log" 2>&1
