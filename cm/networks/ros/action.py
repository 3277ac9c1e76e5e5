# SPDX-License-Identifier: Apache-2.0
"""The action ChangeMode: the manager carries out goals one after the other, with progress and cancelling."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Iterable
from typing import Any

from cm.errors import Busy, CmError
from cm.networks.bridge.commands import Commands
from cm.networks.bridge.records import Caller
from cm.networks.ros import messages
from cm.networks.ros.services import Waiting, refusal
from cm.networks.ros.transport import EVENTS, LATCHED, Publisher, Transport, Values
from cm.wire.messages.status import Progress

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 1, 2, 3, 4, 5, 6  # action_msgs/msg/GoalStatus
_NONE, _REJECTED, _UNKNOWN, _TERMINATED = 0, 1, 2, 3  # action_msgs/srv/CancelGoal
_RUNNING = (ACCEPTED, EXECUTING, CANCELING)
_KEPT = 50  # goals whose results are kept
_AT_ONCE = 32  # goals that are not at their end; more are not accepted
_TYPE = "cm_interfaces/action/ChangeMode"


class _Goal:
    def __init__(self, uuid: bytes, wanted: Values) -> None:
        self.uuid = uuid
        self.wanted = wanted
        self.stamp_ns = time.time_ns()
        self.status = ACCEPTED
        self.result: Values = {}
        self.ended = threading.Event()

    @property
    def info(self) -> Values:
        return {"goal_id": {"uuid": self.uuid}, "stamp": messages.time(self.stamp_ns)}


class ChangeModeServer:
    """Serves the action at `name`."""

    def __init__(self, transport: Transport, name: str, commands: Commands, waiting: Waiting, guest: str = "") -> None:
        self._commands = commands
        self._waiting = waiting
        self._guest = guest
        self._goals: OrderedDict[bytes, _Goal] = OrderedDict()
        self._lock = threading.RLock()
        base = f"{name}/_action"
        self._feedback: Publisher = transport.publisher(f"{base}/feedback", f"{_TYPE}_FeedbackMessage", EVENTS)
        self._status: Publisher = transport.publisher(f"{base}/status", "action_msgs/msg/GoalStatusArray", LATCHED)
        transport.service(f"{base}/send_goal", f"{_TYPE}_SendGoal", self._send_goal)
        transport.service(f"{base}/get_result", f"{_TYPE}_GetResult", self._get_result)
        transport.service(f"{base}/cancel_goal", "action_msgs/srv/CancelGoal", self._cancel)

    def _send_goal(self, request: dict[str, Any]) -> Values:
        goal = _Goal(bytes(request["goal_id"]["uuid"]), request["goal"])
        with self._lock:
            if goal.uuid in self._goals or len(self._running(self._goals.values())) >= _AT_ONCE:
                return {"accepted": False, "stamp": messages.time(goal.stamp_ns)}
            self._goals[goal.uuid] = goal
            for uuid in [uuid for uuid, kept in self._goals.items() if kept.status not in _RUNNING][:-_KEPT]:
                del self._goals[uuid]
        threading.Thread(target=self._run, args=(goal,), daemon=True, name="change of mode").start()
        return {"accepted": True, "stamp": messages.time(goal.stamp_ns)}

    def _get_result(self, request: dict[str, Any]) -> Values:
        goal = self._goals.get(bytes(request["goal_id"]["uuid"]))
        if goal is None:
            return {"status": 0, "result": refusal("not_found", "there is no such goal")}
        try:
            with self._waiting.one():
                goal.ended.wait()
        except Busy as error:
            if not goal.ended.is_set():
                return {"status": goal.status, "result": refusal(error.code, str(error))}
        return {"status": goal.status, "result": goal.result}

    @staticmethod
    def _running(goals: Iterable[_Goal]) -> list[_Goal]:
        return [goal for goal in goals if goal.status in _RUNNING]

    def _cancel(self, request: dict[str, Any]) -> Values:
        """No id and no time: all goals; a time: all that were accepted until then; an id: that one (CancelGoal.srv)."""
        info = request["goal_info"]
        uuid, until = bytes(info["goal_id"]["uuid"]), info["stamp"]["sec"] * 10**9 + info["stamp"]["nanosec"]
        with self._lock:
            every = not any(uuid) and not until
            meant = [g for g in self._goals.values() if every or g.uuid == uuid or (until and g.stamp_ns <= until)]
            if any(uuid) and uuid not in self._goals:
                return {"return_code": _UNKNOWN}
            running = self._running(meant)
            if meant and not running:
                return {"return_code": _TERMINATED}
        try:
            if running:
                self._commands.cancel(Caller(self._guest))
        except CmError:  # past its last load, or not this client's
            return {"return_code": _REJECTED}
        for goal in running:
            self._turn(goal, CANCELING)
        return {"return_code": _NONE, "goals_canceling": [goal.info for goal in running]}

    def _run(self, goal: _Goal) -> None:
        self._turn(goal, EXECUTING)
        wanted = goal.wanted
        try:
            seconds = self._commands.change(
                Caller(self._guest, wanted["lease"]), wanted["config_name"], wanted["mode"], force=wanted["force"],
                progress=lambda at: self._tell(goal, at),
            )  # fmt: skip
            goal.result, end = {"success": True, "seconds": seconds}, SUCCEEDED
        except CmError as error:
            goal.result = refusal(error.code, str(error))
            end = CANCELED if goal.status == CANCELING else ABORTED
        self._turn(goal, end)
        goal.ended.set()

    def _tell(self, goal: _Goal, at: Progress) -> None:
        told = {"step": at.step, "subject": at.subject, "bytes_done": at.bytes_done, "bytes_total": at.bytes_total}
        self._feedback.write({"goal_id": {"uuid": goal.uuid}, "feedback": {**told, "fraction": at.fraction}})

    def _turn(self, goal: _Goal, status: int) -> None:
        with self._lock:
            if goal.status in _RUNNING:  # a goal that has ended keeps its state
                goal.status = status
            rows = [{"goal_info": g.info, "status": g.status} for g in self._goals.values()]
            self._status.write({"status_list": rows})
