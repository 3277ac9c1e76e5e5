#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# An example of RAUC's install handler: a bundle that carries configurations, archives of `cm build collect`, beside or
# instead of slot images.  All of them are imported, or those that were are rolled back and the update has failed.
#
#   [handler]
#   filename=cm-configs.sh
#   [image.cm]                     # an image of class cm that holds the archives, or lay them beside the manifest
#
# RAUC sets RAUC_BUNDLE_MOUNT_POINT.  CM_CONFIGS, CM_RELOAD and CM are for tests.
set -eu
: "${CM_CONFIGS:=/lib/firmware/cm}" "${CM_RELOAD:=systemctl reload cm}" "${CM:=cm}"

done_so_far=
undo() {
	for config in $done_so_far; do
		if ! $CM config rollback "$config" --out "$CM_CONFIGS"; then
			echo "cm: configuration $config had no earlier version; it stays as it was imported" >&2
		fi
	done
}

for archive in "$RAUC_BUNDLE_MOUNT_POINT"/*.tar.gz; do
	if ! answer=$($CM import archive "$archive" --out "$CM_CONFIGS"); then
		undo
		exit 1
	fi
	echo "$answer"
	folder=${answer%%: *}
	done_so_far="$(basename "$folder") $done_so_far"
done
$CM_RELOAD
