# SPDX-License-Identifier: Apache-2.0
# Runs the tests and sends what they say: lines to the port cm.output, an archive to the port cm.results.
. "$here/results.sh"
mkdir -p /tmp/results
echo "booted=$(cut -d ' ' -f 1 /proc/uptime)" >/tmp/results/facts
cd /opt/cm/tests || exit
# What is given a time in the tests gets it times the slowness of this board: a step, a test, silence.
slow=${CM_VM_SLOW:-1}
export CM_TEST_PATIENCE=$((10 * slow))
export CM_VM_LOAD_US=$((20000 * slow)) # of a bitstream through the simulated port
CM_VM_QUIET=$((20 * slow))
# Debian 13's protobuf makes its types in a way that its Python warns of, and aborts where that is an error
python3 -c 'import sys; sys.exit(sys.version_info < (3, 12))' && warnings="-W ignore::DeprecationWarning"
. "$here/board.sh"
. "$here/watchdog.sh"
: >/tmp/output
{
	board_up
	slow_port
	COLUMNS=160 PYTHONPATH="$here:$PYTHONPATH" python3 -m pytest -p no:cacheprovider -p boardfile -p tell \
		-c /opt/cm/guest/pytest.ini --rootdir /opt/cm/tests -v --tb=short --timeout=$((100 * slow)) -o faulthandler_timeout=$((80 * slow)) \
		$warnings --no-summary --durations=8 \
		${CM_VM_KEYWORD:+-k "$(echo "$CM_VM_KEYWORD" | tr + ' ')"} \
		--board=vm --board-file=/tmp/board.json --junit-xml=/tmp/results/cases.xml $(echo "${CM_VM_CASES:-vm/cases+device}" | tr + ' ')
	echo "status=$?" >>/tmp/results/facts
} >/tmp/output 2>&1 &
tests=$!
tail -f /tmp/output >"$(port cm.output)" &
follower=$!
watchdog /tmp/output &
watcher=$!
wait $tests
sleep 1
kill $watcher $follower
echo "kernel=$(uname -r) $(uname -m)" >>/tmp/results/facts
echo "tested=$(cut -d ' ' -f 1 /proc/uptime)" >>/tmp/results/facts
scan_for_leaks
send_results
