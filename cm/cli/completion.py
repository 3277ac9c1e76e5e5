# SPDX-License-Identifier: Apache-2.0
"""``cm completion bash|zsh|fish``, and what is offered at Tab: argcomplete asks the parser of the command.

For the names of what runs (modes, registers, streams, …) the manager is asked: in silence where none serves, not for
long, and without numpy and the clients.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from cm.cli.commands import CommandMissing, find_command
from cm.cli.parser import RawHelp, build_parser, chosen_command
from cm.errors import CmError, Timeout
from cm.wire.messages.requests import ListConfigs, ReadConfig, Request
from cm.wire.messages.status import ConfigInfo, RegisterInfo

SHELLS = ("bash", "zsh", "fish")
_PATIENCE = 1000  # ms; a prompt that hangs is worse than one that completes nothing
_EPILOG = """to use it, in the shell's own start-up file:
  bash  eval "$(cm completion bash)"
  zsh   eval "$(cm completion zsh)"      (after compinit)
  fish  cm completion fish | source
"""


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Print a completion script for a shell. It asks `cm` itself at Tab,\nso it stays as it is when cm is upgraded."
    )
    parser.epilog = _EPILOG
    parser.formatter_class = RawHelp
    parser.add_argument("shell", choices=SHELLS)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script; the exit status."""
    print(script(args.shell), end="")
    return 0


def script(shell: str) -> str:
    """The script for `shell`, one of `SHELLS`. Raises CommandMissing without argcomplete."""
    try:
        from argcomplete.shell_integration import shellcode
    except ModuleNotFoundError:
        sentence = "completion needs argcomplete: pip install argcomplete, or Debian's python3-argcomplete"
        raise CommandMissing(sentence) from None
    text: str = shellcode(["cm"], shell="bash" if shell == "zsh" else shell)
    if shell == "zsh" and "ZSH_VERSION" not in text:  # argcomplete 2, of Debian 12
        return "autoload -U bashcompinit; bashcompinit\n" + text
    return text


def answer() -> int:
    """Offer what may stand at the place of the line that the shell's script has put into the environment."""
    try:
        import argcomplete
    except ModuleNotFoundError:
        return 1
    line = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])]
    words = line.split()[1:]
    chosen = chosen_command(words if line[-1:].isspace() else words[:-1])
    known = chosen if chosen is not None and find_command(chosen) else None
    try:
        parser = build_parser(known, helps=True)
    except CommandMissing:
        return 1
    argcomplete.autocomplete(parser, always_complete_options=False)  # ends the process
    return 1


# ---- names of what runs ------------------------------------------------------------


def offered(words: Sequence[str], begun: str, args: argparse.Namespace) -> list[str]:
    """What `begun` may become: `words`, where each ``<KIND>`` stands for names of the manager that `args` tell of."""
    try:
        return sorted({name for word in words for name in _offered(word, begun, args)})
    except (CmError, OSError):
        return []


def _offered(word: str, begun: str, args: argparse.Namespace) -> Iterable[str]:
    if not word.startswith("<"):
        return (word,)
    if word in _FAULTS:
        return _FAULTS[word](args)
    if word == "<config>":
        return _told(args, ListConfigs()).names
    name = getattr(args, "config", None) or ""
    if word == "<mode>" and "/" in begun:
        return ()
    if word in ("<config/mode>", "<mode of target>"):
        return _modes(word, begun, args)
    return _KINDS[word](_told(args, ReadConfig(config_name=name if isinstance(name, str) else "")), begun)


def _modes(word: str, begun: str, args: argparse.Namespace) -> Iterator[str]:
    """Modes of the configuration in front of a ``/``, or of the word before."""
    config, slash, _ = begun.partition("/")
    if word == "<mode of target>":
        yield from (mode.name for mode in _told(args, ReadConfig(config_name=args.target)).modes)
    elif slash:
        yield from (f"{config}/{mode.name}" for mode in _told(args, ReadConfig(config_name=config)).modes)


def _told(args: argparse.Namespace, request: Request) -> ConfigInfo:
    """The manager's answer. Raises Timeout soon."""
    import zmq

    from cm.client.connections import prepare
    from cm.client.find_manager import find
    from cm.wire.encode import decode_reply, encode_request

    connect, runtime_dir, keys = (getattr(args, name, None) for name in ("connect", "runtime_dir", "keys"))
    place = find(connect, runtime_dir, keys)
    context = zmq.Context[zmq.Socket[bytes]]()
    try:
        socket = prepare(context.socket(zmq.REQ), place.keys)
        socket.connect(place.endpoints.req)
        socket.send_multipart(encode_request(request))
        if not socket.poll(_PATIENCE):
            raise Timeout("no answer")
        body = decode_reply(socket.recv_multipart()).body
        return body if isinstance(body, ConfigInfo) else ConfigInfo()
    finally:
        context.destroy(linger=0)


def _registers(config: ConfigInfo) -> Iterator[RegisterInfo]:
    return (r for r in config.registers if not r.modes or config.mode in r.modes)


def _register_names(config: ConfigInfo, _: str = "") -> Iterator[str]:
    for register in _registers(config):
        yield register.name
        yield from (f"{register.name}.{field.name}" for field in register.fields)


def _assignments(config: ConfigInfo, begun: str) -> Iterator[str]:
    """``NAME=``, and behind that the names of a field's values."""
    name, equals, _ = begun.partition("=")
    if not equals:
        writable = {r.name for r in _registers(config) if r.access != "ro"}
        return (f"{known}=" for known in _register_names(config) if known.partition(".")[0] in writable)
    fields = {f"{r.name}.{f.name}": f for r in _registers(config) for f in r.fields}
    return (f"{name}={value}" for value, _ in fields[name].values) if name in fields else iter(())


_KINDS: Mapping[str, Callable[[ConfigInfo, str], Iterable[str]]] = {
    "<mode>": lambda config, _: (mode.name for mode in config.modes),
    "<register>": _register_names,
    "<assignment>": _assignments,
    "<memory>": lambda config, _: (m.name for m in config.memories if not m.modes or config.mode in m.modes),
    "<interrupt>": lambda config, _: (interrupt.name for interrupt in config.interrupts),
    "<stream>": lambda config, _: (stream.name for stream in config.streams),
    "<channel>": lambda config, _: (stream.channel for stream in config.streams),
}


def _targets(args: argparse.Namespace) -> Iterable[str]:
    """The targets of a fault, by the first word of the description of its kind."""
    from cm.simulation.software.faults import target_of

    what = target_of(args.name) if args.name else ""
    config = _told(args, ReadConfig(config_name="")) if what else ConfigInfo()
    if what == "overlay":
        return {overlay for mode in config.modes for overlay in mode.overlays}
    known = {"channel": "<channel>", "interrupt": "<interrupt>", "register": "<register>"}
    return _KINDS[known[what]](config, "") if what in known else ()


def _fault_names(_: argparse.Namespace) -> Iterable[str]:
    from cm.simulation.software.faults import KINDS

    return KINDS


_FAULTS: Mapping[str, Callable[[argparse.Namespace], Iterable[str]]] = {
    "<fault>": _fault_names,
    "<target>": _targets,
}
