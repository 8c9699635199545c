"""Files from anyone: damaged and hostile policies are refused with one error, at once, and no code runs."""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import random
import resource
import struct
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from shape_obs.policy import Policy, PolicyError, load_policy
from shape_obs.policy.policy import policy_from

onnx = pytest.importorskip("onnx")
SIZE = 4
SEEN = np.random.default_rng(1).standard_normal((32, SIZE)).astype(np.float32)
WEIGHTS = np.random.default_rng(0).standard_normal((SIZE, 2)).astype(np.float32)


def network(change: Callable[[Any], Any] = lambda graph: None) -> bytes:
    """Return a small network: the tanh of a linear map."""
    value, number = onnx.helper.make_tensor_value_info, onnx.TensorProto.FLOAT
    inputs, outputs = [value("observation", number, [1, SIZE])], [value("action", number, [1, 2])]
    graph = onnx.helper.make_graph([], "policy", inputs, outputs)
    constant(graph, "w", WEIGHTS)
    node("MatMul", ["observation", "w"], ["linear"])(graph)
    node("Tanh", ["linear"], ["action"], 1)(graph)
    change(graph)
    opsets = [onnx.helper.make_opsetid("", 20), onnx.helper.make_opsetid("ai.onnx.contrib", 1)]
    return onnx.helper.make_model(graph, opset_imports=opsets, ir_version=10).SerializeToString()


def policy(network: bytes = b"", replay: bytes = b"", **changes: Any) -> dict[str, bytes]:
    """Return the members of a policy with changed content and correct hashes."""
    members = {"policy.onnx": network or NETWORK, "replay.npz": replay or replayed(np.tanh(SEEN @ WEIGHTS))}
    contract: dict[str, Any] = {
        "format": 1, "dt": 0.05, "inputs": {"observation": {"shape": [SIZE], "dtype": "float32"}},
        "action": {"shape": [2], "dtype": "float32", "low": [-1, -1], "high": [1, 1]},
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in members.items()},
    }  # fmt: skip
    return members | {"policy.yaml": yaml.safe_dump(contract | changes).encode()}


def replayed(action: Any, seen: Any = SEEN) -> bytes:
    buffer = io.BytesIO()
    start = np.arange(len(seen)) == 0
    np.savez(buffer, allow_pickle=False, **{"observation/observation": seen}, action=action, start=start)
    return buffer.getvalue()


def node(kind: str, inputs: Any, outputs: Any, at: int = 0, **attributes: Any) -> Callable[[Any], None]:
    """Return a change that puts an operator into a graph."""
    return lambda graph: graph.node.insert(at, onnx.helper.make_node(kind, inputs, outputs, **attributes))


def constant(graph: Any, name: str, values: Any) -> None:
    graph.initializer.append(onnx.numpy_helper.from_array(np.asarray(values), name))


def huge(graph: Any) -> None:
    constant(graph, "side", [200_000, 200_000])
    node("ConstantOfShape", ["side"], ["large"])(graph)


def growing(graph: Any) -> None:
    constant(graph, "twice", [100_000, 1])
    node("Tile", ["observation", "twice"], ["tall"])(graph)
    node("Transpose", ["tall"], ["wide"], 1)(graph)
    node("MatMul", ["tall", "wide"], ["square"], 2)(graph)


def long(graph: Any) -> None:
    constant(graph, "sides", [2500, 2500])
    constant(graph, "one", np.ones((1, 1), np.float32))
    node("Expand", ["one", "sides"], ["large"])(graph)
    node("MatMul", ["large", "large"], ["slow"], 1)(graph)


def many(graph: Any) -> None:
    graph.node.extend([onnx.NodeProto()] * 400_000)


def listed(graph: Any) -> None:
    graph.initializer[0].int64_data.extend([1] * 400_000)  # a byte each in the file, eight in memory


def inner(graph: Any) -> None:
    node("Identity", ["observation"], ["again"], body=onnx.helper.make_graph([], "body", [], []))(graph)


def external(graph: Any) -> None:
    tensor = graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = 1
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"


def looping(graph: Any) -> None:
    node("Loop", ["", "", "observation"], ["again"], body=onnx.helper.make_graph([], "body", [], []))(graph)


def claimed(graph: Any) -> None:
    graph.initializer[0].dims[0] = 10**12


