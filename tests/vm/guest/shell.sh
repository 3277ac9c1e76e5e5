# SPDX-License-Identifier: Apache-2.0
# The board for looking at: the manager runs and listens, a shell is on the console.
. "$here/board.sh"
board_up
PYTHONPATH="$here:$PYTHONPATH" python3 -c 'import boardfile; boardfile.write_bitstreams()'
system=/run/camera.yaml
if [ -d "$overlays/static" ]; then cp "$here/system/camera.yaml" "$system"; else sed '/overlays:/d' "$here/system/camera.yaml" >"$system"; fi
printf '#!/bin/sh\nexec python3 -m cm.cli.main "$@"\n' >/usr/bin/cm
chmod +x /usr/bin/cm
# The ports reach only the user's own machine: QEMU forwards them from its loopback.
cm serve --config "$system" --load camera --assume-loaded --listen tcp://0.0.0.0:5560 --insecure >/run/cm.log 2>&1 &
[ "$CM_VM_ACTION" = serve ] && return
cat <<TEXT

The configuration manager is starting (log: /run/cm.log). Try: cm status, cm mode edge_detection, cm reg list.
From the host: cm --help, or cm.connect("tcp://localhost:<first port>"). Ctrl-A X ends the board.

TEXT
export PS1='board:\w# '
cd /root
setsid cttyhack sh -l
