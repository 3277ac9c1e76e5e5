# SPDX-License-Identifier: Apache-2.0
"""``ros2 run cm_ros2 board``: the lifecycle node of a board."""

from __future__ import annotations

import threading
from typing import Any

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, InvalidHandle, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn

from cm.client.board import Board, connect
from cm.networks.bridge.commands import Commands, writes_named
from cm.networks.bridge.follower import Follower
from cm.networks.ros.node import BoardNode, NodeName
from cm.networks.ros.transport import FRAMES, RELIABLE_FRAMES
from cm_ros2.transport import RclpyTransport

_THREADS = 12
_WAITING = 8  # of them that may wait for changes of mode


class BoardLifecycle(LifecycleNode):
    """Configured it has its topics and services; active it follows the manager, and waits for one that is gone.

    The parameter services are the board's: registers as parameters. Its own parameters come with the launch.
    """

    def __init__(self, **arguments: Any) -> None:
        super().__init__("cm", start_parameter_services=False, **arguments)
        self.declare_parameter("connect", "")
        self.declare_parameter("keys", "")
        self.declare_parameter("guest", "")
        self.declare_parameter("write", "")
        self.declare_parameter("reliable", False)
        self.declare_parameter("autostart", True)
        self._transport: RclpyTransport | None = None
        self._board: BoardNode | None = None
        self._commands: Commands | None = None
        self._following: tuple[Follower, threading.Thread] | None = None
        self._timer: Any = None

    def text(self, name: str) -> str:
        """A parameter's text."""
        return str(self.get_parameter(name).value or "")

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Topics and services."""
        self._transport = RclpyTransport(self)
        self._commands = Commands(self._connected, writes_named(self.text("write")))
        name = NodeName(self.get_name(), self.get_namespace())
        guest = self.text("guest")
        frames = RELIABLE_FRAMES if self.get_parameter("reliable").value else FRAMES
        self._board = BoardNode(self._transport, name, self._commands, guest, frames, _WAITING)
        return super().on_configure(state)

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        """Follow the manager."""
        assert self._board is not None
        follower = Follower(self._connected, self._board)
        thread = threading.Thread(target=follower.run, name="follower", daemon=True)
        self._following = (follower, thread)
        thread.start()
        self._timer = self.create_timer(self._board.look(), self._board.look)
        return super().on_activate(state)

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        """Follow no more; streams end."""
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: State) -> TransitionCallbackReturn:
        """No topics, no services."""
        self._close()
        return super().on_cleanup(state)

    def on_shutdown(self, state: State) -> TransitionCallbackReturn:
        """All of it."""
        self._stop()
        self._close()
        return super().on_shutdown(state)

    def end(self) -> None:
        """As at shutdown, when the process ends."""
        self._stop()
        self._close()

    def _connected(self, guest: str = "") -> Board:
        return connect(self.text("connect") or None, keys=self.text("keys") or None, guest=guest)

    def _stop(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        following, self._following = self._following, None
        if following is not None:
            following[0].stop()
            following[1].join()

    def _close(self) -> None:
        if self._board is not None and self._transport is not None and self._commands is not None:
            self._commands.close()  # first: it frees the executor's threads that wait for the manager
            self._board.close()
            self._transport.close()
        self._board = self._transport = self._commands = None


def spin(executor: Executor) -> None:
    """Until shutdown. Streams come and go in another thread; what rclpy was about to wait for may be gone by then."""
    while True:
        try:
            executor.spin()
        except InvalidHandle:
            continue
        return


def main(arguments: list[str] | None = None) -> None:
    """Run the node until it is interrupted."""
    rclpy.init(args=arguments)
    node = BoardLifecycle()
    executor = MultiThreadedExecutor(_THREADS)
    executor.add_node(node)
    try:
        if node.get_parameter("autostart").value:
            node.trigger_configure()
            node.trigger_activate()
        spin(executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.end()
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