NETWORK = network()
HANGS = 30.0  # seconds of a CPU, on any machine: refusing takes 2 at most


@contextmanager
def refused(message: str) -> Iterator[None]:
    """Require that a policy is refused with a message, without hanging, and without much memory."""
    before, begun = peak(), time.process_time()
    with pytest.raises(PolicyError, match=message):
        yield
    assert time.process_time() - begun < HANGS
    assert peak() - before < 300


def peak() -> float:
    """Return the largest memory of this process so far in megabytes."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1 << 10 if sys.platform != "darwin" else 1 << 20)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (huge, "expected at most 67108864 bytes"),
        (growing, "expected at most 67108864 bytes"),
        (long, "5e\\+08 multiplications"),
        (many, "at most 150000 fields"),
        (listed, "at most 150000 fields"),
        (external, "'w' is in another file"),
        (looping, "the operator Loop is not allowed"),
        (claimed, "the tensor 'w' has the shape"),
        (inner, "the operator Identity has a graph or a sparse tensor inside"),
        (node("If", ["observation"], ["x"]), "the operator If is not allowed"),
        (node("RandomNormal", [], ["x"], shape=[4]), "the operator RandomNormal is not allowed"),
        (
            node("PyOp", ["observation"], ["x"], domain="ai.onnx.contrib"),
            "the operator ai.onnx.contrib.PyOp is not allowed",
        ),
        (lambda graph: graph.node.pop(), "not a policy, or a damaged one"),
        (lambda graph: setattr(graph.input[0], "name", "seen"), "not a policy, or a damaged one"),
        (lambda graph: setattr(graph.output[0], "name", "linear"), "expected the output .action."),
    ],
)
def test_networks_that_could_do_more_than_compute_are_refused(change, message):
    members = policy(network(change))
    with refused(message):
        policy_from(members)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 2}, "expected a policy of format 1, got 2: save it again"),
        ({"dt": 1e9}, "dt: expected 0.0001 to 3600 seconds"),
        ({"inputs": {"observation": {"shape": [10**9], "dtype": "float32"}}}, "expected the inputs"),
        ({"inputs": {"observation": {"shape": [5], "dtype": "float32"}}}, "expected the inputs"),
        ({"wrappers": [{"name": "os:system", "kwargs": {}}]}, "expected ShapeGoal and PointReward, got 'os:system'"),
        ({"config": {"shapes": ["centerline"], "segmentation": "os:system"}}, "the segmentation is code to import"),
        (
            {"config": {"shapes": [{"kind": "centerline", "n": 10**7}]}},
            "n is 10000000, expected a finite number up to 1000",
        ),
        ({"config": {"features": [{"kind": "pca", "file": "/etc/passwd"}]}}, "reads the file '/etc/passwd'"),
        ({"schema": "0" * 64}, "its features mean something else here"),
        ({"action": {"shape": [2], "dtype": "float32"}}, "ValueError: cannot reshape array of size 0"),
        ({"unknown": 1}, "unknown field 'unknown'"),
        ({"sha256": {}}, "policy.onnx was changed, or is damaged"),
    ],
)
def test_contracts_that_ask_for_too_much_are_refused(changes, message):
    members = policy(**changes)
    with refused(message):
        policy_from(members)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["policy.onnx", "policy.yaml"], "expected policy.onnx, policy.yaml, replay.npz, got"),
        (["policy.onnx", "policy.yaml", "replay.npz", "../../evil.py"], "evil.py"),
        (["policy.onnx", "policy.yaml", "replay.npz", "policy.onnx"], "policy.onnx, policy.onnx"),
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_zips_of_other_files_are_refused(names, message, tmp_path):
    members = policy()
    with zipfile.ZipFile(tmp_path / "a.policy", "w") as archive:
        for name in names:
            archive.writestr(name, members.get(name, b"raise SystemExit"))
    with refused(message):
        load_policy(tmp_path / "a.policy")
    assert [item.name for item in tmp_path.iterdir()] == ["a.policy"]


def test_a_folder_is_read_too_and_a_bomb_is_not_unpacked(tmp_path):
    (tmp_path / "folder").mkdir()
    for name, data in policy().items():
        (tmp_path / "folder" / name).write_bytes(data)
    assert load_policy(tmp_path / "folder").spec.dt == 0.05
    with zipfile.ZipFile(tmp_path / "a.policy", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in policy():
            archive.writestr(name, bytes(200 << 20 if name == "replay.npz" else 1))
    with refused(r"replay.npz: expected at most 33554432 bytes, got 209715200"):
        load_policy(tmp_path / "a.policy")
    with refused(r"expected policy.onnx, policy.yaml, replay.npz, got ''"):
        load_policy(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"no such policy"):
        load_policy(tmp_path / "b.policy")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="not a system with device files")
def test_only_regular_files_are_read(tmp_path):
    for name, data in policy().items():
        (tmp_path / name).write_bytes(data)
    for make in (lambda path: path.symlink_to("/dev/zero"), os.mkfifo):
        (tmp_path / "policy.onnx").unlink()
        make(tmp_path / "policy.onnx")
        with refused("expected policy.onnx, policy.yaml, replay.npz, got 'policy.yaml, replay.npz'"):
            load_policy(tmp_path)
        with refused("expected a folder, or a file of at most"):
            load_policy(tmp_path / "policy.onnx")


def crowded(comment: bytes = b"", zip64: bool = False) -> bytes:
    """Return a zip file with a list of a million entries."""
    entry, count = struct.pack("<4s42xx", b"PK\1\2"), 1_000_000
    entry = entry[:28] + b"\1" + entry[29:]  # a name of one character
    size = len(entry) * count
    end = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, count & 0xFFFF, count & 0xFFFF, size, 0, len(comment)) + comment
    if zip64:
        large = struct.pack("<4sQ2H2I4Q", b"PK\6\6", 44, 45, 45, 0, 0, count, count, size, 0)
        locator = struct.pack("<4sIQI", b"PK\6\7", 0, size, 1)
        end = large + locator + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0, 0, 0)
    return entry * count + end


@pytest.mark.parametrize("options", [{}, {"comment": b"many"}, {"zip64": True}])
def test_a_zip_of_a_million_entries_is_refused_before_they_are_read(options, tmp_path):
    data = crowded(**options)
    (tmp_path / "a.policy").write_bytes(data)
    with refused("its end is missing, has a comment, or a list of more than 1048576 bytes"):
        load_policy(tmp_path / "a.policy")
    data = data[len(data) // 2 :]  # smaller than the limit of the replay
    members = policy(replay=data)
    with refused("its end is missing, has a comment, or a list of more than 1048576 bytes"):
        policy_from(members)


def test_other_compressions_than_numpys_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.policy", "w", zipfile.ZIP_LZMA) as archive:
        for name, data in policy().items():
            archive.writestr(name, data)
    with refused("expected entries that are stored or deflated"):
        load_policy(tmp_path / "a.policy")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("policy.yaml", b"[" + b"a," * 32_000 + b"a]", "expected a mapping"),
        ("policy.yaml", b" " * 70_000, "policy.yaml: expected at most 65536 bytes, got 70000"),
        ("policy.onnx", bytes(37 << 20), "policy.onnx: expected at most 37748736 bytes"),
    ],
)
def test_long_files_are_refused_before_they_are_read(name, content, message):
    members = policy() | {name: content}
    with refused(message):
        policy_from(members)


def test_a_long_replay_of_a_large_network_ends_early(monkeypatch):
    acted = list[int]()
    act = Policy.act
    monkeypatch.setattr(Policy, "act", lambda self, *args: acted.append(1) or act(self, *args))

    def change(graph: Any) -> None:
        constant(graph, "large", np.zeros((SIZE, 2_000_000), np.float32))
        node("MatMul", ["observation", "large"], ["wide"])(graph)

    seen = np.resize(SEEN, (1024, SIZE))
    policy_from(policy(network(change), replayed(np.tanh(seen @ WEIGHTS), seen)))
    assert len(acted) == 36
    acted.clear()
    policy_from(policy(replay=replayed(np.tanh(seen @ WEIGHTS), seen)))
    assert len(acted) == 1024


TAGS = b"object/apply:canary.run []", b"name:canary.run"


class Canary:
    """Leave a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def test_no_code_runs_that_a_file_names_or_contains(tmp_path, monkeypatch):
    left = tmp_path / "left"
    (tmp_path / "canary.py").write_text(f"import pathlib\npathlib.Path({str(left)!r}).touch()\nrun = Run = print\n")
    monkeypatch.syspath_prepend(tmp_path)
    pickled, objects = pickle.dumps(Canary(left)), io.BytesIO()
    np.savez(objects, action=np.array([Canary(left)] * 32, object))
    shape = {"kind": "centerline", "segmentation": "canary:run"}
    configs: list[Any] = [
        {"segmentation": "canary:run"}, {"shapes": [shape]}, {"shapes": ["canary:Run"]}, {"clustering": "canary:Run"},
        {"features": ["canary:run"]}, {"features": [{"kind": "pca", "file": str(tmp_path / "canary.py")}]},
    ]  # fmt: skip
    files = [
        *(policy(config=config) for config in configs),
        policy(wrappers=[{"name": "canary:Run", "kwargs": {}}]),
        policy(network(node("PyOp", ["observation"], ["x"], domain="ai.onnx.contrib", module="canary"))),
        policy(network(external)), policy(pickled), policy(replay=pickled), policy(replay=objects.getvalue()),
        *(policy() | {"policy.yaml": b"!!python/" + tag} for tag in TAGS),
        policy() | {"policy.yaml": pickled},
    ]  # fmt: skip
    for members in files:
        with refused("."):
            policy_from(members)
    # Names of the training are shown, never imported.
    kept = policy(trained={"env": {"id": "canary:Run-v0", "kwargs": {"robot": "canary:Run"}}}, obstacle="canary:run")
    assert policy_from(kept).spec.trained["env"]["id"] == "canary:Run-v0"
    assert not left.exists()
    for run in (lambda: pickle.loads(pickled), lambda: import_module("canary")):  # each of which leaves the file
        run()
        assert left.exists()
        left.unlink()


