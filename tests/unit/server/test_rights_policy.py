# SPDX-License-Identifier: Apache-2.0
"""The policy by itself: identities, the rights that they have, and the rights that each request needs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.errors import Forbidden, InvalidRequest
from cm.manager.execution.worker import Change
from cm.manager.planner import target
from cm.manager.touched import Scene, resolved
from cm.schema import load_folder
from cm.server.requests import BY_KIND
from cm.server.rights.admission import Gate
from cm.server.rights.keys import authorized, pairs_of
from cm.server.rights.model import Access, AuthorizedKey, Grant, Need, Rights, Role
from cm.server.rights.policy import Users, rights_of, system_users
from cm.server.rights.principal import NOBODY, Principal, from_id, guest_of, introduced, of_process, on_behalf
from cm.server.rights.required_rights import OPENING, Right, needs_of, provisioning
from cm.wire import plane_packets as packets
from cm.wire.messages import requests as rq
from cm.wire.plane_packets import Open, Purpose

ROOT = Path(__file__).resolve().parents[3]
KEY, OTHER = "k" * 40, "o" * 40
CAMERA = load_folder(ROOT / "cm/data/camera")["camera"]
NAMES = {1000: "anna", 1001: "ben"}
USERS = Users(lambda uid: NAMES.get(uid, ""), lambda uid, _: ("lab",) if uid == 1001 else (), 500)
SCENE = Scene(CAMERA, "edge_detection", lambda r: target(r, {"camera": CAMERA}, "camera"), {})
EMPTY = Scene(None, None, lambda r: target(r, {"camera": CAMERA}, None), {})

names = st.sampled_from(["focus", "zoom", "threshold", "camera", "prr0", "*", "static"])
maybe = st.none() | names
roles = st.sampled_from([role for role in Role if role])
needs = st.builds(Need, roles, st.sampled_from(["cm_status", "cm_write_reg"]), maybe, maybe, maybe, maybe)
patterns = st.lists(st.sampled_from(["*", "f*", "zoom", "prr?", "cm_*", "static"]), min_size=1, max_size=2).map(tuple)
grants = st.builds(Grant, roles, patterns, patterns, patterns, patterns, patterns)


def user(uid: int) -> Principal:
    return of_process("ipc", uid, uid, 77)


def rights(who: Principal, **said: Any) -> Rights:
    return rights_of(who, Access(**said), USERS)


# ---- identities --------------------------------------------------------------------------


def test_over_ipc_the_kernel_says_who_the_client_is() -> None:
    who = introduced("ipc", "localhost:1000:1001:77", "NULL", "")
    assert (who.uid, who.gid, who.pid, who.account) == (1000, 1001, 77, "uid:1000")
    assert from_id(who.id) == who


@pytest.mark.parametrize(
    ("domain", "address", "mechanism", "key"),
    [
        ("ipc", "", "NULL", ""),
        ("ipc", "localhost", "NULL", ""),
        ("ipc", "1:2", "NULL", ""),
        ("ipc", "localhost:-1:2:3", "NULL", ""),
        ("ipc", "localhost:1:2:3", "PLAIN", ""),
        ("curve", "127.0.0.1", "NULL", ""),
        ("curve", "127.0.0.1", "CURVE", ""),
        ("tcp", "127.0.0.1", "PLAIN", ""),
        ("", "127.0.0.1", "NULL", ""),
    ],
)
def test_a_client_that_is_not_introduced_has_no_identity_and_may_do_nothing(
    domain: str, address: str, mechanism: str, key: str
) -> None:
    assert introduced(domain, address, mechanism, key) == NOBODY
    assert Gate(Access(), USERS).enter(domain, address, mechanism, key) is None


def test_an_address_over_tcp_is_never_taken_for_a_process() -> None:
    for domain in ("tcp", "curve"):
        who = introduced(domain, "x:0:0:1", "NULL" if domain == "tcp" else "CURVE", KEY)
        assert who.uid is None
        assert from_id(who.id).uid is None


@given(st.text())
def test_a_text_is_an_id_only_if_it_is_well_formed(text: str) -> None:
    who = from_id(text)
    assert who == NOBODY or who.id == text
    assert who.uid is None or text.split(":")[0] in ("ipc", "data")


@pytest.mark.parametrize(
    ("who", "text"),
    [
        (replace(user(1000), name="anna"), "anna (uid 1000, pid 77)"), (user(5), "user (uid 5, pid 77)"),
        (Principal("x", "curve", "laptop", key=KEY, address="10.0.0.1"), "key laptop"),
        (Principal("x", "curve", key=KEY, address="10.0.0.1"), f"key {KEY}"),
        (Principal("x", "tcp", address="10.0.0.1"), "10.0.0.1 without a key"), (NOBODY, "somebody without a key"),
        (replace(user(5), name="a\x1b[2J\n" + "b" * 300), f"a\\x1b[2J\\n{'b' * 194} (uid 5, pid 77)"),
        (on_behalf(user(5), "web:\tann"), "web:\\tann through ipc:5:5:77"),
    ],
)  # fmt: skip
def test_logs_say_who_it_is_in_one_line(who: Principal, text: str) -> None:
    assert str(who) == text


# ---- which rights that gives ----------------------------------------------------------------


def test_the_managers_user_and_root_are_admin_whatever_the_settings() -> None:
    for uid in (0, 500):
        assert rights(user(uid), local=(), users={str(uid): ("observe",)}).everywhere is Role.ADMIN


def test_without_settings_a_local_client_may_do_all_but_what_concerns_others() -> None:
    assert rights(user(1000)).everywhere is Role.PROVISION


def test_a_named_user_has_its_own_rights_and_not_the_default_ones() -> None:
    said = {"users": {"anna": ("observe",)}, "groups": {"lab": ("operate",)}, "local": ("provision",)}
    assert rights(user(1000), **said).everywhere is Role.OBSERVE
    assert rights(user(1001), **said).everywhere is Role.OPERATE
    assert rights(user(1002), **said).everywhere is Role.PROVISION
    assert rights(user(1000), users={"1000": ()}).role is Role.NONE
    assert rights(user(1000), users={"anna": ("nothing", "observe")}).role is Role.OBSERVE


def test_a_user_has_the_groups_of_the_process_and_those_of_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.getgrouplist", lambda name, gid: [gid, 0, 47111])
    users = system_users()
    assert users.groups(0, 47110) == ("47110", "0", "47111", "root")
    assert users.groups(47112, 47110) == ("47110",)  # a user without a name
    assert (users.name(0), users.name(47112)) == ("root", "")


def test_a_key_has_its_roles_until_its_end_and_an_unknown_one_has_none() -> None:
    clock = [100.0]
    keys = (AuthorizedKey(KEY, "laptop", ("operate",), 200.0),)
    gate = Gate(Access(keys=keys), USERS, lambda: clock[0])
    connection = gate.enter("curve", "10.0.0.1", "CURVE", KEY)
    assert connection is not None
    assert gate.principal(connection).name == "laptop"
    assert gate.everywhere(connection) is Role.OPERATE
    assert gate.enter("curve", "10.0.0.1", "CURVE", OTHER) is None
    assert gate.expired() == frozenset()
    clock[0] = 200.0
    assert gate.everywhere(connection) is Role.NONE
    assert gate.expired() == {KEY}
    assert gate.expired() == frozenset()
    assert gate.enter("curve", "10.0.0.1", "CURVE", KEY) is None


def test_a_new_policy_counts_at_once_and_tells_whose_rights_changed() -> None:
    before = Access(keys=(AuthorizedKey(KEY, "a"), AuthorizedKey(OTHER, "b")))
    gate = Gate(before, USERS)
    one, two = (gate.enter("curve", "10.0.0.1", "CURVE", key) for key in (KEY, OTHER))
    changed = gate.renew(replace(before, keys=before.keys[:1], users=MappingProxyType({"anna": ()})))
    assert gate.everywhere(one or "") is Role.PROVISION
    assert gate.everywhere(two or "") is Role.NONE
    assert [changed(gate.principal(each or "")) for each in (one, two)] == [False, True]
    assert {who.key for who in gate.from_address("10.0.0.1")} == {KEY, OTHER}
    assert [changed(user(uid)) for uid in (1000, 1001, 0)] == [True, False, False]


@pytest.mark.parametrize(
    ("domain", "uid", "let_in"),
    [
        ("ipc", 1000, True), ("ipc pub", 1000, True), ("ipc", 1001, True), ("ipc pub", 1001, False),
        ("ipc", 1002, False), ("ipc pub", 1002, False),
    ],
)  # fmt: skip
def test_publications_are_for_who_may_look_at_everything(
    caplog: pytest.LogCaptureFixture, domain: str, uid: int, let_in: bool
) -> None:
    users = {"anna": ("observe",), "ben": ("one",), "1002": ()}
    gate = Gate(Access(users=users, roles={"one": Grant(Role.OPERATE, regions=("prr0",))}), USERS)
    assert gate.enter(domain, f"localhost:{uid}:{uid}:7", "NULL", "") == (f"ipc:{uid}:{uid}:7" if let_in else None)
    name = {1001: "ben", 1002: "user"}.get(uid)
    to = " to publications, which need the right to observe everything" if "pub" in domain else ""
    said = f"refused: {name} (uid {uid}, pid 7) is not let in{to}"
    assert [(r.levelname, r.getMessage()) for r in caplog.records] == [("WARNING", said)] * (not let_in)


def test_who_comes_over_tcp_is_known_by_address_and_key(caplog: pytest.LogCaptureFixture) -> None:
    gate = Gate(Access(keys=(AuthorizedKey(KEY, "laptop"), AuthorizedKey(OTHER, "desk"))), USERS)
    for address in ("10.0.0.1", "::ffff:10.0.0.1", "10.0.0.2"):
        assert gate.enter("curve pub", address, "CURVE", KEY) == f"curve:{address.removeprefix('::ffff:')}:{KEY}"
    for address, keys in (("10.0.0.1", {KEY}), ("::ffff:10.0.0.2", {KEY}), ("10.0.0.3", set())):
        assert {who.key for who in gate.from_address(address)} == keys
    assert gate.enter("curve", "::ffff:10.0.0.9", "CURVE", "u" * 40) is None
    assert gate.enter("tcp", "10.0.0.9", "PLAIN", "") is None
    assert caplog.messages == [
        f"refused: key {'u' * 40} is not let in", "refused: 10.0.0.9 without a key is not let in",
    ]  # fmt: skip
    for number in range(5000):  # from more places than are remembered
        gate.enter("curve", f"10.1.{number >> 8}.{number & 255}", "CURVE", KEY)
    assert {who.key for who in gate.from_address("10.0.0.3")} == {KEY, OTHER}


def test_who_may_look_at_everything_is_remembered_until_the_policy_changes() -> None:
    clock = [0.0]
    keys = (AuthorizedKey(KEY, "laptop", ("observe",), 10.0), AuthorizedKey(OTHER, "desk", ("operate",)))
    access = Access(keys=keys, users={"ben": ()})
    gate = Gate(access, USERS, lambda: clock[0])
    ids = [gate.enter("curve", "10.0.0.1", "CURVE", key) or "" for key in (KEY, OTHER)] + [user(1001).id]
    assert [gate.everywhere(each) for each in ids] == [Role.OBSERVE, Role.OPERATE, Role.NONE]
    assert [gate.rights(each).role for each in ids] == [Role.OBSERVE, Role.OPERATE, Role.NONE]
    clock[0] = 10.0
    for each, role in zip(ids, (Role.NONE, Role.OPERATE, Role.NONE), strict=True):
        assert (gate.everywhere(each), gate.rights(each).role) == (role, role)
    with pytest.raises(Forbidden, match="no right to cm_status; it takes the role observe there"):
        admitted(gate, ids[0], rq.ReadStatus())


def test_custom_roles_are_narrow_and_add_up() -> None:
    tuner = MappingProxyType({"tuner": Grant(Role.OPERATE, registers=("focus", "led.*"))})
    found = rights(user(1000), users={"anna": ("observe", "tuner")}, roles=tuner)
    assert (found.role, found.everywhere) == (Role.OPERATE, Role.OBSERVE)
    for name, allowed in (("focus", True), ("zoom", False), ("led.red", True), ("led", False), ("*", False)):
        assert found.allow(Need(Role.OPERATE, "cm_write_reg", "camera", "static", name)) is allowed, name


@pytest.mark.parametrize("what", ["topic", "config", "region", "register", "data"])
def test_each_pattern_narrows_what_it_names(what: str) -> None:
    grant = Grant(Role.OPERATE, **{what if what == "data" else f"{what}s": ("a*",)})  # type: ignore[arg-type]
    needs = [replace(Need(Role.OPERATE, "axe"), **{what: name}) for name in ("ab", "b", "*")]
    assert [grant.allows(need) for need in needs] == [True, False, False]


# ---- what holds for every policy ---------------------------------------------------------------


@given(grants, needs)
def test_a_higher_role_may_do_no_less(grant: Grant, need: Need) -> None:
    higher = replace(grant, role=Role(min(grant.role + 1, Role.ADMIN)))
    assert not grant.allows(need) or higher.allows(need)


@given(grants, needs)
def test_patterns_only_take_away(grant: Grant, need: Need) -> None:
    assert not grant.allows(need) or Grant(grant.role).allows(need)


@given(st.lists(grants, max_size=3), grants, needs)
def test_a_further_grant_takes_nothing_away(some: list[Grant], more: Grant, need: Need) -> None:
    assert not Rights(tuple(some)).allow(need) or Rights((*some, more)).allow(need)


@given(st.lists(grants, max_size=3), st.lists(grants, max_size=3), needs)
def test_no_guest_gets_more_than_the_bridge_that_speaks_for_it(a: list[Grant], b: list[Grant], need: Need) -> None:
    bridge = Rights(tuple(b))
    guest = Rights(tuple(a), under=bridge)
    assert not guest.allow(need) or bridge.allow(need)
    assert guest.role <= bridge.role
    assert guest.everywhere <= bridge.everywhere


@given(st.lists(grants, max_size=3), needs)
def test_a_client_with_a_role_everywhere_is_refused_nothing_of_it(some: list[Grant], need: Need) -> None:
    """The fast path of `Gate.admit`, which does not determine what a request touches."""
    found = Rights(tuple(some))
    assert need.role > found.everywhere or found.allow(need)


# ---- what each request takes --------------------------------------------------------------------


def test_every_kind_of_request_and_every_purpose_has_a_right() -> None:
    assert {*BY_KIND, *OPENING} == {*get_args(rq.Request), *Purpose}


def right_of(request: Any) -> Right:
    return OPENING[request.purpose] if isinstance(request, Open) else BY_KIND[type(request)].right


def admitted(gate: Gate, connection: str, request: Any, scene: Any = lambda: SCENE) -> Any:
    return gate.admit(connection, request, right_of(request), scene)


def needed(request: Any, scene: Scene = SCENE) -> list[Need]:
    return list(needs_of(right_of(request), request, scene))


def touched(request: rq.Request, scene: Scene = SCENE) -> set[tuple[str | None, ...]]:
    return {(need.config, need.region, need.register, need.data) for need in needed(request, scene)}


# by the flags of an OPEN: the role that it takes; all others are no OPEN
WINDOWS = {8 | write | exclusive | wait for write in (0, 1) for exclusive in (0, 16) for wait in (0, 32)}
ROLES = {
    0: "observe",
    1: "operate",
    2: "observe",
    4: "operate",
    64: "observe",
    128: "operate",
    **dict.fromkeys(WINDOWS, "map"),
}


@pytest.mark.parametrize("role", Role)
def test_each_open_takes_the_role_of_its_purpose_whatever_its_flags(role: Role) -> None:
    gate = Gate(Access(local=(role.name.lower(),)), USERS)
    allowed = set()
    for flags in range(256):
        try:
            wanted = packets.decode_open(packets.Descriptor(kind=packets.OPEN, flags=flags).pack())
            gate.check(user(1000).id, *needed(wanted))
        except (InvalidRequest, Forbidden):
            continue
        allowed.add(flags)
    assert allowed == {flags for flags, least in ROLES.items() if Role[least.upper()] <= role}


def test_a_change_within_a_configuration_touches_the_regions_of_its_modules() -> None:
    assert touched(rq.ChangeMode(mode="edge_detection")) == {
        ("camera", None, None, None),
        ("camera", "prr0", None, None),
    }


def test_to_unload_touches_what_is_unloaded() -> None:
    assert {region for _, region, _, _ in touched(rq.ChangeMode(unload="prr1"))} == {None, "prr1"}
    assert {region for _, region, _, _ in touched(rq.ChangeMode(unload="*"))} == {None, "prr0", "prr1", "static"}


def test_a_change_to_another_configuration_or_by_force_touches_everything() -> None:
    regions = {region for _, region, _, _ in touched(rq.ChangeMode("camera", "default"), EMPTY)}
    assert regions == {None, "prr0", "prr1", "static"}
    for request in (rq.ChangeMode(mode="default", force=True), rq.ChangeMode(mode="default", undo="fleet")):
        assert {region for _, region, _, _ in touched(request)} == regions
    other = replace(CAMERA, name="other", regions={"x": CAMERA.regions["prr0"]})
    from_other = touched(rq.ChangeMode("camera", "default"), replace(SCENE, loaded=other))
    wanted = {("camera", region, None, None) for region in (*regions, "x")}
    assert from_other == {*wanted, ("other", None, None, None)}
    assert touched(rq.ChangeMode("camera", "default"), replace(SCENE, coming=other)) == from_other


def running(*scopes: str, **said: Any) -> set[tuple[str | None, ...]]:
    change = Change(7, "camera", "default", scopes=scopes, **said)
    return touched(rq.CancelChange(), replace(SCENE, running=7, runs=change.touches))


def test_who_cancels_touches_what_the_change_touches_that_runs() -> None:
    assert running("mode", "region:prr1", "registers:led") == {("camera", "prr1", None, None)}
    everything = {("*", "*", None, None)}
    assert [running("config"), running(), running("mode", "region:prr1", force=True)] == [everything] * 3
    assert running("mode", "region:prr1", undoing=True) == everything


def test_only_the_change_is_cancelled_for_which_the_right_was_asked() -> None:
    assert resolved(rq.CancelChange(), replace(SCENE, running=7)) == rq.CancelChange(7)
    assert resolved(rq.CancelChange(), SCENE) == rq.CancelChange(0)  # none has this number


def test_a_register_touches_its_region() -> None:
    assert touched(rq.WriteReg((rq.RegWrite("threshold", 1),))) == {("camera", "prr0", "threshold", None)}
    assert touched(rq.ReadReg(("nothing",))) == {("camera", "*", "nothing", None)}
    assert touched(rq.ReadReg()) == {("camera", "*", "*", None)}


LOOK, WRITE = (Role.OBSERVE, "cm_data_config"), (Role.OPERATE, "cm_data_config")
CONFIG, STORE = (Role.OBSERVE, "cm_read_config"), (Role.PROVISION, "cm_write_config")


@pytest.mark.parametrize(
    ("request_", "need"),
    [
        (rq.ReadStatus(), Need(Role.OBSERVE, "cm_status")),
        (rq.ListConfigs(), Need(*CONFIG)),
        (rq.ReadConfig(), Need(*CONFIG, config="camera")),
        (rq.ReadConfig("other"), Need(*CONFIG, config="other")),
        (rq.PlanChange(mode="default"), Need(*CONFIG, config="camera")),
        (rq.PlanChange("other", "default"), Need(*CONFIG, config="other")),
        (rq.CancelChange(), Need(Role.OPERATE, "cm_write_config", config="camera")),
        (rq.Provision("config: {}"), Need(*STORE)),
        (rq.RemoveConfig("other"), Need(*STORE, config="other")),
        (rq.CheckRegion("prr1"), Need(Role.OPERATE, "cm_region", "camera", "prr1")),
        (rq.CheckRegion("nothing"), Need(Role.OPERATE, "cm_region", "camera", "*")),
        (rq.MapRegion("prr1"), Need(Role.OBSERVE, "cm_region", "camera", "prr1")),
        (rq.ReadReg(("led.pattern",)), Need(Role.OBSERVE, "cm_read_reg", "camera", "static", "led.pattern")),
        (rq.DescribeData("camera"), Need(*LOOK, "camera", "prr0", data="camera")),
        (rq.ConfigureStream("from_pl"), Need(*WRITE, "camera", "prr1", data="from_pl")),
        (rq.DefineMemory("scratchpad"), Need(Role.PROVISION, "cm_data_config", "camera", "*", data="scratchpad")),
        (rq.DefineMemory("own"), Need(Role.PROVISION, "cm_data_config", "camera", "*", data="own")),
        (rq.ReadData("camera"), Need(Role.OBSERVE, "cm_read_data", "camera", "prr0", data="camera")),
        (rq.ReadData("scratchpad"), Need(Role.OBSERVE, "cm_read_data", "camera", "static", data="scratchpad")),
        (rq.ReadData("nothing"), Need(Role.OBSERVE, "cm_read_data", "camera", "*", data="nothing")),
        (rq.ReadData(), Need(Role.OBSERVE, "cm_read_data", "camera", "*", data="*")),
        (rq.WriteData("to_pl"), Need(Role.OPERATE, "cm_write_data", "camera", "prr1", data="to_pl")),
        (rq.Upload("a", 1), Need(Role.OPERATE, "cm_upload")),
        (rq.ReadIrq("frame_done"), Need(Role.OBSERVE, "cm_irq")),
        (rq.TakeLease("memories:scratchpad"), Need(Role.OPERATE, "cm_lease", None, "static", data="scratchpad")),
        (rq.RenewLease("x"), Need(Role.OPERATE, "cm_lease")),
        (rq.ReleaseLease("x"), Need(Role.OPERATE, "cm_lease")),
        (rq.BreakLease(1), Need(Role.ADMIN, "cm_lease")),
    ],
)
def test_a_request_touches_one_thing(request_: rq.Request, need: Need) -> None:
    assert needed(request_) == [need]


def test_where_nothing_is_loaded_a_request_touches_everything_of_its_kind() -> None:
    assert touched(rq.ReadConfig(), EMPTY) == {(None, None, None, None)}
    assert touched(rq.CheckRegion("prr0"), EMPTY) == {(None, "*", None, None)}
    assert touched(rq.ReadReg(("zoom",)), EMPTY) == {(None, "*", "zoom", None)}
    assert touched(rq.ReadData("camera"), EMPTY) == {(None, "*", None, "camera")}


def test_what_a_mode_says_of_a_stream_counts_before_what_the_configuration_says() -> None:
    camera = CAMERA.streams["camera"]
    streams = {"own": replace(camera, region="prr1"), "camera": replace(camera, region=None)}
    modes = {"edge_detection": replace(CAMERA.modes["edge_detection"], streams=streams)}
    scene = replace(SCENE, loaded=replace(CAMERA, modes=modes))
    for name, region in (("own", "prr1"), ("camera", "static"), ("to_pl", "*")):
        assert touched(rq.ReadData(name), scene) == {("camera", region, None, name)}
    assert touched(rq.ReadData("own"), replace(scene, mode=None)) == {("camera", "*", None, "own")}


@pytest.mark.parametrize(
    ("wanted", "need"),
    [
        (Open("camera"), Need(Role.OBSERVE, "data", "camera", "prr0", data="camera")),
        (Open("to_pl", Purpose.WRITE), Need(Role.OPERATE, "data", "camera", "prr1", data="to_pl")),
        (Open("camera", Purpose.TRANSFER), Need(Role.OPERATE, "data", "camera", "prr0", data="camera")),
        (Open("", Purpose.ECHO), Need(Role.OBSERVE, "data", "camera", "*", data="*")),
        (Open("", Purpose.ALLOCATE), Need(Role.OPERATE, "data", "camera", "*", data="*")),
        (Open("camera", Purpose.ALLOCATE), Need(Role.OPERATE, "data", "camera", "*", data="*")),
        (Open("edge", Purpose.WINDOW), Need(Role.MAP, "data", "camera", "prr0", "*", "*")),
        (Open("prr1", Purpose.WRITABLE_WINDOW), Need(Role.MAP, "data", "camera", "prr1", "*", "*")),
        (Open("static", Purpose.WINDOW), Need(Role.MAP, "data", "camera", "static", "*", "*")),
        (Open("nothing", Purpose.WINDOW), Need(Role.MAP, "data", "camera", "*", "*", "*")),
        (Open("", Purpose.REGISTERS), Need(Role.OBSERVE, "*", "*", "*", "*", "*")),
    ],
)
def test_what_is_not_copied_is_named_too(wanted: Open, need: Need) -> None:
    assert needed(wanted) == [need]


def test_where_nothing_is_loaded_a_window_touches_everything() -> None:
    assert needed(Open("static", Purpose.WINDOW), EMPTY) == [Need(Role.MAP, "data", None, "*", "*", "*")]


@pytest.mark.parametrize("name", ["prr1", "static"])
def test_a_window_of_a_region_is_not_that_of_a_module_with_the_same_name(name: str) -> None:
    modules = {**CAMERA.modules, name: replace(CAMERA.modules["edge"], name=name)}  # which belongs to prr0
    scene = replace(SCENE, loaded=replace(CAMERA, modules=modules))
    assert needed(Open(name, Purpose.WINDOW), scene) == [Need(Role.MAP, "data", "camera", name, "*", "*")]


def test_a_stream_is_where_the_module_has_it_that_its_region_keeps() -> None:
    """As whoever opens it finds it: a mode that does not name the region leaves its module there."""
    camera = CAMERA.streams["camera"]
    modes = {
        "edge_detection": replace(CAMERA.modes["edge_detection"], streams={"camera": replace(camera, region="prr1")}),
        "loopback": replace(CAMERA.modes["loopback"], streams={"camera": replace(camera, region=None)}),
    }
    streams = {"camera": replace(camera, region="prr1")}
    held = {"prr1": CAMERA.modes["loopback"].modules[0]}
    scene = replace(SCENE, loaded=replace(CAMERA, streams=streams, modes=modes), held=held)
    assert touched(rq.ReadData("camera"), scene) == {("camera", "static", None, "camera")}


def test_a_configuration_that_is_stored_is_named_too() -> None:
    assert provisioning("other") == Need(Role.PROVISION, "cm_write_config", "other")


def test_what_touches_everything_is_allowed_by_no_pattern_that_matches_every_name() -> None:
    for pattern in ("?", "[!a]*", "[*]"):
        assert not Grant(Role.OBSERVE, data=(pattern,)).allows(Need(Role.OBSERVE, "data", data="*"))
    assert Grant(Role.OBSERVE, data=("zoom", "*")).allows(Need(Role.OBSERVE, "data", data="*"))


def test_a_lease_needs_rights_to_everything_that_it_reserves() -> None:
    assert touched(rq.TakeLease("board")) == {("*", "*", "*", "*")}
    assert touched(rq.TakeLease("region:prr1")) == {(None, "prr1", None, None)}
    assert touched(rq.TakeLease("registers:threshold")) == {("camera", "prr0", "threshold", None)}


def test_a_user_that_may_reach_one_region_changes_it_and_no_other() -> None:
    roles = MappingProxyType({"left": Grant(Role.OPERATE, regions=("prr0",))})
    gate = Gate(Access(users=MappingProxyType({"anna": ("left",)}), roles=roles), USERS)
    anna = user(1000).id
    said = admitted(gate, anna, rq.ChangeMode(name_or_mode="edge"))
    assert said == rq.ChangeMode("camera", "edge_detection")  # what was checked is what is done
    admitted(gate, anna, rq.WriteReg((rq.RegWrite("threshold", 1),)))
    for request in (
        rq.ChangeMode(mode="loopback"),
        rq.ChangeMode(mode="edge_detection", force=True),
        rq.WriteReg((rq.RegWrite("threshold", 1), rq.RegWrite("scratch", 1))),
        rq.Provision("config: {}"),
        rq.TakeLease("config"),
    ):
        with pytest.raises(Forbidden, match=r"anna \(uid 1000, pid 77\) has no right to cm_.*; it takes the role "):
            admitted(gate, anna, request)
    need = Need(Role.OPERATE, "cm_write_reg", "camera", "prr1", "scratch", "*")
    said = "cm_write_reg on configuration 'camera', region 'prr1', register 'scratch'; it takes the role operate there"
    with pytest.raises(Forbidden, match=f"has no right to {said}"):
        gate.check(anna, Need(Role.OPERATE, "x", region="prr0"), need)
    with pytest.raises(Forbidden, match="has no right to this; it takes the role admin there"):
        gate.check(anna, Need(Role.ADMIN, ""))


def test_for_a_client_that_may_do_everything_the_loaded_state_is_not_read() -> None:
    def scene() -> Scene:
        raise AssertionError

    request = rq.WriteReg((rq.RegWrite("x", 1),))
    assert admitted(Gate(Access(), USERS), user(1000).id, request, scene) is request


# ---- files of keys -----------------------------------------------------------------------------


def test_a_keys_file_says_role_and_end() -> None:
    text = f"# client laptop\npublic: {KEY}\nrole: observe, tuner\nexpires: 2030-12-31\n"
    key = authorized("laptop", pairs_of(text))
    assert (key.public, key.name, key.roles) == (KEY, "laptop", ("observe", "tuner"))
    assert key.until == 1924991999.0  # the last second of that day, UTC
    assert authorized("x", {"public": KEY}).roles == ("provision",)
    assert authorized("x", {"public": KEY, "role": " , observe ,"}).roles == ("observe",)
    assert authorized("x", {"public": KEY}).until is None
    for said in ("2030-12-31T12:00:00", "2030-12-31T12:00:00Z", "2030-12-31T14:00:00+02:00"):
        assert authorized("x", {"public": KEY, "expires": said}).until == 1924948800.0
    assert pairs_of("a:1\n# a: 2\n\n  \nb : c:d \nb: e") == {"a": "1", "b": "e"}
    assert authorized("x", {"public": KEY, "expires": "2030-12-31T12:00:00+01:00"}).until == 1924945200.0


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no line 'public:'"),
        ("public: short\n", "it has no line 'public:' with a key of 40 characters, as 'cm keygen' writes it$"),
        (
            f"public: {KEY}\nsecret: {KEY}\n",
            "it holds a secret key: only NAME.pub belongs here, the .key is the client's alone$",
        ),
        (f"public: {KEY}\nroles: admin\n", "unknown line 'roles'"),
        (f"public: {KEY}\nexpires: tomorrow\n", "not a day such as"),
    ],
)
def test_the_error_for_a_keys_file_says_what_is_wrong(text: str, told: str) -> None:
    with pytest.raises(InvalidRequest, match=told):
        authorized("laptop", pairs_of(text))


@given(st.text())
def test_no_text_breaks_the_reader_of_keys(text: str) -> None:
    try:
        key = authorized("x", pairs_of(text))
    except InvalidRequest:
        return
    assert len(key.public) == 40


# ---- the page -------------------------------------------------------------------------------------


def test_the_page_has_the_roles_in_their_order() -> None:
    text = (ROOT / "docs/security.md").read_text("utf-8").split("a test compares this table")[1].split("\n\n| who")[0]
    assert re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE) == [role.name.lower() for role in Role if role]


def test_the_page_has_the_role_that_each_request_takes_at_each_door() -> None:
    text = (ROOT / "docs/security.md").read_text("utf-8")
    rows = [f"| {p.name.lower().replace('_', ' ')} | {right.least.role.name.lower()} |" for p, right in OPENING.items()]
    assert "\n".join(["| OPEN | role |", "|---|---|", *rows, ""]) in text
    asked, controlled = re.findall(r"It asks for (.*), and with `--control` for (.*)\.", text)[0]
    least = {kind.__name__: row.right.least.role for kind, row in BY_KIND.items()}
    assert {least[name] for name in asked.split(", ")} == {Role.OBSERVE}
    assert {least[name] for name in controlled.split(", ")} == {Role.OPERATE}


# ---- bridges --------------------------------------------------------------------------------------

WEB = MappingProxyType({"web": Grant(Role.OPERATE, guests=("web:*",))})


def test_a_bridge_speaks_only_for_the_guests_that_its_role_names() -> None:
    guests = MappingProxyType({"web:ann": ("observe",), "web:boss": ("admin",), "*": ()})
    gate = Gate(Access(users=MappingProxyType({"anna": ("web",)}), roles=WEB, guests=guests), USERS)
    bridge = user(1000).id
    assert gate.everywhere(bridge) is Role.OPERATE  # the right to speak narrows nothing
    for name, role in (("web:ann", Role.OBSERVE), ("web:boss", Role.OPERATE), ("web:else", Role.NONE)):
        guest = gate.guest(bridge, name)
        assert gate.everywhere(guest) is role, name
        assert (gate.principal(guest).name, gate.principal(guest).account) == (name, f"for:{name}")
        assert str(gate.principal(guest)) == f"{name} through {bridge}"
    for name in ("ros:ann", "root", "web:" + "x" * 64, "web:a\nb"):
        assert gate.everywhere(gate.guest(bridge, name)) is Role.NONE, name
    assert gate.guest(bridge, "") == bridge
    assert [bool(gate.guest(bridge, name)) for name in ("x" * 64, "x" * 65, "a\nb")] == [True, False, False]


def test_a_guests_own_name_counts_before_patterns_and_a_long_pattern_before_a_short_one() -> None:
    guests = MappingProxyType({"*": (), "web:*": ("observe",), "web:a*": ("provision",), "web:ann": ("operate",)})
    roles = MappingProxyType({"web": Grant(Role.ADMIN, guests=("*",))})
    gate = Gate(Access(users=MappingProxyType({"anna": ("web",)}), roles=roles, guests=guests), USERS)
    for name, role in (
        ("web:ann", Role.OPERATE),
        ("web:anna", Role.PROVISION),
        ("web:bob", Role.OBSERVE),
        ("ros:bob", Role.NONE),
        ("WEB:bob", Role.NONE),
    ):
        assert gate.everywhere(gate.guest(user(1000).id, name)) is role, name
    gate = Gate(Access(users=MappingProxyType({"anna": ("web",)}), roles=roles, guests=MappingProxyType({})), USERS)
    assert gate.everywhere(gate.guest(user(1000).id, "web:ann")) is Role.NONE


def test_an_admin_speaks_for_every_guest_and_a_user_without_the_right_for_none() -> None:
    guests = MappingProxyType({"boss": ("admin",)})
    gate = Gate(Access(guests=guests), USERS)
    guest = gate.guest(user(0).id, "boss")
    assert gate.everywhere(guest) is Role.ADMIN
    gate = Gate(Access(guests=guests), USERS)
    assert gate.everywhere(gate.guest(user(1000).id, "boss")) is Role.NONE


@given(st.text(min_size=1, max_size=64), st.sampled_from([user(0).id, user(1000).id]))
def test_a_guests_name_is_read_out_of_its_id_whatever_it_is(name: str, bridge: str) -> None:
    assert guest_of(on_behalf(from_id(bridge), name).id) == (name, bridge)
    assert from_id(on_behalf(from_id(bridge), name).id) == NOBODY


def test_the_rights_of_a_guest_end_with_those_of_its_bridge() -> None:
    clock = [0.0]
    keys = (AuthorizedKey(KEY, "gateway", ("admin",), 10.0),)
    gate = Gate(Access(keys=keys, guests=MappingProxyType({"*": ("operate",)})), USERS, lambda: clock[0])
    bridge = gate.enter("curve", "10.0.0.1", "CURVE", KEY) or ""
    guest = gate.guest(bridge, "anybody")
    assert gate.everywhere(guest) is Role.OPERATE
    clock[0] = 10.0
    assert gate.everywhere(guest) is Role.NONE
    late = gate.guest(bridge, "who comes while the key has expired")
    assert gate.everywhere(late) is Role.NONE
    clock[0] = 9.0  # the clock was wrong, and is set
    assert gate.everywhere(guest) is gate.everywhere(late) is Role.OPERATE


def test_every_promise_of_the_page_names_a_test_that_there_is() -> None:
    text = (ROOT / "docs/promises.md").read_text("utf-8")
    rows = [line for line in text.splitlines() if line.startswith("- ")]
    assert len(rows) > 25
    for row in rows:
        path = ""
        for file, name in re.findall(r"`(tests/[\w/]+\.py)?::(test_\w+)`", row):
            path = file or path
            assert f"def {name}(" in (ROOT / path).read_text("utf-8"), f"{path}::{name}"
        assert path, row
