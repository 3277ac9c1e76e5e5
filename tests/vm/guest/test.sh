# SPDX-License-Identifier: Apache-2.0
# Runs the tests and sends what they say: lines to the port cm.output, an archive to the port cm.results.
. "$here/results.sh"
mkdir -p /tmp/results
echo "booted=$(cut -d ' ' -f 1 /proc/uptime)" >/tmp/results/facts
cd /opt/cm/tests || exit
. "$here/board.sh"
. "$here/watchdog.sh"
: >/tmp/output
{
	board_up
	slow_port
	PYTHONPATH="$here:$PYTHONPATH" python3 -m pytest -p no:cacheprovider -p boardfile \
		-c /opt/cm/guest/pytest.ini --rootdir /opt/cm/tests -v -rs --tb=short --durations=8 \
		${CM_VM_KEYWORD:+-k "$(echo "$CM_VM_KEYWORD" | tr + ' ')"} \
		--board=vm --board-file=/tmp/board.json --junit-xml=/tmp/results/cases.xml vm/cases device
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