@pytest.mark.parametrize(("flipped", "refused"), [(1, False), (2, True)])
def test_discrete_actions_may_differ_where_two_are_nearly_equal(flipped, refused):
    def change(graph: Any) -> None:
        graph.node[1].output[0] = "values"
        node("ArgMax", ["values"], ["action"], 2, axis=1, keepdims=0)(graph)
        graph.output[0].CopyFrom(onnx.helper.make_tensor_value_info("action", onnx.TensorProto.INT64, [1]))

    action = np.argmax(SEEN @ WEIGHTS, axis=1)
    action[:flipped] ^= 1
    space = {"shape": [], "dtype": "int64", "low": [0], "high": [1]}
    with pytest.raises(PolicyError, match="does not compute") if refused else nullcontext():
        policy_from(policy(network(change), replayed(action), action=space))


def mutated(data: bytes, chance: random.Random) -> bytes:
    """Return the content with some bytes changed, removed, repeated or inserted."""
    changed = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 8])):
        at, kind = chance.randrange(len(changed)), chance.randrange(5)
        if kind < 2:
            changed[at] ^= 1 << chance.randrange(8)
        elif kind == 2:
            changed[at] = chance.choice([0, 255, 127, 128])
        elif kind == 3:
            del changed[at : at + chance.randrange(1, 20)]
        else:
            changed[at:at] = changed[max(0, at - 20) : at] or b"\xff"
        changed = changed or bytearray(b"\0")
    return bytes(changed)


