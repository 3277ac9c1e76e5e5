# SPDX-License-Identifier: Apache-2.0
"""Takes the board to a mode: plan, run, and go back when a step fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cm.manager.execution.board import Board, Tools
from cm.manager.execution.rollback import Failure, WayBack
from cm.manager.execution.transaction import Transaction
from cm.manager.planning.plan import Goal, Plan
from cm.manager.planning.planner import make_plan
from cm.manager.ports import Files
from cm.manager.state.cost import Throughput
from cm.schema.model import Config


class ChangeRunner:
    """Runs changes one after the other on the board."""

    def __init__(
        self,
        board: Board,
        tools: Tools,
        files: Files,
        configs: Callable[[], Mapping[str, Config]],
        throughput: Callable[[], Throughput],
    ) -> None:
        self._board = board
        self._throughput = throughput
        self._tools = tools
        self._files = files
        self._configs = configs

    def plan(self, goal: Goal) -> Plan:
        """What going there would do from here. Raises what is wrong with the files."""
        state = self._board.state
        old = self._configs().get(state.config or "")
        return make_plan(goal, state, old, self._files, self._throughput())

    def run(self, goal: Goal, number: int, cancelled: Callable[[], bool]) -> Plan:
        """Go there, or back to where the board was.

        Raises what the plan says is wrong (nothing was touched then), StepFailed (the board went back)
        or UndoFailed (regions stay decoupled).
        """
        before = self._board.state
        plan = self.plan(goal)
        transaction = Transaction(plan, self._board, self._tools, number, cancelled)
        try:
            transaction.run()
        except Exception as error:
            back = WayBack(self._board, self._tools, self.plan, self._configs(), before, number)
            raise back.go(Failure(goal.config, transaction.current, error, transaction.found)) from error
        return plan
