# SPDX-License-Identifier: Apache-2.0
# The board for tests from the host: as for a shell, but the log goes to the port cm.output, and the host ends it.
. "$here/shell.sh"
. "$here/results.sh"
until grep -q 'ready at' /run/cm.log; do
	kill -0 $! || break
	usleep 100000
done
cat /run/cm.log >"$(port cm.output)"
wait $!
