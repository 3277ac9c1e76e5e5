#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: `systemd-analyze verify` ends with an error for a unit with a misspelt setting, so a build may ask its status.
# Seen: settings and sections that do not exist, and values that cannot be read, are passed over with a warning and
# status 0: a misspelt limit is none. Only a program that is missing is an error.
. "$(dirname "$0")/setup"
debian systemd libsystemd-shared
export LD_LIBRARY_PATH="$LD_LIBRARY_PATH:$(find "$folder/root" -type d -path '*/systemd' | paste -s -d:)"
unit() {
	printf '[Unit]\nDescription=a daemon\n[Service]\nExecStart=%s\n%s\n' "$1" "$2" >unit.service
	status=0
	SYSTEMD_UNIT_PATH="$folder:" "$folder/root/usr/bin/systemd-analyze" verify --man=no ./unit.service >said 2>&1 || status=$?
	echo "$status: $(sed -n 's/^[^ ]*unit.service:[0-9: ]*//p' said | paste -s -d,)"
}
misspelt=$(unit /bin/true 'MemoryMx=64M')
section=$(unit /bin/true '[Servic]')
value=$(unit /bin/true 'UMask=9999')
missing=$(unit /nowhere/program '')
python3 - "$misspelt" "$section" "$value" "$missing" <<'END'
import sys
from saw import saw
saw("a misspelt limit", sys.argv[1], "0: Unknown key 'MemoryMx' in section [Service], ignoring.")
saw("a misspelt section", sys.argv[2], "0: Unknown section 'Servic'. Ignoring.")
saw("a mask that is none", sys.argv[3], "0: Failed to parse mode value, ignoring: 9999")
saw("a program that is missing", sys.argv[4], "1: Command /nowhere/program is not executable: No such file or directory")
END