@pytest.mark.parametrize("count", [150, pytest.param(1000, marks=pytest.mark.nightly)])
def test_mutations_are_refused_or_act_as_the_learner_did(count, tmp_path):
    chance, slowest, read = random.Random(count), 0.0, 0
    policy_from(policy())
    before = peak()
    for i in range(count):
        good = policy()
        name = ("policy.onnx", "policy.onnx", "policy.yaml", "replay.npz", "zip")[i % 5]
        begun = time.process_time()
        try:
            if name == "policy.yaml":
                policy_from(good | {name: mutated(good[name], chance)})
            elif name == "zip":
                buffer = io.BytesIO()
                with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
                    for member, data in good.items():
                        archive.writestr(member, data)
                (tmp_path / "a.policy").write_bytes(mutated(buffer.getvalue(), chance))
                load_policy(tmp_path / "a.policy")
            elif name == "policy.onnx":
                policy_from(policy(mutated(good[name], chance)))
            else:
                policy_from(policy(replay=mutated(good[name], chance)))
            read += 1
        except PolicyError as error:
            assert 0 < len(str(error)) < 1000  # noqa: PT017 - most are refused, a few change nothing
        slowest = max(slowest, time.process_time() - begun)
    assert slowest < HANGS
    assert peak() - before < 300
    assert read < count / 2
